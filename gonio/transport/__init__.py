"""Light paths. Two engines find the next hit, one over height fields and Embree over meshes; all else they share.

`scene` holds the geometry, `source` starts paths, `light` is what hits do to them, `scoring` counts them.
"""

from __future__ import annotations

from collections.abc import Callable

from gonio.transport import embree, height_field
from gonio.transport.accelerator import Accelerator
from gonio.transport.scene import Scene
from gonio.transport.scoring import Scores
from gonio.transport.setup import Setup

WAVE = embree.WAVE
"""Paths in flight in one worker; over height fields at most `height_field.LANES`."""


def trace(
    scene: Scene,
    setup: Setup,
    replicates: range,
    paths: int,
    scores: Scores,
    advanced: Callable[[int, int], bool],
    wave: int = WAVE,
) -> bool:
    """Trace all `paths` of each of a group of replicates into `scores`, which holds nothing yet.

    The replicates advance over the sample side by side: as many times more rays share what the caches hold of it.
    `advanced(paths, rays)` is told after every wave what was newly done; when it returns False the group is given up,
    and so is the answer.
    """
    traced = scene.geometry.traced
    if isinstance(traced, Accelerator):
        lanes = min(wave, height_field.LANES)
        return height_field.trace(traced, setup, replicates, paths, scores, advanced, lanes)
    return embree.trace(traced, setup, replicates, paths, scores, advanced, wave)
