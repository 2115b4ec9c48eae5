"""Demonstrations from arrays and files."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["demonstrations_of"]

FloatArray = NDArray[np.float64]


def demonstrations_of(given: Any) -> tuple[FloatArray, ...]:
    """Return demonstrations as arrays (T_j, D) of one dimension.

    Args:
        given: (N, T, D), or N arrays (T_j, D).

    Raises:
        ValueError: fewer than two, fewer than two samples in one, not all of one dimension, or a
            number that is not finite.
    """
    checked: list[FloatArray] = []
    for index, one in enumerate(given):
        path = np.array(one, np.float64)
        if path.ndim != 2 or path.shape[0] < 2 or path.shape[1] < 1:
            raise ValueError(
                f"demonstrations[{index}] must have shape (T, D) with T of at least 2, "
                f"got {path.shape}"
            )
        if checked and path.shape[1] != checked[0].shape[1]:
            raise ValueError(
                f"demonstrations must all have one dimension: demonstrations[{index}] has "
                f"{path.shape[1]}, demonstrations[0] has {checked[0].shape[1]}"
            )
        if not np.isfinite(path).all():
            row = int(np.flatnonzero(~np.isfinite(path).all(axis=1))[0])
            raise ValueError(
                f"demonstrations[{index}] must be finite, got {path[row].tolist()} at sample {row}"
            )
        path.setflags(write=False)
        checked.append(path)
    if len(checked) < 2:
        raise ValueError(f"demonstrations must be at least 2, got {len(checked)}")
    return tuple(checked)
