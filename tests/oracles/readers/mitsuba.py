"""Mitsuba 3's `measured`: what it evaluates of a tensor file."""

import numpy as np
import pytest

from gonio.sphere import direction

MITSUBA = pytest.mark.needs("libatomic1")
"""Of tests that ask Mitsuba, whose wheel needs that library."""


def mitsuba(variant):
    """The module in this variant."""
    import mitsuba as mi

    mi.set_variant(variant)
    return mi


def evaluated(path, wi, wo, wavelengths=None):
    """f cos(theta_o) by Mitsuba's `measured`, (n, channels)."""
    mi = mitsuba("scalar_rgb" if wavelengths is None else "scalar_spectral")
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    context, si = mi.BSDFContext(), mi.SurfaceInteraction3f()
    values = []
    for one, other in zip(wi, wo, strict=True):
        si.wi = mi.Vector3f(*one)
        if wavelengths is not None:
            si.wavelengths = wavelengths
        values.append(np.array(bsdf.eval(context, si, mi.Vector3f(*other))))
    return np.array(values)


def pairs(count=2000, seed=7, quarter=False):
    """Directions wi, wo (count, 3), both even over the hemisphere, or wi over the quarter with x, y < 0.

    Mitsuba leaves the reduction of an isotropic file to chance, and it is never folded into another quarter from there.
    """
    rng = np.random.default_rng(seed)
    theta = np.degrees(np.arccos(rng.uniform(0.0, 1.0, (2, count))))
    wi, wo = direction(theta, rng.uniform(-180.0, 180.0, (2, count)))
    return np.where(quarter, [-1.0, -1.0, 1.0] * np.abs(wi), wi), wo
