"""Pyramids, a groove and a half-pipe of mirrors: how much light hits them how often."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from gonio.optics import Mirror
from gonio.validation.judging import Finding, t_test
from gonio.validation.measuring import GRID, specimen
from microsurfaces import Cylinders, Mesh, VGrooves


def by_geometry(quick: bool) -> Iterator[Finding]:
    """Numbers of hits under normal light that elementary geometry gives."""
    pyramids = specimen(_pyramids(math.degrees(math.atan(math.sqrt(2.0)))), Mirror(), (0.0,), quick, "one pyramid", 4)
    for hits, exact in ((2, 8 / 9), (3, 1 / 9)):
        words = f"pyramids of 54.7356 degrees, {hits} hits"
        yield t_test(words, pyramids.settings, pyramids.shares[:, 0, 0, hits, -1], exact)
    groove = specimen(VGrooves(angle=45.0).build(0), Mirror(), (0.0,), quick, "one groove", 3)
    yield t_test("groove of 45 degrees, 2 hits", groove.settings, groove.shares[:, 0, 0, 2, -1], 1.0)
    yield t_test("of these straight back", groove.settings, groove.shares[:, 0, 0, 2, : GRID.shape[1]].sum(axis=1), 1.0)
    relief = Cylinders(profile="grooves", distance=2.0, radius=1.0, chords=20_000).build(0)
    pipe = specimen(relief, Mirror(), (0.0,), quick, "20000 chords", 6)
    for hits in range(1, 6):
        # The normal angle up to which no more hits follow, of which the sine is a share of the opening.
        most, before = (math.sin((2 * k - 1) / (2 * k + 1) * math.pi / 2) for k in (hits, max(hits - 1, 0.5)))
        yield t_test(f"half-pipe, {hits} hits", pipe.settings, pipe.shares[:, 0, 0, hits, -1], most - before)


def _pyramids(angle: float) -> Mesh:
    """Regular square pyramids, base to base, with facets at `angle` degrees."""
    height = math.tan(math.radians(angle)) / 2
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, height]]
    return Mesh(np.array(corners, np.float64), np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]), (1.0, 1.0))
