"""The certificate of a measurement: self-checks, recomputed from the exact sums, that go with every result.

A check has failed where physics or bookkeeping is wrong: do not use the numbers. It warns where the settings limit what
may be concluded from them. Exact integers are held to exact equality; what is random is judged at one level a check,
shared (Sidak) between all that the check looks at, so that a sound instrument practically never fails.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, get_args, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from gonio.comparison import ENOUGH_HITS
from gonio.detectors import Apertures, HemisphereGrid, Klems
from gonio.measurement import ENERGY_BUDGET, Measurement
from gonio.netcdf import load
from gonio.optics import Conductor, Dielectric, Lambertian, Mirror, fresnel_conductor
from gonio.tally import UNIT, UInt128
from microsurfaces.arrays import Floats, Integers
from microsurfaces.mesh import SLOPE_AZIMUTHS, SLOPES, SlopeLaw

if TYPE_CHECKING:
    import xarray as xr

Status = Literal["passed", "warning", "failed", "not applicable"]
LEVEL = 1e-3
"""Probability that a random check fails although nothing is wrong."""

ROUNDING = 1e-12
"""Relative difference that another machine's arithmetic may make to a labelled value."""

ASTRAY_NOTABLE = 1e-5
"""Lost and truncated share that a sound surface stays below: what restart offsets and float32 edges swallow."""

ASTRAY_LIMIT = 1e-3
"""Lost and truncated share that spoils a result: the third digit of an albedo, more than its usual noise."""

INDEPENDENT_TAIL = 25.0
"""Independent areas that must be expected on either side of a slope before the share there counts as normally
distributed; in 10,000 simulated tiles of 5 to 60 correlation lengths none then failed at the level of 1e-3."""

FACETS_PER_LENGTH = 8.0
"""Facets per correlation length or radius of curvature. With 8 the facets of a Gaussian surface have 0.8 % less mean
square slope than the smooth surface; with 4, 3 % less."""

ENOUGH_REPLICATES = 8
"""Replicates behind an error bar: 8 know it to 27 %, and a 95 % interval is 2.4 standard errors instead of 2.0."""

ENOUGH_REALISATIONS = 4
"""Specimens behind an error bar that speaks of a class: with 4 a 95 % interval is 3.2 standard errors, with 2 12.7."""

SPARSE_SHARE = 0.05
"""Share of the light in bins with few hits: as much as may lie outside 95 % intervals anyway."""

UNPOLARISED_ERROR = 0.01
"""Share of the reflected light that polarisation, which is not carried along, may move."""

COHERENT_SHARE = 0.01
"""Share of the light in the coherent, mirror-like reflection that rays do not know of."""


@dataclass(frozen=True)
class Check:
    """One self-check: what was found, against which limit, and what to do about it."""

    name: str
    status: Status
    sentence: str
    numbers: dict[str, float]


@dataclass(frozen=True)
class Certificate:
    """All self-checks of one measurement."""

    checks: tuple[Check, ...]

    @property
    def failed(self) -> list[str]:
        """Names of the checks that failed."""
        return [check.name for check in self.checks if check.status == "failed"]

    @property
    def passed(self) -> bool:
        """Whether no check failed; warnings do not count."""
        return not self.failed

    def sentences(self) -> list[str]:
        """A line for each check: its name, how it ended, what was found."""
        return [f"{check.name}, {check.status}: {check.sentence}" for check in self.checks]

    def summary(self) -> list[str]:
        """How many checks ended how, and a line for each that did not pass."""
        count = {status: sum(check.status == status for check in self.checks) for status in get_args(Status)}
        found = ", ".join(f"{count[status]} {status}" for status in ("passed", "failed", "not applicable"))
        warnings = f"{count['warning']} warning{'s' * (count['warning'] != 1)}"
        wrong = [check for check in self.checks if check.status in ("failed", "warning")]
        return [
            f"Certificate: {len(self.checks)} checks, {found}, {warnings}.",
            *(f"{check.name}, {check.status}: {check.sentence}" for check in wrong),
        ]

    def to_json(self) -> str:
        """As it goes with a measurement into its file."""
        return json.dumps([check.__dict__ for check in self.checks])

    @classmethod
    def from_json(cls, text: str) -> Certificate:
        """From what `to_json` made."""
        return cls(tuple(Check(**check) for check in json.loads(text)))


def certify(measurement: Measurement, stored: xr.Dataset | None = None) -> Certificate:
    """Check `measurement`; `stored` are the labelled values that go with it, `measurement.dataset` if left out.

    Raises ValueError if no incidence was measured, or if the measurement comes from elsewhere.
    """
    sums = _Sums.of(measurement)
    fresh = replace(measurement).dataset
    return Certificate(
        (
            _ledger(sums),
            _orders(sums, isinstance(measurement.detector, HemisphereGrid)),
            _values(fresh, measurement.dataset if stored is None else stored),
            _energy(sums),
            _furnace(measurement, sums),
            _astray(sums),
            _reciprocity(measurement, fresh),
            _normals(measurement, sums),
            _resolution(measurement),
            _replicates(measurement),
            _realisations(measurement, sums),
            _completeness(measurement, sums),
            _sparse(sums),
            _polarisation(measurement, sums),
            _geometric_optics(measurement, sums),
        )
    )


def certify_file(path: str | Path) -> Certificate:
    """Check the measurement in a file, its labelled values against its exact sums as well.

    Raises ValueError in one sentence for a file that holds no measurement, or one that comes from elsewhere.
    """
    import xarray as xr

    try:
        measurement = load(path)
        if measurement.sums is None:
            raise ValueError(
                f"{path} comes from another program, without the sums that gonio counts: there is nothing that a "
                "certificate could check"
            )
        with xr.open_dataset(path, engine="h5netcdf") as stored:
            return certify(measurement, stored.load())
    except (LookupError, TypeError, AttributeError, ValidationError, json.JSONDecodeError) as error:
        what = " ".join(str(error).split())
        raise ValueError(f"{path}: not a measurement that gonio wrote, or it is damaged ({what})") from None


class _Sums(NamedTuple):
    """The exact sums of the N incidences that were measured."""

    theta: Floats
    """(N,) degrees."""
    phi: Floats
    """(N,) degrees."""
    wavelengths: Floats
    """(W,) nm."""
    weight: Integers
    """(N, orders, bins, W): all orders first, the hemisphere last."""
    hits: Integers
    """(N, orders, bins)."""
    squares: UInt128
    """Squares of `weight`, summed over realisations."""
    fates: dict[str, Integers]
    """(N, W) of each fate."""
    paths: Integers
    """(N,)."""
    realisations: Integers
    """(N,)."""
    incidences: int
    """How many incidences were asked for."""

    @classmethod
    def of(cls, measurement: Measurement) -> _Sums:
        """Those of `measurement`; ValueError if there are none."""
        sums = measurement.counted
        at = np.nonzero(sums["paths"].values)
        if not at[0].size:
            raise ValueError("The measurement holds no measured incidence to check: run it again to the end.")
        names = ("weight", "count", "energy_budget", "paths", "realisations")
        weight, hits, ledger, paths, realisations = (sums[name].values[at] for name in names)
        high, low = (sums[f"realisation_squares_{half}"].values[at] for half in ("high", "low"))
        return cls(
            sums["theta_i"].values[at[0]],
            sums["phi_i"].values[at[1]],
            sums["wavelength"].values,
            weight,
            hits,
            UInt128(high, low),
            {fate: ledger[:, k] for k, fate in enumerate(ENERGY_BUDGET)},
            paths,
            realisations,
            sums["paths"].size,
        )

    def worst(self, values: NDArray[Any]) -> str:
        """The incidence and wavelength at which `values` (N, W) are largest."""
        n, w = divmod(int(values.argmax()), len(self.wavelengths))
        return f"theta_i {self.theta[n]:g}, phi_i {self.phi[n]:g}, {self.wavelengths[w]:g} nm"

    @property
    def reflected(self) -> Integers:
        """What left, of every order, (N, orders, W)."""
        return self.weight[:, :, -1]


def _outcome(
    name: str, sound: bool, found: str, advice: str, numbers: dict[str, float], otherwise: Status = "failed"
) -> Check:
    """A check that passed if `sound`, and otherwise comes with `advice`."""
    if sound:
        return Check(name, "passed", f"{found}.", numbers)
    return Check(name, otherwise, f"{found}: {advice}.", numbers)


def _not_applicable(name: str, why: str) -> Check:
    return Check(name, "not applicable", why, {})


def _sidak(cases: int) -> float:
    """The level of one of `cases` that gives all of them together `LEVEL`."""
    return float(-np.expm1(np.log1p(-LEVEL) / cases))


# --- Bookkeeping ------------------------------------------------------------------------------------------------------


def _ledger(sums: _Sums) -> Check:
    """launched = escaped + absorbed + truncated + lost, and each is what it is said to be: exact."""
    fates = sums.fates
    residues = (
        fates["launched"] - sum(fates[name] for name in ENERGY_BUDGET[1:]),
        fates["launched"] - sums.paths[:, None] * UNIT,
        fates["escaped"] - sums.reflected[:, 0],
        np.minimum(0, np.min(list(fates.values()), axis=0)),
    )
    residue = np.abs(residues).max(axis=0) / UNIT
    found = (
        f"launched = escaped + absorbed + truncated + lost within {residue.max():.6g} paths at all {residue.size} "
        f"incidences and wavelengths (worst: {sums.worst(residue)}), limit 0, exactly"
    )
    advice = "energy is unaccounted for, so the sums were changed; measure again"
    return _outcome("ledger", not residue.any(), found, advice, {"residue": float(residue.max()), "limit": 0.0})


def _orders(sums: _Sums, covers: bool) -> Check:
    """Orders add up to "all", bins to the hemisphere, one specimen's squares are squares; no path weighs more than 1.

    Only a grid (`covers`) has bins that add up to the hemisphere; an aperture sees no more than it.
    """
    false = [(sums.weight < 0) | (sums.weight > sums.hits[..., None] * UNIT), sums.hits[:, 0, -1] > sums.paths]
    for values in (sums.weight, sums.hits):
        bins, hemisphere = values[:, :, :-1], values[:, :, -1]
        false += [values[:, 0] != values[:, 1:].sum(axis=1)]
        false += [bins.sum(axis=2) != hemisphere if covers else bins.max(axis=2) > hemisphere]
    alone = sums.realisations == 1
    squares = UInt128.zeros(sums.weight[alone].shape)
    squares.add_square(sums.weight[alone])
    false += [(squares.high != sums.squares.high[alone]) | (squares.low != sums.squares.low[alone])]
    count = int(sum(np.count_nonzero(contradictions) for contradictions in false))
    found = (
        f"orders add up to their total, bins to the hemisphere and weights to no more than their hits, with {count} "
        f"contradictions in {sums.weight.size} sums, limit 0"
    )
    advice = "the sums were changed; measure again"
    return _outcome("orders", count == 0, found, advice, {"contradictions": float(count), "limit": 0.0})


def _values(fresh: xr.Dataset, stored: xr.Dataset) -> Check:
    """What is labelled follows from the sums."""
    deviations = {name: _deviation(stored, fresh, name) for name in map(str, fresh.variables)}
    worst = max(deviations, key=deviations.__getitem__)
    wrong = sorted(name for name, deviation in deviations.items() if deviation > ROUNDING)
    found = (
        f"{len(deviations) - len(wrong)} of {len(deviations)} labelled variables (brdf, standard errors ...) follow "
        f"from the exact sums; the largest relative deviation is {deviations[worst]:.2g}, limit {ROUNDING:g}"
    )
    advice = f"{', '.join(wrong)} changed; load the file and save it again, which restores them"
    return _outcome("values", not wrong, found, advice, {"deviation": deviations[worst], "limit": ROUNDING})


def _deviation(stored: xr.Dataset, fresh: xr.Dataset, name: str) -> float:
    """Largest relative deviation of a variable from what it should be; 1 for what is not the same and must be."""
    expected = fresh[name].values
    if name not in stored.variables or stored[name].shape != expected.shape:
        return 1.0
    found = stored[name].values
    if {expected.dtype.kind, found.dtype.kind} != {"f"}:
        return float((found != expected).any())
    same = (found == expected) | (np.isnan(found) & np.isnan(expected))
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.abs(found - expected) / np.maximum(np.abs(expected), np.abs(found))
    return float(np.where(same, 0.0, np.nan_to_num(relative, nan=1.0)).max(initial=0.0))


# --- Energy -----------------------------------------------------------------------------------------------------------


def _energy(sums: _Sums) -> Check:
    """No more light leaves than came: exact, because the weight of every path is counted."""
    albedo = np.maximum(sums.fates["escaped"], sums.reflected[:, 0]) / sums.fates["launched"]
    found = f"the largest albedo is {albedo.max():.6f} ({sums.worst(albedo)}), limit 1"
    advice = "more light leaves than was launched, so the sums were changed; measure again"
    return _outcome("energy", albedo.max() <= 1, found, advice, {"albedo": float(albedo.max()), "limit": 1.0})


def _furnace(measurement: Measurement, sums: _Sums) -> Check:
    """A surface that absorbs nothing sends back all that was not lost or truncated: exact."""
    material, fates = measurement.material, sums.fates
    if not (isinstance(material, Mirror) or (isinstance(material, Lambertian) and material.reflectance == 1.0)):
        return _not_applicable("furnace", f"{material!r} absorbs light; what must come back is known of lossless ones.")
    missing = (fates["launched"] - fates["escaped"]) / fates["launched"]
    unexplained = np.abs(missing - (fates["truncated"] + fates["lost"]) / fates["launched"])
    sound = not (fates["launched"] - fates["escaped"] - fates["truncated"] - fates["lost"]).any()
    found = (
        f"a lossless surface sends back all but {missing.max():.2g} of the light, of which {unexplained.max():.2g} was "
        f"neither lost nor truncated ({sums.worst(unexplained)}), limit 0, exactly"
    )
    advice = "what absorbs nothing has absorbed light, so the sums or the material were changed; measure again"
    numbers = {"missing": float(missing.max()), "unexplained": float(unexplained.max()), "limit": 0.0}
    return _outcome("furnace", sound, found, advice, numbers)


def _astray(sums: _Sums) -> Check:
    """Little light is lost under the surface or given up; a limit is exceeded where chance does not explain it."""
    energy = (sums.fates["truncated"] + sums.fates["lost"]) / UNIT
    share = energy / sums.paths[:, None]
    found = f"{share.max():.2g} of the light was lost or truncated ({sums.worst(share)})"
    numbers = {"share": float(share.max()), "notable": ASTRAY_NOTABLE, "limit": ASTRAY_LIMIT}
    if _exceeds(energy, sums.paths, ASTRAY_LIMIT):
        advice = (
            "the surface has holes, does not join at its seams, or traps light between facets that are too coarse; "
            "repair or refine the mesh"
        )
        return _outcome("lost light", False, f"{found}, limit {ASTRAY_LIMIT:g}", advice, numbers)
    found += f", notable beyond {ASTRAY_NOTABLE:g}, limit {ASTRAY_LIMIT:g}, chance allowed for"
    advice = (
        "albedos are too low by that much, by very steep facets or by periods that do not quite join; allow for it, or "
        "repair the mesh"
    )
    sound = not _exceeds(energy, sums.paths, ASTRAY_NOTABLE)
    return _outcome("lost light", sound, found, advice, numbers, "warning")


def _exceeds(energy: Floats, paths: Integers, share: float) -> bool:
    """Whether more paths went astray than chance explains if `share` of them do: Poisson's law.

    So much energy (N, W) is that of as many paths, or more; wavelengths share theirs, so an incidence is one case.
    """
    from scipy.special import pdtrc

    count = np.ceil(energy.max(axis=1))
    chance = np.where(count > 0, pdtrc(np.maximum(count - 1, 0), share * paths), 1.0)
    return bool((chance < _sidak(len(paths))).any())


# --- Reciprocity ------------------------------------------------------------------------------------------------------

Place = tuple[int, int, int]
"""Indices of what an aperture saw: theta_i, phi_i, detector."""


def _reciprocity(measurement: Measurement, data: xr.Dataset) -> Check:
    """Cone A lit and cone B seen is cone B lit and cone A seen, by Student's t of the Monte Carlo noise.

    Both were measured on the same specimens, so how these differ drops out.
    """
    from scipy.special import stdtr

    pairs = [pair for pair in _pairs(measurement) if _comparable(pair, data)]
    if not pairs:
        why = (
            "no reciprocal pair was measured: it takes Apertures and a beam_half_angle equal to their half_angle, two "
            f"directions that were both lit and seen, and {ENOUGH_HITS} hits."
        )
        return _not_applicable("reciprocity", why)
    there, back = (_Seen.at(data, places) for places in zip(*pairs, strict=True))
    score, freedom = there.difference(back)
    p_value = 2 * stdtr(freedom, -np.abs(score))
    level, worst = _sidak(p_value.size), np.unravel_index(p_value.argmin(), p_value.shape)
    found = (
        f"the worst of {p_value.size} pairs (two cones, a wavelength) measured both ways round is "
        f"{there.value[worst]:.4g} and {back.value[worst]:.4g} 1/sr, {abs(score[worst]):.2g} standard errors apart "
        f"(p = {p_value[worst]:.2g}, limit {level:.2g})"
    )
    advice = "light and detector cannot be exchanged, so the sums were changed or light is lost; measure again"
    numbers = {"pairs": float(p_value.size), "t": float(score[worst]), "p_value": float(p_value[worst]), "limit": level}
    return _outcome("reciprocity", bool(p_value[worst] >= level), found, advice, numbers)


class _Seen(NamedTuple):
    """What some apertures saw, (pairs, W), or (pairs, 1) where wavelengths do not matter."""

    value: Floats
    """1/sr."""
    error: Floats
    """Monte Carlo standard error."""
    path: Floats
    """What a path adds, the mean over those that arrived."""
    freedom: Floats
    """Degrees of freedom of the error."""

    @classmethod
    def at(cls, data: xr.Dataset, places: tuple[Place, ...]) -> _Seen:
        """The apertures at these places."""
        row, column, aperture = np.array(places).T
        value, error, hits = (
            data[name].sel(order="all").values[row, column, aperture]
            for name in ("brdf", "brdf_standard_error_mc", "count")
        )
        freedom = data["degrees_of_freedom_mc"].values[row, column].astype(np.float64)
        return cls(value, error, value / hits[:, None], freedom[:, None])

    def difference(self, other: _Seen) -> tuple[Floats, Floats]:
        """Student's t and its degrees of freedom (Welch), each (pairs, W).

        At the rim of a cone rounding (directions are float32) decides what is seen, a path at the least.
        """
        variance = self.error**2 + other.error**2
        fourth = self.error**4 / self.freedom + other.error**4 / other.freedom
        welch = np.where(fourth > 0, variance**2 / np.where(fourth > 0, fourth, 1.0), self.freedom)
        rim = self.path**2 + other.path**2 + (1e-6 * self.value) ** 2
        return (self.value - other.value) / np.sqrt(variance + rim), welch


def _pairs(measurement: Measurement) -> Iterator[tuple[Place, Place]]:
    """Every pair of equal cones that was measured both ways round, at two incidences."""
    detector, goniometer = measurement.detector, json.loads(measurement.attributes["goniometer"])
    beam, average = goniometer["beam_half_angle"], goniometer["azimuth"] == "average"
    if not isinstance(detector, Apertures) or beam <= 0 or abs(detector.half_angle - beam) > 1e-9:
        return
    known: dict[tuple[float, ...], Place] = {}
    paths = measurement.counted["paths"]
    for i, j in zip(*(index.tolist() for index in np.nonzero(paths.values)), strict=True):
        lit = float(paths["theta_i"][i]), float(paths["phi_i"][j])
        for k, seen in enumerate(detector.directions):
            reverse = known.get(_arrangement(seen, lit, average))
            if reverse is not None and reverse[:2] != (i, j):
                yield reverse, (i, j, k)
            known.setdefault(_arrangement(lit, seen, average), (i, j, k))


def _arrangement(lit: tuple[float, float], seen: tuple[float, float], average: bool) -> tuple[float, ...]:
    """A key for the cones about two directions (theta, phi): equal keys, equal BRDF.

    Where the surface was turned by all angles only the difference of the azimuths counts; at the pole there is none.
    """
    polar, azimuths = [round(w[0], 6) for w in (lit, seen)], [w[1] if w[0] > 1e-6 else 0.0 for w in (lit, seen)]
    if average:
        azimuths = [azimuths[1] - azimuths[0]] if min(polar) > 0 else [0.0]
    return (*polar, *(round(azimuth % 360, 6) % 360 for azimuth in azimuths))


def _comparable(pair: tuple[Place, Place], data: xr.Dataset) -> bool:
    """Whether the same specimens were measured both ways, with enough hits."""
    hits, realisations = data["count"].sel(order="all").values, data["realisations"].values
    (*there, _), (*back, _) = pair
    return bool(
        realisations[tuple(there)] == realisations[tuple(back)] and min(hits[place] for place in pair) >= ENOUGH_HITS
    )


# --- The surface ------------------------------------------------------------------------------------------------------


@runtime_checkable
class _Sloped(Protocol):
    """A recipe that asks for a distribution of slopes."""

    def expected_slopes(self, azimuth: float, slopes: Floats) -> SlopeLaw:
        """Along an azimuth in degrees."""
        ...


def _normals(measurement: Measurement, sums: _Sums) -> Check:
    """The facets are tilted as the recipe asks: shares of the plane below given slopes, along four azimuths.

    Neighbouring facets are correlated, so a distance is judged by how much the share spreads from tile to tile, which
    the recipe predicts.
    """
    from scipy.special import ndtri

    surface, facets = measurement.surface, measurement.facets
    if facets is None or not isinstance(surface, _Sloped):
        why = (
            "the measurement does not say which surface was asked for: only `run` of an experiment notes it."
            if surface is None or facets is None
            else f"{type(surface).__name__} asks for no distribution of slopes."
        )
        return _not_applicable("normals", why)
    laws = [surface.expected_slopes(azimuth, SLOPES) for azimuth in SLOPE_AZIMUTHS]
    expected = np.stack([law.cdf for law in laws])
    spread = np.stack([law.spread for law in laws]) / np.sqrt(sums.realisations.max())
    judged = _judged(expected, spread)
    if not judged.any():
        return _not_applicable("normals", "the tiles are too small to judge the slopes of their facets by.")
    scores = -float(ndtri(_sidak(int(np.count_nonzero(judged))) / 2))
    limit = scores * spread + np.array([[law.rounding] for law in laws]) + 1e-8  # shares are stored to nine decimals
    distance = _distances(surface, facets.slope_cdf)
    worst = np.unravel_index(np.where(judged, distance / limit, -1.0).argmax(), limit.shape)
    azimuth, slope, share = SLOPE_AZIMUTHS[worst[0]], SLOPES[worst[1]], facets.slope_cdf[worst]
    found = (
        f"along azimuth {azimuth:g} a share of {share:.5f} of the plane has slopes up to {slope:.3g}, "
        f"{type(surface).__name__} asks for {expected[worst]:.5f}: off by {distance[worst]:.2g}, limit "
        f"{limit[worst]:.2g} (the worst of {np.count_nonzero(judged)} slopes)"
    )
    advice = "the mesh is not the surface that the file names; build and measure it again"
    numbers = {"azimuth": azimuth, "slope": slope, "share": share, "expected": expected[worst]}
    numbers |= {"distance": distance[worst], "limit": limit[worst]}
    sound = bool(distance[worst] <= limit[worst])
    return _outcome("normals", sound, found, advice, {name: float(value) for name, value in numbers.items()})


def _judged(cdf: Floats, spread: Floats) -> NDArray[np.bool_]:
    """Slopes at which a share is as good as normally distributed."""
    tail = np.minimum(cdf, 1 - cdf)
    independent = cdf * (1 - cdf) / np.where(spread > 0, spread, 1.0) ** 2
    return np.asarray((spread == 0) | (independent * tail > INDEPENDENT_TAIL))


def _distances(surface: _Sloped, found: Floats) -> Floats:
    """Distance of shares (azimuths, slopes) from the recipe's, whose steps may be rounded to either side."""
    hair = 1e-6 * np.abs(SLOPES)
    below, above = (
        np.stack([surface.expected_slopes(azimuth, slopes).cdf for azimuth in SLOPE_AZIMUTHS])
        for slopes in (SLOPES - hair, SLOPES + hair)
    )
    return np.asarray(np.maximum(np.maximum(below - found, found - above), 0.0))


def _resolution(measurement: Measurement) -> Check:
    """Facets are small beside what the surface is made of."""
    statistics, facets = measurement.surface_statistics, measurement.facets
    x, y = statistics["correlation_length_x"], statistics["correlation_length_y"]
    if facets is None:
        return _not_applicable("resolution", "the measurement does not say how fine its facets are.")
    if facets.single_valued and x is not None and y is not None:
        name, count = "correlation length", min(x / facets.spacing[0], y / facets.spacing[1])
    elif not facets.single_valued and facets.radius_of_curvature is not None:
        name, count = "radius of curvature", facets.radius_of_curvature / max(facets.spacing)
    else:
        return _not_applicable("resolution", "facets are the surface itself, or its correlation length is not known.")
    found = f"{count:.3g} facets per {name} ({facets.triangles} triangles in all), limit {FACETS_PER_LENGTH:g}"
    advice = "facets are flatter than the surface they stand for; give it more samples or chords, or a smaller side"
    numbers = {"facets_per_length": count, "triangles": float(facets.triangles), "limit": FACETS_PER_LENGTH}
    return _outcome("resolution", count >= FACETS_PER_LENGTH, found, advice, numbers, "warning")


# --- Settings ---------------------------------------------------------------------------------------------------------


def _replicates(measurement: Measurement) -> Check:
    """Error bars are themselves known."""
    count = int(measurement.counted.attrs["pilot"])
    found = (
        f"{count} replicates give the error bars and know them to {100 / np.sqrt(2 * (count - 1)):.0f} %, limit "
        f"{ENOUGH_REPLICATES}"
    )
    numbers = {"replicates": float(count), "limit": float(ENOUGH_REPLICATES)}
    advice = "set goniometer.replicates higher, with the same paths"
    return _outcome("replicates", count >= ENOUGH_REPLICATES, found, advice, numbers, "warning")


def _realisations(measurement: Measurement, sums: _Sums) -> Check:
    """Whether the result speaks of a class of surfaces."""
    surface, count = measurement.surface, int(sums.realisations.min())
    alike = isinstance(surface, _Sloped) and not surface.expected_slopes(0.0, SLOPES).spread.any()
    enough = 1 if alike else ENOUGH_REALISATIONS
    found = f"{count} specimen{'s' if count > 1 else ''} measured, limit {enough}"
    found += f" ({type(surface).__name__} is the same for every seed)" if alike else ""
    meaning = "it speaks of this one only" if count == 1 else "it hardly knows how they differ"
    advice = f"the result speaks of a class of surfaces from {enough} on, {meaning}; set realisations higher"
    numbers = {"realisations": float(count), "limit": float(enough)}
    return _outcome("realisations", count >= enough, found, advice, numbers, "warning")


def _completeness(measurement: Measurement, sums: _Sums) -> Check:
    """Whether the measurement ran to its end."""
    patches = measurement.detector.bins if isinstance(measurement.detector, Klems) else None
    count, wanted = len(sums.paths), patches or sums.incidences
    found = f"{count} of {wanted} incidences were measured{', then it was stopped' if measurement.interrupted else ''}"
    advice = "what is there is sound; run it again to the end for the rest"
    sound = count == wanted and not measurement.interrupted
    numbers = {"incidences": float(count), "limit": float(wanted)}
    return _outcome("completeness", sound, found, advice, numbers, "warning")


def _sparse(sums: _Sums) -> Check:
    """Little light is in bins with too few hits for an error bar."""
    hits, light = sums.hits[:, 0, :-1], sums.weight[:, 0, :-1].astype(np.float64)
    few = (hits > 0) & (hits < ENOUGH_HITS)
    share = (light * few[..., None]).sum(axis=1) / np.maximum(light.sum(axis=1), 1.0)
    found = (
        f"{100 * share.max():.2g} % of the light is in bins with fewer than {ENOUGH_HITS} hits ({sums.worst(share)}), "
        f"limit {100 * SPARSE_SHARE:g} %; these are {100 * few.mean():.2g} % of the bins, "
        f"{100 * (hits == 0).mean():.2g} % have none"
    )
    numbers = {"share_of_light": float(share.max()), "limit": SPARSE_SHARE}
    numbers |= {"share_of_bins": float(few.mean()), "share_without_hits": float((hits == 0).mean())}
    advice = "their error bars mean little; take more paths or wider bins"
    return _outcome("sparse bins", share.max() <= SPARSE_SHARE, found, advice, numbers, "warning")


# --- Physics that rays leave out --------------------------------------------------------------------------------------


def _polarisation(measurement: Measurement, sums: _Sums) -> Check:
    """Light of several hits has unpolarised reflectances multiplied, which is wrong where s and p differ."""
    material = measurement.material
    if not isinstance(material, Conductor | Dielectric):
        return _not_applicable("polarisation", f"{material!r} reflects all polarisations alike.")
    index = material.refractive_index(sums.wavelengths)
    Rs, Rp = fresnel_conductor(np.linspace(0, 1, 2001)[1:, None], index.real, index.imag)
    # Unpolarised light on two facets in one plane of incidence: (Rs² + Rp²) / 2 for ((Rs + Rp) / 2)².
    factor = (2 * (Rs**2 + Rp**2) / (Rs + Rp) ** 2).max(axis=0)
    light = sums.reflected
    share = 1 - light[:, 1] / np.maximum(light[:, 0], 1) - (light[:, 0] == 0)
    effect = share * (factor - 1)
    worst = np.unravel_index(effect.argmax(), effect.shape)
    found = (
        f"{100 * share[worst]:.2g} % of the reflected light had more than one hit ({sums.worst(effect)}), off by a "
        f"factor of up to {factor[worst[1]]:.3g} because polarisation is not carried along: "
        f"{100 * effect[worst]:.2g} % of the light, limit {100 * UNPOLARISED_ERROR:g} %"
    )
    numbers = {"share": share[worst], "factor": factor[worst[1]], "effect": effect[worst], "limit": UNPOLARISED_ERROR}
    advice = "rely on order 1, and on the orders beyond it no further than that"
    numbers = {name: float(value) for name, value in numbers.items()}
    return _outcome("polarisation", effect[worst] <= UNPOLARISED_ERROR, found, advice, numbers, "warning")


def _geometric_optics(measurement: Measurement, sums: _Sums) -> Check:
    """Rays describe light where wavelengths are short beside the relief.

    Reflection as by tangent planes was found where the correlation length exceeds the wavelength (K. A. O'Donnell and
    E. R. Mendez, doi:10.1364/JOSAA.4.001194) and asks the same of the radius of curvature (A. K. Sultan-Salem and
    G. L. Tyler, IEEE Trans. Geosci. Remote Sens. 42, 2004). Gaussian heights of the rms Sq leave a share
    exp(-(4 pi Sq cos(theta) / wavelength)²) in a coherent, mirror-like reflection (H. E. Bennett and J. O. Porteus,
    doi:10.1364/JOSA.51.000123).
    """
    statistics, facets = measurement.surface_statistics, measurement.facets
    along = (statistics["correlation_length_x"], statistics["correlation_length_y"])
    correlation = min((length for length in along if length is not None), default=None)
    radius = None if facets is None else facets.radius_of_curvature
    lengths = {"correlation length": correlation, "radius of curvature": radius}
    numbers = {name.replace(" ", "_"): length for name, length in lengths.items() if length is not None}
    if isinstance(measurement.material, Lambertian) or not numbers:
        why = "a diffuser, a plane, or a relief of edges has no length to hold against the wavelength."
        return _not_applicable("geometric optics", why)
    wavelength, theta, height = float(sums.wavelengths.max()) / 1000, float(sums.theta.max()), statistics["Sq"]
    numbers["wavelength"] = wavelength
    doubts = [f"the {name}" for name, length in lengths.items() if length is not None and length < wavelength]
    found = f"wavelength {wavelength:g} µm, the limit for {', '.join(_in_words(lengths))}"
    if correlation is not None and height is not None:
        coherent = float(np.exp(-((4 * np.pi * height * np.cos(np.radians(theta)) / wavelength) ** 2)))
        numbers |= {"coherent_share": coherent, "coherent_limit": COHERENT_SHARE}
        doubts += ["the height"] if coherent > COHERENT_SHARE else []
        found += f"; coherent share {coherent:.2g} at theta_i {theta:g}, limit {COHERENT_SHARE:g}"
    advice = (
        f"{' and '.join(doubts)} of the relief would show waves that rays do not know of; enlarge it, take shorter "
        "wavelengths, or read the result as the limit of large reliefs"
    )
    return _outcome("geometric optics", not doubts, found, advice, numbers, "warning")


def _in_words(lengths: dict[str, float | None]) -> list[str]:
    return [f"{name} {length:.3g} µm" for name, length in lengths.items() if length is not None]
