"""Writing: a BRDF at the nodes of a file's slices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.brdf import BRDF
from gonio.formats.rgl.ndf import estimated_ndf
from gonio.formats.rgl.slices import COLUMNS, Nodes, Singles, Slice
from gonio.formats.rgl.tensor_file import store
from microsurfaces.arrays import Floats
from microsurfaces.atomic_write import atomic_write

GRAZING = 89.99
"""Largest incidence that is written, degrees: at 90 no light falls on the surface."""

THETA_STEP = {True: 3.0, False: 5.0}
"""Largest step between written incidences in degrees, if isotropic and if not."""

STEEP = 75.0
"""Incidence from which steps are half as large: the lobe changes faster there."""

PHI_STEP = 10.0
"""Largest step between their azimuths, degrees."""

FEWEST, MOST = 16, 96
"""Nodes along x and along y."""

BUDGET = 48e6
"""Bytes of a file, beyond which it has fewer nodes."""

LEAST_LUMINANCE = 1e-6
"""Least luminance, of its maximum: nothing is impossible to sample."""


def write(brdf: BRDF, path: Path, colour: bool) -> Sequence[str]:
    """Write the BRDF as linear sRGB if `colour`, otherwise at its wavelengths; sentences about what had to be bent.

    Raises ValueError if a spectrum is asked for and only colours are known, OSError where the file cannot be written.
    """
    order = np.argsort(brdf.wavelengths)
    if colour:
        brdf, order = brdf.in_basis("RGB"), np.arange(3)
    elif brdf.basis != "spectrum":
        raise ValueError(
            f"of this BRDF only the channels {brdf.basis} are known, and a spectral file wants values at wavelengths: "
            "write the colour variant"
        )
    theta_i, phi_i = _incidences(brdf)
    count = _count(len(theta_i) * len(phi_i), len(brdf.wavelengths))
    nodes = Nodes.around(estimated_ndf(brdf), theta_i, phi_i, count)
    # The last azimuth is the first one again.
    azimuths = max(1, len(phi_i) - 1)
    answers = [_answer(brdf, nodes.slice(p, t)) for p in range(azimuths) for t in range(len(theta_i))]
    around = answers if brdf.isotropic else [*answers, *answers[: len(theta_i)]]
    grid = len(phi_i), len(theta_i)
    fields: dict[str, NDArray[Any]] = {
        "description": np.frombuffer(f"{brdf.title} (written by gonio)".encode(), np.uint8),
        "theta_i": nodes.theta_i,
        "phi_i": nodes.phi_i,
        "ndf": nodes.ndf,
        "sigma": nodes.sigma,
        "vndf": nodes.warp.density.astype(np.float32).reshape(*grid, COLUMNS, COLUMNS),
        "luminance": np.stack([answer.luminance for answer in around]).reshape(*grid, count, count),
        **({} if colour else {"wavelengths": brdf.wavelengths[order].astype(np.float32)}),
        "rgb" if colour else "spectra": np.stack([answer.values[order] for answer in around]).reshape(
            *grid, -1, count, count
        ),
        "jacobian": np.ones(1, np.uint8),
        "valid": np.packbits([answer.valid for answer in around]),
    }
    with atomic_write(path) as scratch, scratch.open("wb") as file:
        store(file, fields)
    return [*_gaps(brdf), *_bent(answers)]


def _count(slices: int, channels: int) -> int:
    """Nodes along x and along y that the budget allows."""
    numbers = BUDGET / 4 / slices - COLUMNS**2
    return min(MOST, max(FEWEST, math.isqrt(max(0, int(numbers / (channels + 1))))))


def _incidences(brdf: BRDF) -> tuple[Floats, Floats]:
    """theta_i and phi_i of the file, degrees: those known, and what it takes between them."""
    theta_i = _spaced(brdf.theta_i, 0.0, GRAZING, THETA_STEP[brdf.isotropic])
    steep = theta_i[:-1] >= STEEP
    theta_i = np.union1d(theta_i, (theta_i[:-1] + theta_i[1:])[steep] / 2)
    if brdf.isotropic:
        return theta_i, np.zeros(1)
    return theta_i, _spaced((brdf.phi_i + 180) % 360 - 180, -180.0, 180.0, PHI_STEP)


def _spaced(known: Floats, low: float, high: float, step: float) -> Floats:
    """The known angles from `low` to `high` and, where they are further apart than `step`, some between them.

    Where far more are known than that takes, only every second or third of them: the file would be too large.
    """
    inside = np.unique(known[(known > low + 0.05) & (known < high - 0.05)])
    every = max(1, math.ceil(len(inside) * step / (1.5 * (high - low))))
    anchors = np.array([low, *inside[::every], high])
    # A quarter more than a step is not worth another piece.
    pieces = np.maximum(np.ceil(np.diff(anchors) / step - 0.25), 1).astype(int)
    steps = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(anchors, anchors[1:], pieces, strict=False)]
    return np.append(np.concatenate(steps), high)


@dataclass(frozen=True, eq=False)
class Answer:
    """What stands at the nodes of a slice."""

    values: Singles
    """(channel, y, x)."""
    luminance: Singles
    """(y, x)."""
    above: NDArray[np.bool_]
    """(y, x): above the horizon."""
    valid: NDArray[np.bool_]
    """(y, x): above it, and something is known."""
    negative: int
    """Directions with a value below 0 in some channel."""


def _answer(brdf: BRDF, one: Slice) -> Answer:
    """`brdf` in the directions of a slice."""
    above = one.wo[..., 2] > 0
    f = brdf.evaluate(np.broadcast_to(one.wi, one.wo[above].shape), one.wo[above])
    known = np.isfinite(f).all(axis=1)
    valid = above.copy()
    valid[above] = known
    power = np.zeros((*above.shape, f.shape[1]))
    power[valid] = np.maximum(f[known], 0.0) * one.wo[valid][:, 2:]
    dense = power.mean(axis=2) * one.sampled
    return Answer(
        values=np.moveaxis(_without_gaps(power * one.stored[..., None], above & ~valid, valid), -1, 0).astype(
            np.float32
        ),
        luminance=np.maximum(dense, max(LEAST_LUMINANCE * float(dense.max()), 1e-30)).astype(np.float32),
        above=above,
        valid=valid,
        negative=int((f[known] < 0).any(axis=1).sum()),
    )


def _bent(answers: Sequence[Answer]) -> list[str]:
    """Sentences about values that could not be stored as they are."""
    above = sum(int(answer.above.sum()) for answer in answers)
    unknown = above - sum(int(answer.valid.sum()) for answer in answers)
    negative = sum(answer.negative for answer in answers)
    return [
        *([f"{100 * negative / above:.2g} % of the values were negative: they hold 0"] if negative else []),
        *([f"{100 * unknown / above:.2g} % of the values are not known: they hold the nearest"] if unknown else []),
    ]


def _without_gaps(table: Floats, gaps: NDArray[np.bool_], known: NDArray[np.bool_]) -> Floats:
    """`table` (y, x, channels) with the nearest known value in the gaps."""
    if not gaps.any() or not known.any():
        return table
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.where(gaps[..., None], table[tuple(nearest)], table)


def _gaps(brdf: BRDF) -> list[str]:
    """Sentences about incidences that the file has and that were not known."""
    notes = []
    low, high = float(brdf.theta_i[0]), float(brdf.theta_i[-1])
    if low > 0:
        notes.append(f"incidences below {low:g} degrees were not measured: the nearest stands for them")
    if high < GRAZING - 1:
        notes.append(f"incidences beyond {high:g} degrees were not measured: the nearest stands for them")
    if not brdf.isotropic:
        gaps = np.diff(brdf.phi_i, append=brdf.phi_i[0] + 360)
        widest = int(gaps.argmax())
        if len(gaps) < 3 or gaps[widest] > 1.5 * np.delete(gaps, widest).max():
            start, end = brdf.phi_i[widest], (brdf.phi_i[widest] + gaps[widest]) % 360
            notes.append(
                f"light from azimuths between {start:g} and {end:g} degrees was not measured: the nearest azimuth "
                "stands for it"
            )
    return notes
