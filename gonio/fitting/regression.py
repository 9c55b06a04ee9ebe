"""The fit of a model to a measurement: what is fitted, the search, and what was found with its errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from pydantic import ValidationError

from gonio.brdf import BRDF
from gonio.comparison import order_of, predicted
from gonio.fitting.binning import Observations, observations
from gonio.fitting.deviance import deviance_of_noise, parts, roots
from gonio.fitting.result import Fit, Parameter
from gonio.fitting.search import Solution, search
from gonio.fitting.uncertainty import Covariances, covariances, interval, normal_reflectance
from gonio.measurement import Measurement
from gonio.models import Model
from gonio.models.parameters import bounds, starts, with_values
from microsurfaces.arrays import Floats


def fit(
    measurement: Measurement | BRDF,
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
    that of the measurement's standard errors; all wavelengths of a bin share it, having travelled together. Lack of
    fit is how much more the blocks of 3 x 3 bins disagree about the parameters than noise explains. Intervals are
    Student's t with the degrees of freedom of both. Realisation noise that moves a whole lobe cannot be seen in one
    lobe: the parameters are those of the measured specimens.

    An external measurement keeps no orders apart: `model` is fitted to all of its light. The noise of its wavelengths
    counts as one too, which is the safe side. If it gives no errors (or not all of them) the intervals speak of lack of
    fit only. Bins that hold nothing at one of the wavelengths take no part.

    Raises ValueError, in one sentence, for a name that is no parameter or no number of the model, for incidences or
    wavelengths that were not measured, and if nothing was.
    """
    if isinstance(measurement, BRDF):
        measurement = measurement.measured()
    names = tuple(model.free if free is None else free)
    start = _start(model, names)
    limits = np.array([bounds(model, name) for name in names])
    observed = observations(measurement, order_of(measurement, model), theta_i, wavelengths)

    def energies(values: Floats) -> list[Floats]:
        return _energies(_with(model, names, values), observed)

    solution = search(names, lambda values: roots(observed.lobes, energies(values)), start, limits)
    final = energies(solution.values)
    errors = covariances(observed.lobes, final, solution.jacobian)
    parameters = _parameters(names, limits, solution, errors, measurement.surface_statistics)
    return _fitted(_with(model, names, solution.values), parameters, solution, errors, observed, final)


def _with(model: Model, names: Sequence[str], values: Floats) -> Model:
    return with_values(model, dict(zip(names, values, strict=True)))


def _energies(model: Model, observed: Observations) -> list[Floats]:
    """Of every lobe the energies (bins, W) that `model` would let one count."""
    return [
        predicted(model, lobe.wi, lobe.detector, observed.wavelengths).value[lobe.kept] * lobe.solid
        for lobe in observed.lobes
    ]


def _start(model: Model, names: Sequence[str]) -> Floats:
    """Values of the named parameters of `model`, inside their bounds; ValueError for what cannot be fitted."""
    values = starts(model, names)
    try:
        _with(model, names, np.array(values))
    except ValidationError as error:
        words = "; ".join(str(mistake["msg"]).removeprefix("Value error, ") for mistake in error.errors())
        raise ValueError(f"free = {list(names)}: these cannot be fitted together ({words}).") from None
    return np.array(values)


def _parameters(
    names: Sequence[str],
    limits: Floats,
    solution: Solution,
    errors: Covariances,
    statistics: Mapping[str, float | None],
) -> tuple[Parameter, ...]:
    """Every fitted number with its errors and its interval."""
    freedom = errors.blocks - len(names)
    noise, lack_of_fit, total = (np.diag(variances) for variances in (errors.noise, errors.lack_of_fit, errors.total))
    return tuple(
        Parameter(
            name=name,
            value=float(solution.values[k]),
            standard_error=float(np.sqrt(total[k])),
            noise=float(np.sqrt(noise[k])),
            lack_of_fit=float(np.sqrt(lack_of_fit[k])),
            interval=interval(solution.values[k], total[k], lack_of_fit[k], freedom, limits[k]),
            facets=_of_facets(statistics, name),
            at_bound=bool(solution.at_bound[k]),
        )
        for k, name in enumerate(names)
    )


def _fitted(
    model: Model,
    parameters: tuple[Parameter, ...],
    solution: Solution,
    errors: Covariances,
    observed: Observations,
    final: Sequence[Floats],
) -> Fit:
    """The fit, from the model with its `parameters` and its `final` energies."""
    lobes, error = observed.lobes, np.sqrt(np.diag(errors.total))
    residual = sum(np.abs(lobe.energy - value).sum() for lobe, value in zip(lobes, final, strict=True))
    names = [parameter.name for parameter in parameters]
    return Fit(
        model=model,
        parameters=parameters,
        correlation=errors.total / np.maximum(np.outer(error, error), 1e-300),
        order=observed.order,
        deviance=float((solution.roots**2).sum()),
        deviance_of_noise=deviance_of_noise(lobes, final),
        parts=parts(lobes, solution.roots),
        bins=solution.roots.size,
        l1=float(residual / sum(value.sum() for value in final)),
        normal_reflectance=normal_reflectance(model, names, solution.values, errors.total, observed.wavelengths),
        incidences=observed.incidences,
        wavelengths=tuple(map(float, observed.wavelengths)),
        channels=observed.channels,
        left_out=sum(lobe.detector.bins - lobe.kept.size for lobe in lobes),
    )


def _of_facets(statistics: Mapping[str, float | None], name: str) -> float | None:
    """The roughness measured on the facets that a parameter is meant to be."""
    last = name.rsplit(".", 1)[-1]
    if last in ("m", "alpha"):
        return statistics.get("beckmann_alpha")
    return statistics.get(f"beckmann_alpha_{last[-1]}") if last[:-1] in ("m_", "alpha_") else None
