"""Surfaces given by a profile that runs along y: the plane, micro-cylinders, V-grooves."""

from __future__ import annotations

import numpy as np

from microsurfaces.height_field import HeightField
from microsurfaces.recipe import Positive, recipe


@recipe
class Flat:
    """A perfectly flat surface: the plane z = 0.

    Use it to check an instrument: a flat mirror must send everything into one direction, a flat Lambertian surface of
    reflectance R must give R/π everywhere.
    """

    side: Positive = 100.0
    """Side of the square tile, µm; no result depends on it."""

    def build(self, seed: int) -> HeightField:
        """The plane, 2 x 2 nodes; the same for every seed."""
        return HeightField(np.zeros((2, 2)), (self.side / 2, self.side / 2))
