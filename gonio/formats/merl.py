"""MERL `.binary`: a measured isotropic BRDF in three colours, the table that graphics has used since 2003.

Opens in BRDF Explorer, dj_brdf, ALTA, libbsdf and nearly every published reader; Mitsuba 3 and pbrt-v4 have none.

Layout, little-endian: int32 numbers of bins in theta_h, theta_d and phi_d (90, 90, 180), then float64 values, a plane
of [theta_h][theta_d][phi_d] for each of red, green and blue: 34 992 012 bytes. A value is f_r in 1/sr (no cosine) times
1500, 1500 / 1.15 and 1500 / 1.66; a negative one marks directions below the horizon. The half vector's polar angle
theta_h has bins that are narrow at the specular direction, with edges at (i/90)² 90 degrees; theta_d, the angle between
the half vector and either direction, has bins of one degree, and so has phi_d, the azimuth of `wi` about the half
vector, counted from the plane of the normal. In the frame where the half vector has azimuth 0,
`wi = Ry(theta_h) (sin theta_d cos phi_d, sin theta_d sin phi_d, cos theta_d)` and `wo` is its mirror image.

What is lost: everything that depends on the azimuth of the light, and everything that is not reciprocal, for phi_d and
phi_d + 180 degrees share a bin. A variant with 360 bins in phi_d keeps the latter; it is read here, but few others do.
Readers take the bin that a direction falls into, and values at the centres of bins serve them best (means over bins are
no better: what counts is how far from the centre one asks). Readers that interpolate (libbsdf) take bins as nodes at
the lower edges and are served best by values there.

W. Matusik, H. Pfister, M. Brand, L. McMillan, "A Data-Driven Reflectance Model", ACM Transactions on Graphics 22(3),
759-769 (2003), doi:10.1145/882262.882343; S. Rusinkiewicz, "A New Change of Variables for Efficient BRDF
Representation", Rendering Techniques 1998, 11-22, doi:10.1007/978-3-7091-6453-2_2.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.brdf import BRDF
from gonio.colour import PRIMARIES
from gonio.detectors import HemisphereGrid
from gonio.sphere import angles, direction, half_vector, reflect, rotate_z
from microsurfaces.arrays import Floats, Vectors
from microsurfaces.atomic_write import atomic_write

Sample = Literal["centre", "edge"]
"""Where in its bin a value is taken: at the centre, or at the lower edge."""

BINS = (90, 90, 180)
"""Of theta_h, theta_d and phi_d."""

SCALE = np.array([1.0, 1.15, 1.66]) / 1500
"""f_r of a stored value of 1 in red, green and blue, 1/sr."""

BELOW_HORIZON = -1.0

LARGEST = 1e18
"""Stored values beyond are damage, and not known."""

_CORNERS = tuple(itertools.product((0.0, 1.0), repeat=3))
"""Places in bins that reach above the horizon with a corner only, as shares of their widths."""


def write(brdf: BRDF, path: Path, sample: Sample = "centre") -> Sequence[str]:
    """Write `brdf` in linear sRGB, and say how far from reciprocal it was.

    A bin is the mean of f(wi, wo) and f(wo, wi), which the format cannot tell apart; where only one of the two lies
    within the known incidences it is that one. Raises ValueError if the azimuth of the light matters: an average over
    it would be the BRDF of another specimen.
    """
    if not brdf.isotropic:
        raise ValueError(
            "MERL holds isotropic BRDFs only, and this one depends on the azimuth of the light: measure with azimuth = "
            '"average", or call as_isotropic() (--isotropic) if the specimen looks the same from every azimuth'
        )
    brdf = brdf.in_basis("RGB")
    place = 0.5 if sample == "centre" else 0.0
    values = np.stack([_row(brdf, i, (place, place, place)) for i in range(BINS[0])])
    above = np.isfinite(values[..., 0])
    stored = np.where(above[..., None], np.maximum(values, 0.0) / SCALE, BELOW_HORIZON)
    with atomic_write(path) as scratch, scratch.open("wb") as file:
        file.write(np.array(BINS, "<i4").tobytes())
        file.write(np.moveaxis(stored, -1, 0).astype("<f8").tobytes())
    return _notes(brdf, values[above])


def _row(brdf: BRDF, i: int, place: tuple[float, float, float]) -> Floats:
    """The bins of one theta_h, (theta_d, phi_d, RGB); NaN where nothing lies above the horizon or nothing is known."""
    total, count = np.zeros((*BINS[1:], 3)), np.zeros((*BINS[1:], 1))
    for places in ((place,), _CORNERS):
        j, k = np.nonzero(count[..., 0] == 0)
        for x, y, z in places:
            wi, wo = _directions(i + x, j + y, k + z)
            above = (wi[:, 2] > 0) & (wo[:, 2] > 0)
            if above.any():
                values = _both_ways(brdf, wi[above], wo[above])
                known = np.isfinite(values).all(axis=-1, keepdims=True)
                total[j[above], k[above]] += np.where(known, values, 0.0)
                count[j[above], k[above]] += known
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count)


def _directions(i: ArrayLike, j: ArrayLike, k: ArrayLike) -> tuple[Vectors, Vectors]:
    """`wi` and `wo` (..., 3) at fractional bin numbers of theta_h, theta_d and phi_d."""
    theta_h = 90 * (np.asarray(i) / BINS[0]) ** 2
    about_half = direction(np.asarray(j) * (90 / BINS[1]), np.asarray(k) * (180 / BINS[2]))
    x, y, z = np.moveaxis(about_half, -1, 0)
    c, s = np.cos(np.radians(theta_h)), np.sin(np.radians(theta_h))
    wi = np.stack([c * x + s * z, y, c * z - s * x], axis=-1)
    return wi, reflect(wi, direction(theta_h, 0.0))


def _both_ways(brdf: BRDF, wi: Vectors, wo: Vectors) -> Floats:
    """The mean of f(wi, wo) and f(wo, wi), or the one of them that lies within the known incidences."""
    known_i, known_o = (angles(w)[0][:, None] <= brdf.theta_i[-1] for w in (wi, wo))
    only_i, only_o = known_i & ~known_o, known_o & ~known_i
    there = brdf.evaluate(np.where(only_o, wo, wi), np.where(only_o, wi, wo))
    back = brdf.evaluate(np.where(only_i, wi, wo), np.where(only_i, wo, wi))
    return np.asarray((there + back) / 2)


def _notes(brdf: BRDF, values: Floats) -> list[str]:
    """What had to be bent; `values` (n, RGB) are those above the horizon."""
    notes = ["MERL takes a BRDF for reciprocal: f(wi, wo) and f(wo, wi) were averaged"]
    differences = _differences(brdf)
    if differences.size:
        median, high = np.percentile(100 * differences, [50, 95])
        notes[0] += f", which differed by {median:.2g} % (median) and {high:.2g} % (95th percentile)"
    if brdf.theta_i[-1] < 89:
        notes.append(
            f"incidences beyond {brdf.theta_i[-1]:g} degrees are not known: where light and detector both lie beyond, "
            "the nearest known incidence stands"
        )
    negative = (values < 0).mean()
    if negative:
        notes.append(f"{negative:.2%} of the values were negative, of colours that sRGB does not have, and are 0 now")
    return notes


def _differences(brdf: BRDF) -> Floats:
    """|f(wi, wo) - f(wo, wi)| over their mean where that is above 1 % of the peak of an incidence and channel.

    Of directions that share the projected hemisphere evenly, within the known incidences.
    """
    grid = HemisphereGrid(theta_step=3.0, phi_step=10.0, spacing="projected_area")
    theta: Floats = grid.theta[grid.theta <= brdf.theta_i[-1]]
    if not theta.size:
        return theta
    theta_i, theta_o, dphi = (a.ravel() for a in np.meshgrid(theta, theta, grid.dphi, indexing="ij"))
    wi, wo = direction(theta_i, 0.0), direction(theta_o, dphi)
    both = np.stack([brdf.evaluate(wi, wo), brdf.evaluate(wo, wi)])
    both = both.reshape(2, len(theta), len(theta) * len(grid.dphi), 3)
    mean = np.nan_to_num(both.mean(axis=0))
    bright = (mean > 0.01 * mean.max(axis=1, keepdims=True, initial=0.0)) & (mean > 0)
    return np.asarray(np.abs(both[0] - both[1])[bright] / mean[bright])


def read(path: Path) -> BRDF:
    """The BRDF of a MERL file (180 or 360 bins in phi_d) as BRDF Explorer and dj_brdf see it: constant within a bin.

    Channels are linear sRGB, NaN where the file marks directions below the horizon. Raises ValueError for anything
    else.
    """
    table = _load(path)
    return BRDF(
        evaluate=lambda wi, wo: table[bin_of(wi, wo, table.shape[2])],
        wavelengths=np.array(PRIMARIES),
        theta_i=np.arange(0.0, 90.0, 5.0),
        basis="RGB",
        attributes={"title": path.stem, "origin": f"MERL file {path.name}", "isotropic": 1, "basis": "RGB"},
    )


def _load(path: Path) -> Floats:
    """f_r in 1/sr, (theta_h, theta_d, phi_d, RGB)."""
    with path.open("rb") as file:
        shape = np.frombuffer(file.read(12).ljust(12, b"\0"), "<i4")
        if tuple(shape) not in (BINS, (90, 90, 360)):
            raise ValueError(f"{path}: not a MERL file: it should begin with 90, 90 and 180 (or 360) bins")
        size, expected = path.stat().st_size, 12 + 24 * int(shape.prod())
        if size != expected:
            raise ValueError(f"{path}: a damaged MERL file: {size} bytes instead of {expected}")
        planes = np.fromfile(file, "<f8").reshape(3, *shape)
    known = ((planes >= 0) & (planes < LARGEST)).all(axis=0)
    return np.where(known, planes, np.nan).transpose(1, 2, 3, 0) * SCALE


def bin_of(wi: Vectors, wo: Vectors, phi_bins: int = BINS[2]) -> tuple[NDArray[np.intp], ...]:
    """Bins of theta_h, theta_d and phi_d that pairs of directions (n, 3) fall into.

    180 bins of phi_d cover half a circle and serve the other half too; 360 cover all of it.
    """
    wh = half_vector(wi, wo)
    theta_h, phi_h = angles(wh)
    x, y, z = np.moveaxis(rotate_z(wi, -phi_h), -1, 0)
    c, s = np.cos(np.radians(theta_h)), np.sin(np.radians(theta_h))
    theta_d, phi_d = angles(np.stack([c * x - s * z, y, c * z + s * x], axis=-1))
    places = (
        BINS[0] * np.sqrt(theta_h / 90),
        theta_d * (BINS[1] / 90),
        phi_d % (180 if phi_bins == BINS[2] else 360),
    )
    return tuple(
        np.clip(np.nan_to_num(place).astype(np.intp), 0, n - 1)
        for place, n in zip(places, (*BINS[:2], phi_bins), strict=True)
    )
