"""Whether energy is conserved, and how much of it was lost."""

from __future__ import annotations

import numpy as np

from gonio.measurement import Measurement
from gonio.optics import Lambertian, Mirror
from gonio.self_check.report import Check, not_applicable, outcome
from gonio.self_check.significance import sidak_level
from gonio.self_check.sums import ExactSums
from gonio.tally import UNIT
from microsurfaces.arrays import Floats, Integers

LOST_NOTABLE = 1e-5
"""Lost and truncated share that a sound surface stays below: what restart offsets and float32 edges swallow."""

LOST_LIMIT = 1e-3
"""Lost and truncated share that spoils a result: the third digit of an albedo, more than its usual noise."""


def albedo(sums: ExactSums) -> Check:
    """No more light leaves than came: exact, because the weight of every path is counted."""
    budget = sums.energy_budget
    share = np.maximum(budget["escaped"], sums.reflected[:, 0]) / budget["launched"]
    found = f"the largest albedo is {share.max():.6f} ({sums.worst(share)}), limit 1"
    advice = "more light leaves than was launched, so the sums were changed; measure again"
    return outcome("energy", share.max() <= 1, found, advice, {"albedo": float(share.max()), "limit": 1.0})


def furnace(measurement: Measurement, sums: ExactSums) -> Check:
    """A surface that absorbs nothing sends back all that was not lost or truncated: exact."""
    material, budget = measurement.material, sums.energy_budget
    if not (isinstance(material, Mirror) or (isinstance(material, Lambertian) and material.reflectance == 1.0)):
        return not_applicable("furnace", f"{material!r} absorbs light; what must come back is known of lossless ones.")
    missing = (budget["launched"] - budget["escaped"]) / budget["launched"]
    unexplained = np.abs(missing - (budget["truncated"] + budget["lost"]) / budget["launched"])
    sound = not (budget["launched"] - budget["escaped"] - budget["truncated"] - budget["lost"]).any()
    found = (
        f"a lossless surface sends back all but {missing.max():.2g} of the light, of which {unexplained.max():.2g} was "
        f"neither lost nor truncated ({sums.worst(unexplained)}), limit 0, exactly"
    )
    advice = "what absorbs nothing has absorbed light, so the sums or the material were changed; measure again"
    numbers = {"missing": float(missing.max()), "unexplained": float(unexplained.max()), "limit": 0.0}
    return outcome("furnace", sound, found, advice, numbers)


def lost_light(sums: ExactSums) -> Check:
    """Little light is lost under the surface or given up; a limit is exceeded where chance does not explain it."""
    energy = (sums.energy_budget["truncated"] + sums.energy_budget["lost"]) / UNIT
    share = energy / sums.paths[:, None]
    found = f"{share.max():.2g} of the light was lost or truncated ({sums.worst(share)})"
    numbers = {"share": float(share.max()), "notable": LOST_NOTABLE, "limit": LOST_LIMIT}
    if _exceeds(energy, sums.paths, LOST_LIMIT):
        advice = (
            "the surface has holes, does not join at its seams, or traps light between facets that are too coarse; "
            "repair or refine the mesh"
        )
        return outcome("lost light", False, f"{found}, limit {LOST_LIMIT:g}", advice, numbers)
    found += f", notable beyond {LOST_NOTABLE:g}, limit {LOST_LIMIT:g}, chance allowed for"
    advice = (
        "albedos are too low by that much, by very steep facets or by periods that do not quite join; allow for it, or "
        "repair the mesh"
    )
    sound = not _exceeds(energy, sums.paths, LOST_NOTABLE)
    return outcome("lost light", sound, found, advice, numbers, "warning")


def _exceeds(energy: Floats, paths: Integers, share: float) -> bool:
    """Whether more paths were lost than chance explains if `share` of them do: Poisson's law.

    So much energy (N, W) is that of as many paths, or more; wavelengths share theirs, so an incidence is one case.
    """
    from scipy.special import pdtrc

    count = np.ceil(energy.max(axis=1))
    chance = np.where(count > 0, pdtrc(np.maximum(count - 1, 0), share * paths), 1.0)
    return bool((chance < sidak_level(len(paths))).any())
