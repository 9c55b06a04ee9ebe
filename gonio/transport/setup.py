"""What a light path needs to know beside the geometry."""

from __future__ import annotations

from typing import NamedTuple

from gonio.transport.light import SurfaceOptics
from gonio.transport.scoring import Bins
from gonio.transport.source import Source


class Setup(NamedTuple):
    """One incidence: where light comes from, what hits do to it, where it is counted."""

    source: Source
    optics: SurfaceOptics
    bins: Bins
