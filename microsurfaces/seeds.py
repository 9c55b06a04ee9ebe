"""Random numbers of one kind that those of another do not disturb."""

from __future__ import annotations

import numpy as np


def derived_seed(seed: int, purpose: str, realisation: int = 0) -> int:
    """A 64-bit seed that depends on `seed`, the purpose and the realisation only.

    So a longer series of realisations begins as a shorter one.
    """
    entropy = (seed, realisation, *purpose.encode())
    return int(np.random.SeedSequence(entropy).generate_state(1, np.uint64)[0])
