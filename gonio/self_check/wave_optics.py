"""What rays leave out of wave optics: polarisation and diffraction."""

from __future__ import annotations

import numpy as np

from gonio.measurement import Measurement
from gonio.optics import Conductor, Dielectric, Lambertian, fresnel_conductor
from gonio.self_check.report import Check, not_applicable, outcome
from gonio.self_check.sums import ExactSums

UNPOLARISED_ERROR = 0.01
"""Share of the reflected light that polarisation, which is not carried along, may move."""

COHERENT_SHARE = 0.01
"""Share of the light in the coherent, mirror-like reflection that rays do not know of."""


def polarisation(measurement: Measurement, sums: ExactSums) -> Check:
    """Light of several hits has unpolarised reflectances multiplied, which is wrong where s and p differ."""
    material = measurement.material
    if not isinstance(material, Conductor | Dielectric):
        return not_applicable("polarisation", f"{material!r} reflects all polarisations alike.")
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
    return outcome("polarisation", effect[worst] <= UNPOLARISED_ERROR, found, advice, numbers, "warning")


def geometric_optics(measurement: Measurement, sums: ExactSums) -> Check:
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
        return not_applicable("geometric optics", why)
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
    return outcome("geometric optics", not doubts, found, advice, numbers, "warning")


def _in_words(lengths: dict[str, float | None]) -> list[str]:
    return [f"{name} {length:.3g} µm" for name, length in lengths.items() if length is not None]
