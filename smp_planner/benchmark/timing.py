"""Run times of calls."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np

__all__ = ["median_time", "timed"]

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def timed(
    function: Callable[Parameters, Result], *args: Parameters.args, **kwargs: Parameters.kwargs
) -> tuple[float, Result]:
    """Return the seconds that a call took, and its result."""
    start = time.perf_counter()
    result = function(*args, **kwargs)
    return time.perf_counter() - start, result


def median_time(call: Callable[[], object], repeats: int) -> float:
    """Return the median of repeated calls, s; the first call, which may compile, is left out."""
    call()
    return float(np.median([timed(call)[0] for _ in range(repeats)]))
