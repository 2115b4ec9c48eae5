"""Sets as words of 64 bits, which compiled loops compare quickly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smp_gym.compiling import kernel

__all__ = ["ones", "packed"]


@kernel
def packed(flags: NDArray[np.bool_]) -> NDArray[np.uint64]:
    """Return (M, N) flags as (M, ceil(N / 64)) words of bits."""
    out = np.zeros((flags.shape[0], (flags.shape[1] + 63) // 64), np.uint64)
    for m in range(flags.shape[0]):
        for n in range(flags.shape[1]):
            if flags[m, n]:
                out[m, n // 64] |= np.uint64(1) << np.uint64(n % 64)
    return out


@kernel
def ones(word: np.uint64) -> np.int64:
    """Return the number of bits of a word that are set (the parallel sum of Knuth, TAOCP 7.1.3)."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    low = np.uint64(0x3333333333333333)
    word = (word & low) + ((word >> np.uint64(2)) & low)
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))
