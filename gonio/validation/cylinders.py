"""Smooth cylinders side by side: the surface that Poulin and Fournier's model is exact for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from gonio.models import PoulinFournier
from gonio.optics import Conductor, Lambertian, Mirror
from gonio.sphere import direction
from gonio.validation.judging import Finding, pooled, reduced_chi2, t_test
from gonio.validation.measuring import GRID, PHI_I, SOLID, THETA_I, specimen
from microsurfaces import Cylinders

GOLD = Conductor(eta=0.2, k=3.9)


def mirrors(quick: bool) -> Iterator[Finding]:
    """Mirror cylinders send light to a cone, known bin by bin; grooves also after two and more reflections."""
    yield from _cylinders(quick, "ridges", 1.9 if quick else 2.0, 0.0, Mirror(), orders=1)
    yield from _cylinders(quick, "ridges", 3.0, 0.5, Mirror(), orders=1)
    yield from _cylinders(quick, "grooves", 2.0, 0.0, Mirror(), orders=4)
    yield from _cylinders(quick, "grooves", 3.0, 0.5, GOLD, orders=4)


def diffusers(quick: bool) -> Iterator[Finding]:
    """Of Lambertian cylinders, what is lit and visible at once returns light after one reflection."""
    yield from _cylinders(quick, "ridges", 2.0, 0.0, Lambertian(0.8), orders=1, chords=2000)
    yield from _cylinders(quick, "grooves", 2.5, 0.3, Lambertian(0.8), orders=1, chords=2000)


def _cylinders(
    quick: bool,
    profile: Literal["ridges", "grooves"],
    distance: float,
    floor: float,
    material: Lambertian | Mirror | Conductor,
    orders: int,
    chords: int = 20_000,
) -> Iterator[Finding]:
    """Albedos and bins, order after order, against Poulin and Fournier."""
    relief = Cylinders(profile=profile, distance=distance, floor_height=floor, radius=1.0, chords=chords).build(0)
    model = PoulinFournier(local=material, profile=profile, distance=distance, floor_height=floor)
    light = specimen(relief, material, THETA_I, quick, f"{chords} chords", max(2, orders + 1), PHI_I)
    words = f"{profile} d = {distance:g}, h = {floor:g}, {type(material).__name__}"
    for order in range(1, orders + 1):
        pools = []
        for i, theta in enumerate(THETA_I):
            exact = np.stack([model.average(direction(theta, phi), GRID, order=order)[:, 0] for phi in PHI_I]) * SOLID
            shares = light.shares[:, i, :, order]
            pools += [pooled(shares[:, j, :-1], exact[j], light.paths) for j in range(len(PHI_I))]
            if exact.any():
                where, mean = f"{words}, order {order}, theta {theta:g}, albedo", shares[..., -1].mean(axis=1)
                yield t_test(where, light.settings, mean, exact.sum(axis=1).mean())
        blocks, expected = (np.concatenate(parts, axis=-1) for parts in zip(*pools, strict=True))
        yield reduced_chi2(f"{words}, order {order}, all incidences", light.settings, blocks, expected)
