"""What is measured and what a model predicts: shares of the light in the bins of one grid."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Literal, NamedTuple

import numpy as np

from gonio.detectors import HemisphereGrid
from gonio.goniometer import Goniometer
from gonio.models import CookTorrance, Microfacet, PoulinFournier
from gonio.optics import Material, Mirror
from gonio.sphere import direction
from gonio.tally import UNIT
from gonio.transport.scene import Scene
from microsurfaces import HeightField, Mesh
from microsurfaces.arrays import Floats

BLOCKS = 32
"""Independent blocks of a measurement: their scatter is the error bar, with one degree of freedom less."""

GRID = HemisphereGrid(theta_step=5.0, phi_step=15.0)
"""Where the light is collected."""

SOLID = GRID.projected_solid_angles()
"""Projected solid angles of its bins, sr."""

THETA_I = (33.3, 61.7, 80.4)
"""Angles of incidence that have nothing to do with meshes, degrees."""

PHI_I = (20.0, 65.0)
"""Azimuths of the light, from across the axes of grooves and cylinders, degrees."""


class Light(NamedTuple):
    """What was measured: shares of the launched light, and how."""

    shares: Floats
    """(block, theta_i, phi_i, order, bin); order 0 is all of them and the last bin the whole hemisphere."""
    paths: int
    """Of all blocks, per incidence."""
    settings: str


def measured(scenes: Callable[[int], Iterable[Scene]], goniometer: Goniometer, blocks: int, words: str) -> Light:
    """Measure the scenes of every block; blocks side by side on all cores."""

    def measure(block: int) -> tuple[Floats, int]:
        each = [
            goniometer.measure(scene, seed=1000 * block + place, threads=1).counted
            for place, scene in enumerate(scenes(block))
        ]
        paths = len(each) * int(each[0]["paths"].values[0, 0])
        return np.sum([one["weight"].values[..., 0] for one in each], axis=0) / (UNIT * paths), paths

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        shares, paths = zip(*pool.map(measure, range(blocks)), strict=True)
    settings = f"{words}, {sum(paths) / 1e6:.2g} M paths an incidence in {blocks} blocks, seeds from 0"
    return Light(np.stack(shares), sum(paths), settings)


def instrument(
    theta_i: tuple[float, ...],
    paths: int,
    orders: int = 2,
    phi_i: tuple[float, ...] = (0.0,),
    azimuth: Literal["fixed", "average"] = "fixed",
) -> Goniometer:
    """A goniometer with the fewest replicates: the error bars come from blocks."""
    return Goniometer(
        theta_i=theta_i,
        phi_i=phi_i,
        wavelengths=(550.0,),
        paths=paths,
        detector=GRID,
        azimuth=azimuth,
        replicates=2,
        orders=orders,
    )


def specimen(
    relief: Mesh,
    material: Material,
    theta_i: tuple[float, ...],
    quick: bool,
    words: str,
    orders: int = 2,
    phi_i: tuple[float, ...] = (0.0,),
) -> Light:
    """One surface, measured in blocks that differ in the light alone."""
    scene, paths = Scene(relief, material), 2**14 if quick else 2**19
    return measured(lambda _: (scene,), instrument(theta_i, paths, orders, phi_i), BLOCKS, words)


def mirrors(build: Callable[[int], HeightField | Mesh], count: int, goniometer: Goniometer, words: str) -> Light:
    """So many mirror surfaces, one for every block."""
    return measured(lambda block: (Scene(build(block), Mirror()),), goniometer, count, words)


class Prediction(NamedTuple):
    """Shares of the light that a model of single scattering sends off: bins and hemisphere."""

    bins: Floats
    total: float


@functools.cache
def predicted(model: CookTorrance | Microfacet | PoulinFournier, theta: float, phi: float = 0.0) -> Prediction:
    """What `model` sends off of the light from (theta, phi), degrees."""
    bins = model.average(direction(theta, phi), GRID)[:, 0] * SOLID
    return Prediction(bins, float(bins.sum()))
