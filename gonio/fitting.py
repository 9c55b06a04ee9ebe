"""Parameters of a model that describe a measurement best, how sure they are, and which of several models does better.

A fit compares what was counted with what a model would let one count: the energies E of the bins with the model's M.
It minimises the deviance of counts, 2 sum(E ln(E / M) - (E - M)) in units of the noise, by nonlinear least squares of
its roots: where counts are large, these are (E - M) / noise. Unlike measured weights, it does not favour the bins that
happened to be low, and it does not run away from a start far from the truth.

Sources: R. W. M. Wedderburn, Quasi-likelihood functions, Biometrika 61(3), 1974, doi:10.1093/biomet/61.3.439 (noise
known up to a factor); H. White, Maximum likelihood estimation of misspecified models, Econometrica 50(1), 1982,
doi:10.2307/1912526 (errors of a model that is not the truth); K. P. Burnham, D. R. Anderson, Model Selection and
Multimodel Inference, 2002, doi:10.1007/b97636 (QAICc, section 2.5).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from gonio.comparison import order_of, predicted
from gonio.detectors import Detector, HemisphereGrid
from gonio.measurement import Measurement
from gonio.models import Model
from gonio.models.parameters import bounds, starts, with_values
from gonio.sphere import direction
from microsurfaces.arrays import Floats, Vectors

CONFIDENCE = 0.95
"""Level of every interval."""

CORRELATED = 0.95
"""Parameters more correlated than this cannot be told apart by this measurement."""

_ENOUGH_BINS = 40.0
"""Bins that must share a lobe's light (its participation number) for bins to be joined before a fit."""

_WIDEST = 6.0, 15.0
"""Degrees in theta and phi beyond which bins are not joined."""

_KEPT = 0.9
"""Share of a lobe's known light that must remain where joined bins, a part of which is unknown, are left out."""

_BACKGROUND = 1e-3
"""Share of the mean BRDF that is added to both sides, so that a model's faintest tails do not decide a fit."""

_STEP = 0.01
"""Relative step of derivatives: far above the accuracy of bin averages, and of what a random walk's seed decides."""

_EDGE = 1e-3
"""Share of the way between its limits within which a parameter counts as pressed against one."""

_SCAN = 5
"""Values tried of every parameter before the search, to start it in the right valley."""


_DISTANCES = np.array([0.3, 0.8, 1.2, 1.5, 1.8, 2.1, 3.0, 5.0])
"""Distances of cylinders to start from: below 2, where they have no flat strips between them, they matter most."""


@dataclass(frozen=True)
class Parameter:
    """One fitted number."""

    name: str
    """Dotted name of the model's parameter."""
    value: float
    standard_error: float
    """Noise and misfit together."""
    noise: float
    """Standard error from the measurement's noise alone; NaN if it comes from elsewhere without errors."""
    misfit: float
    """Standard error from the model's not being the truth: how differently parts of the lobes would have it."""
    interval: tuple[float, float]
    """95 % confidence interval."""
    facets: float | None
    """The same number as the specimens' facets have it, where it is a roughness that was measured on them."""
    at_bound: bool
    """Whether the fit pressed it against a limit: its interval then means nothing."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A model's parameters as a measurement has them."""

    model: Model
    """The model with the fitted values."""
    parameters: tuple[Parameter, ...]
    correlation: Floats
    """Correlations between the parameters (k, k), noise and misfit together."""
    order: str
    """The order of scattering that was fitted."""
    deviance: float
    """In units of what a count carries, summed over all bins."""
    deviance_of_noise: float
    """What the measurement's standard errors lead one to expect of it; NaN if it has none."""
    parts: Floats
    """The deviance of every block of 3 x 3 bins and every incidence, all wavelengths together."""
    bins: int
    """How many numbers were fitted: bins x incidences x wavelengths."""
    l1: float
    """What is left: sum of |measured - model| over sum of model, over all bins."""
    normal_reflectance: tuple[tuple[float, float, float], ...]
    """(wavelength, F0, standard error): Fresnel reflectance at normal incidence, where the material was fitted."""
    incidences: tuple[tuple[float, float], ...]
    """(theta_i, phi_i) of what was fitted, degrees."""
    wavelengths: tuple[float, ...]
    """nm."""
    channels: tuple[str, ...]
    """What the values at these wavelengths are called: "550 nm", "R" ..."""
    left_out: int
    """How many bins of the fitted incidences took no part, because nothing is known of them."""

    @property
    def dispersion(self) -> float:
        """Variance about the model over that of the noise: 1 if nothing but noise is left; NaN without errors."""
        if math.isnan(self.deviance_of_noise):
            return math.nan
        return (
            self.deviance / max(self.deviance_of_noise, 1e-300) * self.bins / max(1, self.bins - len(self.parameters))
        )

    def sentences(self) -> list[str]:
        """The fit in plain sentences."""
        return [*map(_of_parameter, self.parameters), *self.remarks()]

    def remarks(self) -> list[str]:
        """What there is to say besides the numbers: reflectance, what is left over, and warnings."""
        return [*self._reflectances(), self._quality(), *self._reservations(), *self.warnings()]

    def warnings(self) -> list[str]:
        """What should keep one from believing the numbers."""
        found = [
            f"{p.name} = {p.value:.4g} stands at its limit: the model cannot describe this measurement better, and the "
            "interval means nothing; fix it, or free another parameter."
            for p in self.parameters
            if p.at_bound
        ]
        for (i, one), (j, other) in itertools.combinations(enumerate(self.parameters), 2):
            if abs(self.correlation[i, j]) > CORRELATED:
                found.append(
                    f"{one.name} and {other.name} have a correlation of {self.correlation[i, j]:.3f}: this measurement "
                    "hardly tells them apart; fix one of them, or measure more incidences."
                )
        return found

    def _reflectances(self) -> list[str]:
        return [
            f"F0 = {value:.4f} ± {error:.4f} at {channel} (reflectance at normal incidence)."
            for channel, (_, value, error) in zip(self.channels, self.normal_reflectance, strict=False)
        ]

    def _quality(self) -> str:
        if math.isnan(self.dispersion):
            return f"What is left is {self.l1:.2%} of the light (L1), over {self.bins} bins."
        left = "nothing but noise" if self.dispersion < 1.0 + 4.0 * np.sqrt(2.0 / self.bins) else "more than noise"
        return (
            f"What is left is {left}: {self.l1:.2%} of the light (L1), {self.dispersion:.3g} times the variance of the "
            f"noise, over {self.bins} bins."
        )

    def _reservations(self) -> list[str]:
        """What a measurement from elsewhere does not tell."""
        found = []
        if math.isnan(self.deviance_of_noise):
            found.append(
                "The errors of the measurement, or of some of its bins, are not known: intervals speak of misfit only, "
                "of how differently parts of the lobes would have the parameters."
            )
        if self.order != self.model.order:
            found.append(
                "The measurement does not keep apart how often light has hit the surface: "
                f"{type(self.model).__name__}, which speaks of the light of one hit, was fitted to all of it."
            )
        if self.left_out:
            found.append(
                f"{self.left_out} bins took no part: nothing is known of them, or of what they are joined with."
            )
        return found


class _Lobe(NamedTuple):
    """One incidence as it is fitted: energies, shares of the incident light."""

    wi: Vectors
    detector: Detector
    kept: NDArray[np.intp]
    """(bins,): which bins of the detector these are, those that are known at all wavelengths."""
    solid: Floats
    """(bins, 1) sr"""
    energy: Floats
    """(bins, W)"""
    error: Floats
    """(bins, W), standard errors, NaN if they are not known"""
    unit: Floats
    """(W,): variance per energy, what one count would carry."""
    background: Floats
    """(bins, W)"""
    blocks: NDArray[np.intp]
    """(bins,): which block of neighbours a bin belongs to; blocks disagree independently about a wrong model."""


def fit(
    measurement: Measurement,
    model: Model,
    free: Iterable[str] | None = None,
    theta_i: Iterable[float] | None = None,
    wavelengths: Iterable[float] | None = None,
) -> Fit:
    """Adjust the parameters called `free` (those that the model names if None) until `model` describes `measurement`.

    `model` is where the search starts; parameters that are not free stay as they are. `free` are dotted names such as
    "m", "k_d", "distribution.alpha", "material.eta", "local.reflectance". The order of scattering is the model's own.
    `theta_i` and `wavelengths` restrict what is fitted, degrees and nm.

    Neighbouring bins are joined as long as a lobe remains spread over 40 of them. The errors have two parts. Noise is
    that of the measurement's standard errors; all wavelengths of a bin share it, having travelled together. Misfit is
    how much more the blocks of 3 x 3 bins disagree about the parameters than noise explains. Intervals are Student's
    t with the degrees of freedom of both. Realisation noise that moves a whole lobe cannot be seen in one lobe: the
    parameters are those of the measured specimens.

    A measurement that comes from elsewhere keeps no orders apart: `model` is fitted to all of its light. The noise of
    its wavelengths counts as one too, which is the safe side. If it gives no errors (or not all of them) the intervals
    speak of misfit only. Bins that hold nothing at one of the wavelengths take no part.

    Raises ValueError, in one sentence, for a name that is no parameter or no number of the model, for incidences or
    wavelengths that were not measured, and if nothing was.
    """
    names = tuple(model.free if free is None else free)
    start = _start(model, names)
    lobes, incidences, chosen = _lobes(measurement, order_of(measurement, model), theta_i, wavelengths)

    def prediction(values: Floats) -> list[Floats]:
        candidate = with_values(model, dict(zip(names, values, strict=True)))
        return [predicted(candidate, lobe.wi, lobe.detector, chosen).value[lobe.kept] * lobe.solid for lobe in lobes]

    limits = np.array([bounds(model, name) for name in names])
    solution = _search(names, lambda values: _roots(lobes, prediction(values)), start, limits)
    return _fitted(measurement, model, names, solution, limits, lobes, prediction, incidences, chosen)


class Ranked(NamedTuple):
    """A fit's place among others."""

    fit: Fit
    difference: float
    """Of the information criterion to that of the best fit."""
    uncertainty: float
    """Standard deviation of the difference, from how the blocks of bins disagree about it."""

    @property
    def told_apart(self) -> bool:
        """Whether the measurement says that this model is worse than the best."""
        return self.difference > 2.0 * self.uncertainty


def rank(fits: Sequence[Fit]) -> list[Ranked]:
    """Fits of the same data from the best to the worst by QAICc, Akaike's criterion for small samples and rough noise.

    The scale of the noise is that of the measurement or, if that is more or not known, what the best model leaves over,
    so that a
    large sample does not turn small misfits into certainties; wavelengths of one bin count as one. Neighbouring bins
    may be wrong together, and no criterion knows it: the uncertainty comes from the scatter between blocks of bins (Q.
    H. Vuong, Econometrica 57(2), 1989, doi:10.2307/1912557). Raises ValueError if the fits are not of the same data
    and order.
    """
    if len({(f.order, f.bins, f.incidences, f.wavelengths) for f in fits}) > 1:
        raise ValueError("only fits of the same order, incidences and wavelengths can be ranked against each other.")
    closest = min(fits, key=lambda f: f.deviance)
    left = closest.deviance / max(1, closest.bins - len(closest.parameters))
    of_noise = np.nan_to_num(closest.deviance_of_noise) / closest.bins
    scale = max(left, of_noise, 1e-300) * len(closest.wavelengths)
    bins = closest.bins // len(closest.wavelengths)
    scores = {id(f): f.deviance / scale + _penalty(len(f.parameters) + 1, bins) for f in fits}
    best, *others = sorted(fits, key=lambda f: scores[id(f)])

    def ranked(other: Fit) -> Ranked:
        parts = (other.parts - best.parts) / scale
        return Ranked(other, scores[id(other)] - scores[id(best)], float(np.sqrt(parts.size) * parts.std(ddof=1)))

    return [Ranked(best, 0.0, 0.0), *map(ranked, others)]


def _penalty(parameters: int, bins: int) -> float:
    return 2.0 * parameters + 2.0 * parameters * (parameters + 1) / max(1, bins - parameters - 1)


# --- Parameters -------------------------------------------------------------------------------------------------------


def _start(model: Model, names: Sequence[str]) -> Floats:
    """Values of the named parameters of `model`, inside their bounds; ValueError for what cannot be fitted."""
    values = starts(model, names)
    try:
        with_values(model, dict(zip(names, values, strict=True)))
    except ValidationError as error:
        words = "; ".join(str(mistake["msg"]).removeprefix("Value error, ") for mistake in error.errors())
        raise ValueError(f"free = {list(names)}: these cannot be fitted together ({words}).") from None
    return np.array(values)


# --- What is fitted ---------------------------------------------------------------------------------------------------


def _lobes(
    measurement: Measurement, order: str, theta_i: Iterable[float] | None, wavelengths: Iterable[float] | None
) -> tuple[list[_Lobe], tuple[tuple[float, float], ...], Floats]:
    """Every incidence to be fitted, their angles, and the wavelengths."""
    data = measurement.dataset
    thetas = _chosen(data["theta_i"].values, theta_i, "theta_i", "degrees")
    chosen = _chosen(data["wavelength"].values, wavelengths, "wavelengths", "nm")
    picked = data.sel(order=order, wavelength=chosen)
    angles = [at for at in measurement.incidences() if at[0] in thetas]
    if not angles:
        raise ValueError("nothing was measured that could be fitted.")
    raw = []
    for theta, phi in angles:
        here = picked.sel(theta_i=theta, phi_i=phi)
        solid = measurement.detector.projected_solid_angles()[:, None]
        raw.append([here[name].values.reshape(-1, chosen.size) * solid for name in ("brdf", "brdf_standard_error")])
    detector, owner = _joined(measurement.detector, [energy for energy, _ in raw])
    known = [bool(np.isfinite(_summed(energy, owner, detector.bins)).all(axis=1).any()) for energy, _ in raw]
    if not any(known):
        raise ValueError("no bin is known at all of these wavelengths: fit them one at a time, with wavelengths.")
    angles, raw = list(itertools.compress(angles, known)), list(itertools.compress(raw, known))
    lobes = [
        _lobe(direction(*at), detector, owner, energy, error) for at, (energy, error) in zip(angles, raw, strict=True)
    ]
    if not any(lobe.energy.any() for lobe in lobes):
        raise ValueError(f"order {order!r} of the measurement holds no light: there is nothing to fit.")
    return lobes, tuple(angles), chosen


def _chosen(measured: Floats, wanted: Iterable[float] | None, name: str, unit: str) -> Floats:
    """Those of the `measured` values that are `wanted`."""
    if wanted is None:
        return measured
    values = np.array(list(wanted), np.float64)
    missing = [f"{value:g}" for value in values if not np.isclose(measured, value).any()]
    if missing or not values.size:
        there = ", ".join(f"{value:g}" for value in measured)
        raise ValueError(f"{name} = {', '.join(missing) or 'nothing'}: not measured; choose from {there} {unit}.")
    return measured[[bool(np.isclose(values, value).any()) for value in measured]]


def _joined(detector: Detector, energies: Sequence[Floats]) -> tuple[Detector, NDArray[np.intp]]:
    """The widest bins that still show the lobes' shape, and which of them each bin of `detector` belongs to."""
    alone = np.arange(detector.bins)
    if not isinstance(detector, HemisphereGrid):
        return detector, alone
    powers = [power for energy in energies if np.nansum(power := energy.sum(axis=1)) > 0.0]
    for wider in _wider(detector):
        owner = detector.owners(wider)
        joined = [np.bincount(owner, power, wider.bins).astype(np.float64) for power in powers]
        kept = all(np.nansum(p) >= _KEPT * np.nansum(power) for p, power in zip(joined, powers, strict=True))
        if kept and min((_participation(p) for p in joined), default=0.0) >= _ENOUGH_BINS:
            return wider, owner
    return detector, alone


def _participation(power: Floats) -> float:
    """How many bins share the light, those that are not known left out."""
    known = power[np.isfinite(power)]
    return float(known.sum() ** 2 / (known**2).sum())


def _wider(grid: HemisphereGrid) -> list[HemisphereGrid]:
    """Grids of whole bins of `grid`, the widest first."""
    factors = []
    for step, most, whole in ((grid.theta_step, _WIDEST[0], 90.0), (grid.phi_step, _WIDEST[1], 180.0)):
        odd = range(1, max(1, int(most / step)) + 1, 2)
        factors.append([f for f in odd if abs(whole / (f * step) - round(whole / (f * step))) < 1e-9][::-1])
    pairs = itertools.zip_longest(*factors)
    filled = [(a or 1, b or 1) for a, b in pairs]
    return [
        HemisphereGrid(theta_step=grid.theta_step * a, phi_step=grid.phi_step * b, spacing=grid.spacing)
        for a, b in filled
        if (a, b) != (1, 1)
    ]


def _lobe(wi: Vectors, detector: Detector, owner: NDArray[np.intp], energy: Floats, error: Floats) -> _Lobe:
    energy = _summed(energy, owner, detector.bins)
    kept = np.flatnonzero(np.isfinite(energy).all(axis=1))
    energy, variance = energy[kept], _summed(error**2, owner, detector.bins)[kept]
    solid = detector.projected_solid_angles()[kept, None]
    total = np.maximum(energy.sum(axis=0), 1e-300)
    noise = variance.sum(axis=0) / total
    # Without noise all bins weigh as counts do, in units that leave the deviance a number of order 1.
    unit = np.where(noise > 0.0, noise, total / len(energy))
    background = _BACKGROUND * total * solid / solid.sum()
    return _Lobe(wi, detector, kept, solid, energy, np.sqrt(variance), unit, background, _blocks(detector)[kept])


def _summed(values: Floats, owner: NDArray[np.intp], bins: int) -> Floats:
    total = np.zeros((bins, values.shape[1]))
    np.add.at(total, owner, values)
    return total


def _blocks(detector: Detector) -> NDArray[np.intp]:
    """Blocks of 3 x 3 neighbouring bins; apertures stand alone."""
    if not isinstance(detector, HemisphereGrid):
        return np.arange(detector.bins)
    rings, sectors = detector.shape
    across = -(-sectors // 3)
    # The specular direction, in the middle of the sectors, is in the middle of a block.
    ring, sector = (np.arange(rings) + 1) // 3, ((np.arange(sectors) - sectors // 2 + 1) % sectors) // 3
    return np.asarray(ring[:, None] * across + sector).ravel()


# --- Search -----------------------------------------------------------------------------------------------------------


def _roots(lobes: Sequence[_Lobe], predictions: Sequence[Floats]) -> Floats:
    """Signed roots of the deviance of every bin, in units of the noise."""
    roots = []
    for lobe, model in zip(lobes, predictions, strict=True):
        expected = model + lobe.background
        ratio = (lobe.energy + lobe.background) / expected
        deviance = 2.0 * expected * _kullback(ratio) / lobe.unit
        roots.append((np.sign(ratio - 1.0) * np.sqrt(deviance)).ravel())
    return np.concatenate(roots)


def _kullback(ratio: Floats) -> Floats:
    """u ln u - u + 1, accurate where u is 1."""
    x = ratio - 1.0
    near = np.abs(x) < 1e-3
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = np.where(ratio > 0.0, ratio * np.log(ratio), 0.0) - x
    return np.maximum(np.where(near, x * x * (0.5 - x / 6.0 + x * x / 12.0), exact), 0.0)


def _search(names: Sequence[str], roots: Callable[[Floats], Floats], start: Floats, limits: Floats) -> _Solution:
    """Least squares from the best of a few starts, within limits."""
    from scipy.optimize import least_squares

    best = min(_trials(names, start, limits, roots), key=lambda trial: float((roots(trial) ** 2).sum()))
    ruler = _Ruler(limits)
    solution = least_squares(
        lambda marks: roots(ruler.values(marks)),
        # The search starts inside the limits, where derivatives have two sides.
        np.clip(ruler.marks(best), 1.0 + _EDGE, 2.0 - _EDGE),
        jac="3-point",
        bounds=(1.0, 2.0),
        diff_step=ruler.step,
        x_scale="jac",
        xtol=1e-8,
        ftol=1e-10,
    )
    values = ruler.values(solution.x)
    return _Solution(
        np.where(np.abs(values) > 1e-12, values, 0.0),
        solution.fun,
        solution.jac / ruler.slopes(solution.x),
        (solution.x < 1.0 + 2 * _EDGE) | (solution.x > 2.0 - 2 * _EDGE),
    )


class _Solution(NamedTuple):
    """Where a search ended."""

    values: Floats
    """(k,)"""
    roots: Floats
    """(n,)"""
    jacobian: Floats
    """Of the roots, by the values: (n, k)."""
    at_bound: NDArray[np.bool_]
    """(k,)"""


class _Ruler:
    """Parameters on scales from 1 to 2, logarithmic between limits that are both positive."""

    def __init__(self, limits: Floats) -> None:
        self._logarithmic = limits[:, 0] > 0.0
        self._low, high = self._line(limits.T)
        self._length = high - self._low
        steps = np.where(self._logarithmic, _STEP, _STEP * self._length)
        self.step = steps / self._length / 1.5
        """Steps of derivatives, relative to a mark."""

    def _line(self, values: Floats) -> Floats:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self._logarithmic, np.log(values), values)

    def marks(self, values: Floats) -> Floats:
        """Where values are."""
        return np.asarray(1.0 + (self._line(values) - self._low) / self._length)

    def values(self, marks: Floats) -> Floats:
        """What is there."""
        line = self._low + (np.asarray(marks) - 1.0) * self._length
        return np.asarray(np.where(self._logarithmic, np.exp(line), line))

    def slopes(self, marks: Floats) -> Floats:
        """How fast values change with marks."""
        return np.asarray(self._length * np.where(self._logarithmic, self.values(marks), 1.0))


def _trials(names: Sequence[str], start: Floats, limits: Floats, roots: Callable[[Floats], Floats]) -> list[Floats]:
    """Where a search may start: the given place, or one of a grid over all parameters while that is small."""
    places = [_places(name, low, high) for name, (low, high) in zip(names, limits, strict=True)]
    if len(start) <= 2:
        return [start, *map(np.array, itertools.product(*places))]
    best = start
    for _ in range(2):
        for index, values in enumerate(places):
            moved = [np.where(np.arange(len(start)) == index, value, best) for value in values]
            best = min([best, *moved], key=lambda trial: float((roots(trial) ** 2).sum()))
    return [best]


def _places(name: str, low: float, high: float) -> Floats:
    """Values between two limits, evenly in the logarithm where the limits are positive."""
    if name == "distance":
        return _DISTANCES[(low <= _DISTANCES) & (high >= _DISTANCES)]
    share = (np.arange(_SCAN) + 0.5) / _SCAN
    return np.asarray(low * (high / low) ** share if low > 0.0 else low + (high - low) * share)


# --- Errors -----------------------------------------------------------------------------------------------------------


def _fitted(
    measurement: Measurement,
    model: Model,
    names: tuple[str, ...],
    solution: _Solution,
    limits: Floats,
    lobes: Sequence[_Lobe],
    prediction: Callable[[Floats], list[Floats]],
    incidences: tuple[tuple[float, float], ...],
    wavelengths: Floats,
) -> Fit:
    final = prediction(solution.values)
    noise, misfit, blocks = _covariances(lobes, final, solution.jacobian)
    covariance = np.nan_to_num(noise) + misfit
    error = np.sqrt(np.diag(covariance))
    fitted = with_values(model, dict(zip(names, solution.values, strict=True)))
    bins = solution.roots.size
    statistics = measurement.surface_statistics
    parameters = tuple(
        Parameter(
            name,
            float(solution.values[k]),
            float(error[k]),
            float(np.sqrt(noise[k, k])),
            float(np.sqrt(misfit[k, k])),
            _interval(solution.values[k], covariance[k, k], misfit[k, k], blocks - len(names), limits[k]),
            _of_facets(statistics, name),
            bool(solution.at_bound[k]),
        )
        for k, name in enumerate(names)
    )
    left = sum(np.abs(lobe.energy - value).sum() for lobe, value in zip(lobes, final, strict=True))
    return Fit(
        fitted,
        parameters,
        covariance / np.maximum(np.outer(error, error), 1e-300),
        order_of(measurement, model),
        float((solution.roots**2).sum()),
        _deviance_of_noise(lobes, final),
        _parts(lobes, solution.roots),
        bins,
        float(left / sum(value.sum() for value in final)),
        _normal_reflectance(fitted, names, solution.values, covariance, wavelengths),
        incidences,
        tuple(map(float, wavelengths)),
        tuple(
            name for name, nm in zip(measurement.channels, measurement.wavelengths, strict=True) if nm in wavelengths
        ),
        sum(lobe.detector.bins - lobe.kept.size for lobe in lobes),
    )


def _parts(lobes: Sequence[_Lobe], roots: Floats) -> Floats:
    """The deviance of every block of every lobe."""
    each = np.split(roots**2, np.cumsum([lobe.energy.size for lobe in lobes])[:-1])
    return np.concatenate(
        [
            np.bincount(lobe.blocks, part.reshape(lobe.energy.shape).sum(axis=1))
            for lobe, part in zip(lobes, each, strict=True)
        ]
    )


def _deviance_of_noise(lobes: Sequence[_Lobe], final: Sequence[Floats]) -> float:
    """The deviance that the measurement's standard errors lead one to expect."""
    return float(
        sum(
            (lobe.error**2 / (lobe.unit * (model + lobe.background))).sum()
            for lobe, model in zip(lobes, final, strict=True)
        )
    )


def _covariances(lobes: Sequence[_Lobe], final: Sequence[Floats], jacobian: Floats) -> tuple[Floats, Floats, int]:
    """Covariance of the parameters from noise, and from misfit beyond it; and how many blocks hold light.

    Of noise that is not known it is NaN, and all disagreement counts as misfit.
    Near the solution a root changes as -dM / sqrt(unit M), so that the scores dM (E - M) / (unit M) follow from the
    Jacobian of the roots.
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    noise, disagreement, blocks, at = np.zeros_like(inverse), np.zeros_like(inverse), 0, 0
    for lobe, model in zip(lobes, final, strict=True):
        bins, width = model.shape
        part = jacobian[at : at + model.size].reshape(bins, width, -1)
        at += model.size
        weight = 1.0 / np.sqrt(lobe.unit * (model + lobe.background))
        # Light of all wavelengths travelled together: their noise is one.
        alone = np.einsum("bwk,bw->bk", part, weight * lobe.error)
        noise += alone.T @ alone
        scores = np.einsum("bwk,bw->bk", part, weight * (lobe.energy - model))
        together = _summed(scores, lobe.blocks, int(lobe.blocks.max()) + 1)
        light = np.bincount(lobe.blocks, model.sum(axis=1))
        blocks += int(np.count_nonzero(light > 1e-3 * light.sum()))
        disagreement += together.T @ together
    disagreement *= blocks / max(1, blocks - len(inverse))
    beyond = _excess(disagreement, np.nan_to_num(noise), jacobian)
    return inverse @ noise @ inverse, inverse @ beyond @ inverse, blocks


def _excess(disagreement: Floats, noise: Floats, jacobian: Floats) -> Floats:
    """What `disagreement` has beyond `noise`, in every direction of the parameters; nothing where it has less."""
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    kept = values > 1e-12 * values.max()
    root = vectors[:, kept] * np.sqrt(values[kept])
    white = vectors[:, kept] / np.sqrt(values[kept])
    more, axes = np.linalg.eigh(white.T @ (disagreement - noise) @ white)
    return np.asarray(root @ (axes * np.maximum(more, 0.0)) @ axes.T @ root.T)


def _interval(value: float, total: float, misfit: float, freedom: int, limits: Floats) -> tuple[float, float]:
    """Confidence interval from the `total` variance, with the degrees of freedom that the misfit's share leaves.

    (Satterthwaite.)
    """
    from scipy.special import stdtrit

    share = misfit / total if total > 0.0 else 0.0
    freedom_of_both = max(2, freedom) / share**2 if share > 1e-3 else 1e6
    reach = float(stdtrit(freedom_of_both, (1.0 + CONFIDENCE) / 2.0) * np.sqrt(total))
    return max(float(value) - reach, float(limits[0])), min(float(value) + reach, float(limits[1]))


def _of_facets(statistics: Mapping[str, float | None], name: str) -> float | None:
    """The roughness measured on the facets that a parameter is meant to be."""
    last = name.rsplit(".", 1)[-1]
    if last in ("m", "alpha"):
        return statistics.get("beckmann_alpha")
    return statistics.get(f"beckmann_alpha_{last[-1]}") if last[:-1] in ("m_", "alpha_") else None


def _normal_reflectance(
    model: Model, names: Sequence[str], values: Floats, covariance: Floats, wavelengths: Floats
) -> tuple[tuple[float, float, float], ...]:
    """F0 and its standard error where the refractive index was fitted; by the delta method."""
    chosen = [k for k, name in enumerate(names) if name in ("material.eta", "material.k", "local.eta", "local.k")]
    if not chosen:
        return ()

    def reflectance(moved: Floats) -> Floats:
        candidate = with_values(model, {names[k]: moved[k] for k in chosen})
        material = getattr(candidate, names[chosen[0]].split(".")[0])
        return np.asarray(material.reflectance(np.array(1.0), wavelengths))

    steps = [1e-4 * max(abs(values[k]), 1e-2) for k in chosen]
    slopes = np.array(
        [
            (reflectance(values + np.eye(len(values))[k] * step) - reflectance(values)) / step
            for k, step in zip(chosen, steps, strict=True)
        ]
    )
    error = np.sqrt(np.einsum("kw,kl,lw->w", slopes, covariance[np.ix_(chosen, chosen)], slopes))
    return tuple(zip(wavelengths.tolist(), reflectance(values).tolist(), error.tolist(), strict=True))


def _of_parameter(p: Parameter) -> str:
    digits = 4 if not p.standard_error > 0.0 else max(4, int(np.ceil(-np.log10(p.standard_error))) + 1)
    noise = "" if math.isnan(p.noise) else f"noise {p.noise:.2g}, "
    sentence = (
        f"{p.name} = {p.value:.{digits}f} ± {p.standard_error:.{digits}f} "
        f"({noise}misfit {p.misfit:.2g}), "
        f"95 % between {p.interval[0]:.{digits}f} and {p.interval[1]:.{digits}f}"
    )
    if p.facets:
        sentence += f"; the facets have {p.facets:.{digits}f}, it is {p.value / p.facets - 1:+.1%} away"
    return sentence + "."
