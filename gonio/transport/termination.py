"""How a path ends, and what bounds it."""

from __future__ import annotations

MAX_HITS = 10_000
"""Light trapped in a cusp between lossless cylinders needs more than 1,000."""


MAX_CROSSINGS = 10_000
"""Tiles that a path may cross between two hits."""


ABSORBED, TRUNCATED, LOST = 0, 1, 2
"""Rows of the energy budget: where light goes that does not escape."""


IN_FLIGHT, ESCAPED = -2, -1
"""Terminations of a path beside those rows."""


NEGLIGIBLE = 1e-9
"""A path whose largest weight is below this stops; what it carried is in the energy budget as truncated."""
