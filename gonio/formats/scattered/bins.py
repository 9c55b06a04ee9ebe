"""Bins of measurements that are written, and bins that suit the directions of a list."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from gonio.detectors import HemisphereGrid
from gonio.formats.scattered.rows import SAME
from gonio.measurement import Measurement
from microsurfaces.arrays import Floats

MOST_VALUES = 1 << 26
"""Of a table; half a GiB."""


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


def grid_of(theta: Floats, dphi: Floats) -> HemisphereGrid | None:
    """The bins of which these are the centres, all of them; None if there are no such bins."""
    if len(dphi) % 2 or len(theta) < 2:
        return None
    phi_step = 360 / len(dphi)
    for grid in (
        HemisphereGrid(theta_step=90 / (len(theta) - 1), phi_step=phi_step),
        HemisphereGrid(theta_step=90 / len(theta), phi_step=phi_step, spacing="projected_area"),
    ):
        if all(np.abs(nodes - ours).max() < 10 * SAME for nodes, ours in ((grid.theta, theta), (grid.dphi, dphi))):
            return grid
    return None
