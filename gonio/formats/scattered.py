"""Lists of samples of a BRDF, as most files of measurements hold them, and the function that they stand for.

A list is a measurement as it is if its directions are the bin centres of a `HemisphereGrid` and every incidence is
there; what a file leaves out of it stays unknown (NaN). Any other list is interpolated: linearly in theta_o and dphi
where the directions of an incidence form rings and sectors, linearly over the triangles between them where they are
scattered. Between incidences the lobe moves with the half vector. A direction farther from all samples than half their
distance is unknown, and so are azimuths in a gap of more than 60 degrees: samples in the plane of incidence say nothing
about the directions outside of it.
"""

from __future__ import annotations

import functools
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.brdf import BRDF, NOMINAL, Basis
from gonio.detectors import HemisphereGrid
from gonio.interpolation import bracket, bracket_around
from gonio.measurement import Measurement, tabulated
from gonio.sphere import angles, direction, half_vector, reflect, rotate_z
from microsurfaces.arrays import Floats, Vectors

Index = NDArray[np.intp]

SAME = 1e-4
"""Degrees between angles that are the same: files round radians to six decimals."""

MOST_VALUES = 1 << 26
"""Of a table; half a GiB."""

MOST_SCATTERED = 500_000
"""Directions that are triangulated at most, all incidences together."""

MOST_INCIDENCES = 10_000
"""Of a table that is interpolated."""

MOST_STEPS = 1000
"""From triangle to triangle."""

LARGEST_BRDF = 1e15
"""In 1/sr; more is a damaged number, and its sums overflow."""

WIDEST_RING, WIDEST_SECTOR = 30.0, 60.0
"""Degrees between neighbouring samples in theta_o and dphi beyond which nothing is known between them."""


@dataclass(frozen=True, eq=False)
class Table:
    """A BRDF as a list of directions, and what is known about it."""

    theta_i: Floats
    """(n,), degrees; a negative polar angle stands for the opposite azimuth."""
    phi_i: Floats
    theta_o: Floats
    dphi: Floats
    """(n,), degrees: phi_o - phi_i."""
    brdf: Floats
    """(n, channels), 1/sr, NaN where unknown."""
    wavelengths: Floats
    """(channels,), nm; nominal ones if the channels are colours."""
    standard_error: Floats | None = None
    """(n, channels), 1/sr."""
    basis: Basis = "spectrum"
    isotropic: bool | None = None
    """Whether only the relative azimuth matters; None if the file does not tell: then it does if there is but one."""
    detector: HemisphereGrid | None = None
    """The bins whose averages these are; None if the file does not tell."""
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of_rows(
        cls,
        theta_i: Floats,
        phi_i: Floats,
        theta_o: Floats,
        dphi: Floats,
        wavelength: Floats,
        brdf: Floats,
        standard_error: Floats | None = None,
        **about: Any,
    ) -> Self:
        """From a list in which every wavelength has a row of its own, in any order; rows that repeat are averaged.

        Wavelengths come in the order in which the list has them first. Raises ValueError if it is no table.
        """
        _insist_on_rows(theta_i, phi_i, theta_o, dphi, wavelength)
        if wavelength.min() <= 0:
            raise ValueError(f"wavelength = {wavelength.min():g} must be positive")
        columns = _upright(theta_i, phi_i, theta_o, dphi)
        wavelengths, channel = _first_seen(wavelength)
        key = _joined([_nodes(column)[1] for column in columns])
        _, first, place = np.unique(key, return_index=True, return_inverse=True)
        shape = (len(first), len(wavelengths))
        if math.prod(shape) > 16 * len(key):
            raise ValueError(f"its {shape[0]} directions and {shape[1]} wavelengths do not form a table")
        cell = place * shape[1] + channel
        count = np.bincount(cell, minlength=math.prod(shape))

        def mean(values: Floats) -> Floats:
            with np.errstate(invalid="ignore"):
                return np.asarray(np.bincount(cell, values, minlength=len(count)) / count).reshape(shape)

        errors = None if standard_error is None else mean(standard_error)
        one, two, three, four = (column[first] for column in columns)
        return cls(one, two, three, four, mean(brdf), wavelengths, errors, **about)

    def in_colours(self, name: object) -> Self:
        """The same with the colours that a file says its channels are; a spectrum if it says nothing that fits."""
        for basis in NOMINAL:
            if name == basis and len(basis) == len(self.wavelengths):
                # Nominal wavelengths descend, in the order of the channels.
                order = np.argsort(-self.wavelengths)
                errors = None if self.standard_error is None else self.standard_error[:, order]
                return replace(
                    self,
                    brdf=self.brdf[:, order],
                    wavelengths=self.wavelengths[order],
                    standard_error=errors,
                    basis=basis,
                )
        return self

    def to_brdf(self) -> BRDF:
        """The BRDF that the list stands for. Raises ValueError if the list is none, empty, or too long."""
        _insist_on_rows(self.theta_i, self.phi_i, self.theta_o, self.dphi)
        theta_i, phi_i, theta_o, dphi = _upright(self.theta_i, self.phi_i, self.theta_o, self.dphi)
        isotropic = len(_nodes(phi_i[theta_i > 0])[0]) < 2 if self.isotropic is None else self.isotropic
        attributes = {**self.attributes, "isotropic": int(isotropic), "basis": self.basis}
        errors = None if self.standard_error is None else _known_values(self.standard_error)
        table = replace(
            self, theta_i=theta_i, phi_i=phi_i, theta_o=theta_o, dphi=dphi, brdf=_known_values(self.brdf),
            standard_error=errors, isotropic=isotropic, attributes=attributes,
        )  # fmt: skip
        measurement = table._measurement()
        return BRDF.of(measurement) if measurement is not None else table._interpolated()

    def _measurement(self) -> Measurement | None:
        """The measurement whose bins these are, if they are the bins of one."""
        grid = self.detector or _grid_of(_nodes(self.theta_o)[0], _nodes(self.dphi)[0])
        if grid is None:
            return None
        ring, sector = _places(grid.theta, self.theta_o), _places(np.append(grid.dphi, 360.0), self.dphi)
        (theta_i, row), (phi_i, column) = _nodes(self.theta_i), _nodes(self.phi_i)
        shape = (len(theta_i), len(phi_i), *grid.shape)
        # A short file that names narrow bins shall not become a large table.
        most = min(MOST_VALUES // len(self.wavelengths), 1000 * len(row))
        if ring is None or sector is None or math.prod(shape) > most:
            return None
        cell = np.ravel_multi_index((row, column, ring, sector % shape[3]), shape)
        once = np.bincount(cell, minlength=math.prod(shape)).reshape(*shape[:2], -1)
        if once.max() > 1 or not once.any(axis=2).all():
            return None
        values = _spread(self.brdf, cell, shape)
        errors = None if self.standard_error is None else _spread(self.standard_error, cell, shape)
        if not np.isfinite(values).any(axis=(2, 3, 4)).all():
            return None
        return tabulated(values, grid, theta_i, phi_i, self.wavelengths, errors, self.attributes)

    def _interpolated(self) -> BRDF:
        """Everything else: a function between the samples, and its averages with errors if those are known."""
        function = _Interpolant.over(self, self.brdf)
        phi_i = np.zeros(1) if self.isotropic else _nodes(self.phi_i)[0]
        detector = function.detector()
        if len(function.theta_i) * len(phi_i) * detector.bins * len(self.wavelengths) > MOST_VALUES:
            raise ValueError(
                f"its {len(function.theta_i)} polar angles and {len(phi_i)} azimuths of the light, seen in bins of "
                f"{detector.theta_step:g} x {detector.phi_step:g} degrees, are too many; split the file"
            )
        lobes = BRDF(
            evaluate=function,
            wavelengths=self.wavelengths,
            theta_i=function.theta_i,
            phi_i=phi_i,
            isotropic=bool(self.isotropic),
            basis=self.basis,
            detector=detector,
            attributes=self.attributes,
        )
        if self.standard_error is None or not np.isfinite(self.standard_error).any():
            return lobes
        # The error of an average of interpolated values is taken to be that of the values: they err together.
        errors = replace(lobes, evaluate=_Interpolant.over(self, self.standard_error)).measured().dataset["brdf"]
        known = lobes.measured().dataset
        return replace(
            lobes,
            measurement=tabulated(
                known["brdf"].values[0], lobes.detector, lobes.theta_i, phi_i, self.wavelengths,
                errors.values[0], known.attrs,
            ),
        )  # fmt: skip


def frame(content: bytes, **options: Any) -> Any:
    """Delimited text as a `pandas.DataFrame` of doubles, each the nearest to its decimal."""
    import pandas  # type: ignore[import-untyped]

    # Since 3.1 pandas reads like this anyway, and warns if told to.
    old = tuple(int(number) for number in pandas.__version__.split(".")[:2]) < (3, 1)
    exact = {"float_precision": "round_trip"} if old else {}
    return pandas.read_csv(
        io.BytesIO(content), dtype=np.float64, encoding="utf-8", encoding_errors="replace", **exact, **options
    )


def degrees(radians: ArrayLike) -> Floats:
    """Degrees of `radians` that may have been rounded to six decimals: whole hundredths where they are meant."""
    angle = np.degrees(np.asarray(radians, np.float64))
    whole = np.round(angle, 2)
    return np.where(np.abs(angle - whole) < SAME, whole, angle)


def decimal(value: float) -> str:
    """The shortest decimal that reads back as `value`, never with an exponent."""
    return np.format_float_positional(value, trim="-")


def incidences(measurement: Measurement) -> Iterator[tuple[float, float, Floats, Floats]]:
    """theta_i, phi_i, the BRDF and its standard error (rings, sectors, channels) of every measured incidence."""
    data = measurement.dataset.sel(order="all")
    for i, j in np.argwhere(measurement.measured):
        theta, phi = (float(data[name][k]) for name, k in (("theta_i", i), ("phi_i", j)))
        yield theta, phi, *(data[name].values[i, j] for name in ("brdf", "brdf_standard_error"))


def detector_of(named: Any) -> HemisphereGrid | None:
    """The bins that a file's own description names; None if it names none."""
    try:
        theta, phi = float(named["theta_step"]), float(named["phi_step"])
        # Arrays as long as the number of bins are made of it.
        if 90 / theta * 360 / phi > MOST_VALUES >> 4:
            return None
        return HemisphereGrid(theta_step=theta, phi_step=phi, spacing=named["spacing"])
    except (ValueError, TypeError, KeyError, ArithmeticError):
        return None


def grid_of_steps(theta: float, phi: float) -> HemisphereGrid:
    """Bins about as wide as these steps in degrees."""
    rings = math.ceil(90 / min(max(theta, 0.5), 10.0) - 1e-6)
    sectors = math.ceil(180 / min(max(phi, 0.5), 20.0) - 1e-6)
    return HemisphereGrid(theta_step=90 / rings, phi_step=180 / sectors)


def title_of(text: object) -> str:
    """Text on one line."""
    return " ".join(str(text).split())


# --- The list --------------------------------------------------------------------------------------------------------


def _insist_on_rows(*columns: Floats) -> None:
    if not columns[0].size:
        raise ValueError("it holds no values")
    if not all(np.isfinite(column).all() for column in columns):
        raise ValueError("a direction or a wavelength is missing or no number")


def _known_values(values: Floats) -> Floats:
    """`values` in 1/sr with NaN for those that are not finite. Raises ValueError if they are absurdly large."""
    known = np.where(np.isfinite(values), values, np.nan)
    most = np.abs(known).max(initial=0.0, where=~np.isnan(known))
    if most > LARGEST_BRDF:
        raise ValueError(f"a value of {most:g} 1/sr is no BRDF")
    return known


def _upright(theta_i: Floats, phi_i: Floats, theta_o: Floats, dphi: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """The same directions with polar angles of 0 to 90 and azimuths of 0 to 360 degrees."""
    for name, theta in (("theta_i", theta_i), ("theta_o", theta_o)):
        if np.abs(theta).max() > 90 + SAME:
            raise ValueError(f"{name} = {theta[np.abs(theta).argmax()]:g} must lie between 0 and 90 degrees")
    turned_i, turned_o = 180.0 * (theta_i < 0), 180.0 * (theta_o < 0)
    return (
        np.minimum(np.abs(theta_i), 90.0),
        _around(phi_i + turned_i),
        np.minimum(np.abs(theta_o), 90.0),
        _around(dphi + turned_o - turned_i),
    )


def _around(azimuth: Floats) -> Floats:
    """Azimuths from 0 to 360 degrees; those that rounding left just below 360 are 0."""
    wrapped = azimuth % 360.0
    return np.where(wrapped > 360.0 - SAME, 0.0, wrapped)


def _nodes(values: Floats) -> tuple[Floats, Index]:
    """The different values, ascending, and which of them each is; rounding makes no difference."""
    exact, index = np.unique(values, return_inverse=True)
    first = np.diff(exact, prepend=-np.inf) > SAME
    group = np.cumsum(first) - 1
    if exact.size and (exact - exact[first][group]).max() > 3 * SAME:
        # Values everywhere: a chain of neighbours that are the same is no node.
        return exact, index
    return exact[first], group[index]


def _first_seen(values: Floats) -> tuple[Floats, Index]:
    """The different values in the order in which they appear, and which of them each is."""
    different, first, index = np.unique(values, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return different[order], rank[index]


def _joined(indices: Sequence[Index]) -> Index:
    """One number for each combination of `indices`, (n,)."""
    key, size = np.zeros(len(indices[0]), np.intp), 1
    for index in indices:
        count = int(index.max()) + 1
        if size * count > 1 << 62:
            values, key = np.unique(key, return_inverse=True)
            size = len(values)
        key, size = key * count + index, size * count
    return key


def _places(nodes: Floats, values: Floats) -> Index | None:
    """Which node each value is; None if one is none. The tolerance is ten roundings."""
    nearest = np.searchsorted((nodes[1:] + nodes[:-1]) / 2, values)
    return nearest if np.abs(nodes[nearest] - values).max() < 10 * SAME else None


def _spread(column: Floats, cell: Index, shape: tuple[int, ...]) -> Floats:
    """Rows at their places in the whole table, (*shape, channels); NaN elsewhere."""
    table = np.full((math.prod(shape), column.shape[1]), np.nan)
    table[cell] = column
    return table.reshape(*shape, -1)


def _grid_of(theta: Floats, dphi: Floats) -> HemisphereGrid | None:
    """The bins of which these are the centres, all of them; None if there are no such bins."""
    if len(dphi) % 2 or len(theta) < 2:
        return None
    for step, spacing in ((90 / (len(theta) - 1), "angle"), (90 / len(theta), "projected_area")):
        grid = HemisphereGrid(theta_step=step, phi_step=360 / len(dphi), spacing=spacing)  # type: ignore[arg-type]
        if all(np.abs(nodes - ours).max() < 10 * SAME for nodes, ours in ((grid.theta, theta), (grid.dphi, dphi))):
            return grid
    return None


# --- Interpolation ---------------------------------------------------------------------------------------------------


class _Hemisphere(Protocol):
    """What is known at one incidence."""

    @property
    def steps(self) -> tuple[float, float]:
        """Typical distances in theta_o and dphi, degrees."""

    def at(self, theta: Floats, dphi: Floats) -> Floats:
        """(n, channels), NaN where nothing is known."""


@dataclass(frozen=True)
class _Interpolant:
    """`BRDF.evaluate` between the incidences of a table."""

    theta_i: Floats
    phi_i: Sequence[Floats]
    """Azimuths of each polar angle; one, 0, if the table is isotropic."""
    hemispheres: Sequence[Sequence[_Hemisphere]]
    isotropic: bool
    channels: int

    @classmethod
    def over(cls, table: Table, values: Floats) -> Self:
        """Of `values` (n, channels) at the rows of `table`."""
        isotropic = bool(table.isotropic)
        theta_i, row = _nodes(table.theta_i)
        phi_i, column = _nodes(np.zeros(len(row)) if isotropic else table.phi_i)
        key = row * len(phi_i) + column
        order = np.argsort(key, kind="stable")
        starts = np.flatnonzero(np.diff(key[order], prepend=-1))
        if len(starts) > MOST_INCIDENCES:
            raise ValueError(f"its light comes from {len(starts)} directions, more than {MOST_INCIDENCES}")
        azimuths: list[list[float]] = [[] for _ in theta_i]
        hemispheres: list[list[_Hemisphere]] = [[] for _ in theta_i]
        scattered = 0
        for chosen in np.split(order, starts[1:]):
            i, j = divmod(int(key[chosen[0]]), len(phi_i))
            known = _hemisphere(table.theta_o[chosen], table.dphi[chosen], values[chosen], mirrored=isotropic)
            scattered += len(chosen) if isinstance(known, _Cloud) else 0
            if scattered > MOST_SCATTERED:
                raise ValueError(f"more than {MOST_SCATTERED} scattered directions are not supported; use a grid")
            azimuths[i].append(float(phi_i[j]))
            hemispheres[i].append(known)
        return cls(theta_i, [np.array(a) for a in azimuths], hemispheres, isotropic, values.shape[1])

    def detector(self) -> HemisphereGrid:
        """Bins that resolve the samples."""
        steps = np.array([known.steps for row in self.hemispheres for known in row])
        return grid_of_steps(*np.median(steps, axis=0).tolist())

    def __call__(self, wi: Vectors, wo: Vectors) -> Floats:
        theta, phi = angles(wi)
        wh = half_vector(wi, wo)
        total = np.zeros((2, len(theta), self.channels))
        for row, at, weight in _sides(*bracket(self.theta_i, theta, "theta_i", "nearest")):
            for column, within, share in _sides(*self._columns(row, phi[at])):
                here = at[within]
                values = self._read(row, column, phi[here], wh[here], wo[here])
                _accumulate(total, here, weight[within] * share, values)
        return np.where(wo[:, 2:] > 0, _mean(total), 0.0)

    def _columns(self, row: int, phi: Floats) -> tuple[tuple[Index, Index], Floats]:
        return bracket_around(self.phi_i[row], phi, "nearest")

    def _read(self, row: int, column: int, phi: Floats, wh: Vectors, wo: Vectors) -> Floats:
        """What this incidence says of light from `phi`, where it would mirror about the same half vectors."""
        theta = self.theta_i[row]
        azimuth = phi if self.isotropic else np.full_like(phi, self.phi_i[row][column])
        # The light's own change of azimuth turns the half vector with it; light from the normal has no azimuth.
        turn = np.zeros_like(phi) if theta == 0 else azimuth - phi
        moved = reflect(direction(theta, azimuth), rotate_z(wh, turn))
        moved = np.where(moved[:, 2:] > 0, moved, rotate_z(wo, turn))
        theta_o, phi_o = angles(moved)
        return self.hemispheres[row][column].at(theta_o, (phi_o - azimuth) % 360)


def _sides(nodes: tuple[Index, Index], share: Floats) -> Iterator[tuple[int, Index, Floats]]:
    """Every node that counts, for which values it does, and with what weight."""
    for side, weights in zip(nodes, (1 - share, share), strict=True):
        for node in np.unique(side[weights > 0]):
            at = np.flatnonzero((side == node) & (weights > 0))
            yield int(node), at, weights[at]


def _accumulate(total: Floats, at: Index, weight: Floats, values: Floats) -> None:
    """Add values that are known to the sums `total` of values and of weights, (2, n, channels)."""
    known = np.isfinite(values)
    total[0, at] += weight[:, None] * np.where(known, values, 0.0)
    total[1, at] += weight[:, None] * known


def _mean(total: Floats) -> Floats:
    """The weighted mean of what is known, where that is at least half; NaN elsewhere."""
    values, known = total
    return np.where(known >= 0.5 - 1e-9, values / np.where(known > 0, known, 1.0), np.nan)


def _hemisphere(theta: Floats, dphi: Floats, values: Floats, mirrored: bool) -> _Hemisphere:
    """The samples of one incidence as rings and sectors if they are some, otherwise as scattered points.

    Those of one side of the plane of incidence stand for both if `mirrored`.
    """
    if mirrored and dphi.max() <= 180 + SAME:
        off = (dphi > SAME) & (dphi < 180 - SAME)
        theta, dphi = np.append(theta, theta[off]), np.append(dphi, 360 - dphi[off])
        values = np.concatenate([values, values[off]])
    (rings, ring), (sectors, sector) = _nodes(theta), _nodes(dphi)
    # One sample at the pole has no azimuth.
    sized = len(rings) * len(sectors) - (len(sectors) - 1) * (rings[0] == 0.0 and (ring == 0).sum() == 1)
    if sized > 2 * len(theta) and len(sectors) > 2:
        known = np.isfinite(values).all(axis=1)
        kept = known if known.any() else ~known
        return _Cloud(theta[kept], dphi[kept], values[kept])
    total = np.zeros((2, len(rings), len(sectors), values.shape[1]))
    known = np.isfinite(values)
    np.add.at(total[0], (ring, sector), np.where(known, values, 0.0))
    np.add.at(total[1], (ring, sector), known)
    table = np.where(total[1] > 0, total[0] / np.maximum(total[1], 1), np.nan)
    if rings[0] == 0.0 and (ring == 0).sum() == 1:
        table[0] = table[0, sector[ring == 0]]
    return _Rings(rings, sectors, _along_scans(rings, table))


def _along_scans(theta: Floats, table: Floats) -> Floats:
    """`table` (rings, sectors, channels) with the rings that a sector's scan has stepped over."""
    filled = table.copy()
    for j in np.flatnonzero(np.isnan(table[..., 0]).any(axis=0)):
        here = np.flatnonzero(np.isfinite(table[:, j]).all(axis=1))
        if len(here) < 2:
            continue
        gaps = np.diff(theta[here])
        stepped = np.repeat(gaps <= 2.1 * np.median(gaps), np.diff(here))
        rings = np.arange(here[0], here[-1])[stepped]
        for channel in range(table.shape[2]):
            filled[rings, j, channel] = np.interp(theta[rings], theta[here], table[here, j, channel])
    return filled


@dataclass(frozen=True)
class _Rings:
    """Samples at all crossings of some rings and sectors, holes apart."""

    theta: Floats
    dphi: Floats
    values: Floats
    """(rings, sectors, channels)."""

    @property
    def steps(self) -> tuple[float, float]:
        """Median distances; in a plane of incidence, bins are as narrow as what is known about it."""
        around = np.diff(self.dphi, append=self.dphi[0] + 360)
        narrow = around[around <= WIDEST_SECTOR]
        along = np.diff(self.theta)
        return float(np.median(along)) if along.size else 1.0, float(np.median(narrow)) if narrow.size else 1.0

    def at(self, theta: Floats, dphi: Floats) -> Floats:
        """Linear in both angles."""
        total = np.zeros((2, len(theta), self.values.shape[2]))
        rings, along = _between(self.theta, theta, WIDEST_RING)
        sectors, around = _between(self.dphi, dphi, WIDEST_SECTOR, period=360.0)
        everything = np.arange(len(theta))
        for ring, weight in zip(rings, (1 - along, along), strict=True):
            for sector, share in zip(sectors, (1 - around, around), strict=True):
                _accumulate(total, everything, np.nan_to_num(weight * share), self.values[ring, sector])
        return _mean(total)


def _between(
    nodes: Floats, values: Floats, widest: float, period: float | None = None
) -> tuple[tuple[Index, Index], Floats]:
    """The nodes on either side of `values` and how far between them; NaN where that is farther than nodes speak for.

    A node beside a gap wider than `widest`, or at an end, speaks for half the distance to its other neighbour.
    """
    count = np.arange(len(nodes))
    if period is None:
        ends, index = np.concatenate([nodes[:1] - 999, nodes, nodes[-1:] + 999]), np.pad(count, 1, mode="edge")
    else:
        ends, index = np.append(nodes, nodes[0] + period), np.append(count, 0)
        values = (values - nodes[0]) % period + nodes[0]
    low = np.clip(np.searchsorted(ends, values, side="right") - 1, 0, len(ends) - 2)
    gaps = np.diff(ends)
    reach = np.where(gaps <= widest, gaps, 1.0) / 2
    gap, above = gaps[low], values - ends[low]
    spoken = np.where(above <= np.roll(reach, 1)[low], 0.0, np.nan)
    spoken = np.where(gap - above <= np.roll(reach, -1)[low], 1.0, spoken)
    return (index[low], index[low + 1]), np.where(gap <= widest, above / gap, spoken)


@dataclass(frozen=True)
class _Cloud:
    """Scattered samples."""

    theta: Floats
    dphi: Floats
    values: Floats
    """(n, channels)."""

    @property
    def steps(self) -> tuple[float, float]:
        """The distance of neighbours in either direction."""
        return 2 * self._reach, 2 * self._reach

    @functools.cached_property
    def _points(self) -> Floats:
        return _disc(self.theta, self.dphi)

    @functools.cached_property
    def _tree(self) -> Any:
        from scipy.spatial import KDTree

        return KDTree(self._points)

    @functools.cached_property
    def _reach(self) -> float:
        """Half the distance between neighbours, degrees."""
        if len(self.theta) < 2:
            return 0.5
        return float(np.median(self._tree.query(self._points, k=2)[0][:, 1])) / 2

    @functools.cached_property
    def _mesh(self) -> Any:
        """The triangles between the points; None if they lie on a line."""
        from scipy.spatial import Delaunay, QhullError

        try:
            return Delaunay(self._points)
        except (QhullError, ValueError):
            return None

    def at(self, theta: Floats, dphi: Floats) -> Floats:
        """Linear over triangles; beyond them the nearest sample, if it is near."""
        wanted = _disc(theta, dphi)
        away, nearest = self._tree.query(wanted)
        near = (away <= self._reach)[:, None]
        beyond = np.where(near, self.values[nearest], np.nan)
        if self._mesh is None:
            return beyond
        corners, weights = self._triangles(wanted, nearest)
        inside = np.einsum("nk,nkc->nc", weights, self.values[corners])
        return np.where(np.isnan(inside), beyond, inside)

    def _triangles(self, wanted: Floats, nearest: Index) -> tuple[Index, Floats]:
        """The corners of the triangle around each point and their weights (n, 3); NaN outside of all.

        From a triangle at the nearest sample one goes through the edge that the point lies farthest behind, until it
        lies behind none: among Delaunay's triangles this ends. (SciPy's own search sets up a linear system for each.)
        """
        mesh = self._mesh
        # Points that lie upon others, or in line, belong to no triangle.
        here = mesh.vertex_to_simplex[nearest]
        here = np.where((here >= 0) & (here < len(mesh.simplices)), here, 0)
        weights = _barycentric(self._points[mesh.simplices[here]], wanted)
        going = np.flatnonzero(weights.min(axis=1) < -SAME)
        for _ in range(MOST_STEPS):
            # Flat triangles on the rim do not know inside from outside: over the rim only where no other way leads on.
            around = mesh.neighbors[here[going]]
            behind = np.where(around >= 0, weights[going], np.inf)
            beyond = np.where(behind.min(axis=1) < -SAME, around[np.arange(len(going)), behind.argmin(axis=1)], -1)
            weights[going[beyond < 0]] = np.nan
            going, beyond = going[beyond >= 0], beyond[beyond >= 0]
            here[going] = beyond
            weights[going] = _barycentric(self._points[mesh.simplices[beyond]], wanted[going])
            going = going[weights[going].min(axis=1) < -SAME]
            if not going.size:
                break
        weights[going] = np.nan
        return mesh.simplices[here], weights


def _barycentric(corners: Floats, points: Floats) -> Floats:
    """Weights of the corners (n, 3, 2) whose sums the points (n, 2) are; NaN for a triangle without area."""
    (ax, ay), (bx, by) = ((corners[:, k] - corners[:, 2]).T for k in (0, 1))
    x, y = (points - corners[:, 2]).T
    with np.errstate(invalid="ignore", divide="ignore"):
        first, second = (x * by - y * bx) / (ax * by - ay * bx), (ax * y - ay * x) / (ax * by - ay * bx)
        return np.asarray(np.stack([first, second, 1 - first - second], axis=-1))


def _disc(theta: Floats, dphi: Floats) -> Floats:
    """The hemisphere laid flat about its pole with true polar angles, (n, 2), degrees."""
    phi = np.radians(dphi)
    return np.stack([theta * np.cos(phi), theta * np.sin(phi)], axis=-1)
