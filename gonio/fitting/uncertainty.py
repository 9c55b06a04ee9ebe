"""How sure fitted parameters are: what noise leaves open, and what the model's lack of fit does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gonio.fitting.binning import Lobe, summed
from gonio.models import Model
from gonio.models.parameters import with_values
from microsurfaces.arrays import Floats

CONFIDENCE = 0.95
"""Level of every interval."""


class Covariances(NamedTuple):
    """How sure parameters are."""

    noise: Floats
    """From the measurement's noise (k, k); NaN if that is not known."""
    lack_of_fit: Floats
    """From the model's not being the truth (k, k): disagreement between blocks of bins beyond their noise."""
    blocks: int
    """How many blocks of bins hold light."""

    @property
    def total(self) -> Floats:
        """Both together, as far as they are known (k, k)."""
        return np.nan_to_num(self.noise) + self.lack_of_fit


def covariances(lobes: Sequence[Lobe], final: Sequence[Floats], jacobian: Floats) -> Covariances:
    """Covariances of the parameters from the `final` energies of a model and the Jacobian of the roots.

    Where noise is not known all disagreement counts as lack of fit. Near the solution a root changes as
    -dM / sqrt(unit M), so that the scores dM (E - M) / (unit M) follow from the Jacobian.
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
        together = summed(scores, lobe.blocks, int(lobe.blocks.max()) + 1)
        light = np.bincount(lobe.blocks, model.sum(axis=1))
        blocks += int(np.count_nonzero(light > 1e-3 * light.sum()))
        disagreement += together.T @ together
    disagreement *= blocks / max(1, blocks - len(inverse))
    beyond = _excess(disagreement, np.nan_to_num(noise), jacobian)
    return Covariances(inverse @ noise @ inverse, inverse @ beyond @ inverse, blocks)


def _excess(disagreement: Floats, noise: Floats, jacobian: Floats) -> Floats:
    """What `disagreement` has beyond `noise`, in every direction of the parameters; nothing where it has less."""
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    kept = values > 1e-12 * values.max()
    root = vectors[:, kept] * np.sqrt(values[kept])
    white = vectors[:, kept] / np.sqrt(values[kept])
    more, axes = np.linalg.eigh(white.T @ (disagreement - noise) @ white)
    return np.asarray(root @ (axes * np.maximum(more, 0.0)) @ axes.T @ root.T)


def interval(value: float, total: float, lack_of_fit: float, freedom: int, limits: Floats) -> tuple[float, float]:
    """Confidence interval from the `total` variance, as sure as the share of the lack of fit in it allows.

    The lack of fit has `freedom` degrees of freedom, noise any number (Satterthwaite).
    """
    from scipy.special import stdtrit

    share = lack_of_fit / total if total > 0.0 else 0.0
    freedom_of_both = max(2, freedom) / share**2 if share > 1e-3 else 1e6
    reach = float(stdtrit(freedom_of_both, (1.0 + CONFIDENCE) / 2.0) * np.sqrt(total))
    return max(float(value) - reach, float(limits[0])), min(float(value) + reach, float(limits[1]))


def normal_reflectance(
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
