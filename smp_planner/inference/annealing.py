"""Schedules: numbers that change over the iterations of a run."""

from __future__ import annotations

import math
from collections.abc import Callable

__all__ = [
    "Schedule",
    "check_steps",
    "cyclic_annealing",
    "linear_decay",
    "quadratic_annealing",
    "tanh_annealing",
]

Schedule = Callable[[int, int, float], float]
"""Map from iteration, iterations and the fraction that is annealed to a factor in (0, 1]."""

_TANH_RATE = 1.3
"""Argument at which the tanh ends; D'Angelo & Fortuin (2021), Annealed SVGD, Sec. 4."""


def _check(iteration: int, iterations: int, fraction: float = 1.0) -> None:
    if not 0 <= iteration < iterations:
        raise ValueError(f"iteration must be in 0 .. {iterations - 1}, got {iteration}")
    if not 0.0 < fraction <= 1.0:
        raise ValueError(f"fraction must be in (0, 1], got {fraction}")


def tanh_annealing(iteration: int, iterations: int, fraction: float = 0.7) -> float:
    """Return the factor of the annealed term: it rises as a tanh and is 1 from `fraction` on.

    The hyperbolic schedule of D'Angelo & Fortuin (2021), scaled so that it arrives at 1, where
    theirs ends at tanh 1.3 = 0.86: the last iterations have the true posterior as target.

    Args:
        iteration: 0 .. iterations - 1.
        iterations: of the whole run.
        fraction: part of the run that is annealed, in (0, 1].

    Returns:
        A factor in (0, 1].

    Raises:
        ValueError: an argument is out of range.
    """
    _check(iteration, iterations, fraction)
    progress = min(1.0, (iteration + 1) / (fraction * iterations))
    return math.tanh(_TANH_RATE * progress) / math.tanh(_TANH_RATE)


def quadratic_annealing(iteration: int, iterations: int, fraction: float = 0.7) -> float:
    """Return the factor of the annealed term: it rises as a square and is 1 from `fraction` on.

    As the temperature of a likelihood it rises slowly at first, where a small rise makes most
    draws of the prior unlikely.

    Args:
        iteration: 0 .. iterations - 1.
        iterations: of the whole run.
        fraction: part of the run that is annealed, in (0, 1].

    Returns:
        A factor in (0, 1].

    Raises:
        ValueError: an argument is out of range.
    """
    _check(iteration, iterations, fraction)
    return min(1.0, (iteration + 1) / (fraction * iterations)) ** 2


def cyclic_annealing(
    iteration: int, iterations: int, fraction: float = 0.7, cycles: int = 4
) -> float:
    """Return the factor of the annealed term: it rises to 1 in cycles and is 1 from `fraction` on.

    The cyclical schedule of D'Angelo & Fortuin (2021) with their exponent 1. Particles leave
    where they settled at the start of each cycle; here the cycles end before the run does, so
    that the last iterations have the true posterior as target.

    Args:
        iteration: 0 .. iterations - 1.
        iterations: of the whole run.
        fraction: part of the run that is annealed, in (0, 1].
        cycles: in that part, at least 1.

    Returns:
        A factor in (0, 1].

    Raises:
        ValueError: an argument is out of range.
    """
    _check(iteration, iterations, fraction)
    if cycles < 1:
        raise ValueError(f"cycles must be at least 1, got {cycles}")
    length = fraction * iterations / cycles
    if iteration >= cycles * length:
        return 1.0
    return min(1.0, (iteration % length + 1.0) / length)


def linear_decay(iteration: int, iterations: int, final: float) -> float:
    """Return a factor that falls in equal steps from 1 to `final` at the last iteration.

    Args:
        iteration: 0 .. iterations - 1.
        iterations: of the whole run.
        final: factor at the end, in [0, 1].

    Raises:
        ValueError: an argument is out of range.
    """
    _check(iteration, iterations)
    if not 0.0 <= final <= 1.0:
        raise ValueError(f"final must be in [0, 1], got {final}")
    return 1.0 - (1.0 - final) * iteration / max(iterations - 1, 1)


def check_steps(step_size: float, final_step: float, iterations: int) -> None:
    """Check what settings say of the steps of a run.

    Raises:
        ValueError: a number is out of range.
    """
    if not (math.isfinite(step_size) and step_size > 0):
        raise ValueError(f"step_size must be positive and finite, got {step_size}")
    if iterations < 1:
        raise ValueError(f"iterations must be at least 1, got {iterations}")
    if not 0.0 <= final_step <= 1.0:
        raise ValueError(f"final_step must be in [0, 1], got {final_step}")
