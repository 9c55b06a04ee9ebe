"""Randomness that depends on nothing but its counters, and the way kernels are compiled."""

from __future__ import annotations

import numpy as np
from numba import njit, uint64

# Helpers take and return plain numbers: handing arrays or tuples of them on would count references at every call.
kernel = njit(cache=True, nogil=True, error_model="numpy")
"""What marks a numba kernel."""

WORD = uint64(0xFFFFFFFF)
"""The bits of a 32-bit word."""


@kernel
def philox(c0, c1, c2, c3, k0, k1):
    """Philox4x32-10 (Salmon et al. 2011, doi:10.1145/2063384.2063405): four 32-bit words, as uint64."""
    c0, c1, c2, c3 = uint64(c0) & WORD, uint64(c1) & WORD, uint64(c2) & WORD, uint64(c3) & WORD
    k0, k1 = uint64(k0) & WORD, uint64(k1) & WORD
    for _ in range(10):
        p0 = uint64(0xD2511F53) * c0
        p1 = uint64(0xCD9E8D57) * c2
        c0 = (p1 >> uint64(32)) ^ c1 ^ k0
        c1 = p1 & WORD
        c2 = (p0 >> uint64(32)) ^ c3 ^ k1
        c3 = p0 & WORD
        k0 = (k0 + uint64(0x9E3779B9)) & WORD
        k1 = (k1 + uint64(0xBB67AE85)) & WORD
    return c0, c1, c2, c3


@kernel
def uniform(word):
    """A 32-bit word as a number inside (0, 1)."""
    return (np.float64(word) + 0.5) * 2.0**-32
