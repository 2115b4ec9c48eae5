"""When a trajectory is executed: how phase runs in time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import minimum_filter1d

from smp_gym.arrays import FloatArray
from smp_gym.observation import CONTROL_PERIOD
from smp_planner.collision.costs import VELOCITY_FRACTION

__all__ = ["RAMP", "Clock", "segment_rates"]

RAMP = 0.2
"""s, in which the rate of the phase changes from one value to another."""

_LEAST_PART = 1e-3
"""Of the phase: what is left of a trajectory counts as at least so much."""


def segment_rates(
    trajectories: FloatArray, velocity: FloatArray, most: float = math.inf
) -> FloatArray:
    """Return the highest rates (P, T - 1) 1/s of the phase on segments of trajectories (P, T, n).

    No joint exceeds the share `VELOCITY_FRACTION` of its velocity limit, also soon after a segment:
    from the highest rate, which is `most` at most, the arm can slow down in time.

    Args:
        trajectories: (P, T, n) rad, at equal steps of phase.
        velocity: (n,) rad/s, velocity limits.
        most: 1/s, which no rate exceeds.
    """
    segments = trajectories.shape[1] - 1
    rates = np.minimum(_allowed_rates(trajectories, velocity), most)
    # Phase in which the rate falls to none within the ramp, and that of two control steps.
    braking = rates.max() * (0.5 * RAMP + 2.0 * CONTROL_PERIOD)
    window = min(int(braking * segments) + 2, segments)
    return np.asarray(
        minimum_filter1d(rates, window, axis=1, mode="nearest", origin=-(window // 2))
    )


def _allowed_rates(trajectories: FloatArray, velocity: FloatArray) -> FloatArray:
    """Return the rates (P, T - 1) 1/s that velocity limits (n,) allow on each segment by itself."""
    share = np.abs(np.diff(trajectories, axis=1)) / (VELOCITY_FRACTION * velocity)
    fastest = share.max(axis=2) * (trajectories.shape[1] - 1)
    return np.asarray(1.0 / np.maximum(fastest, _LEAST_PART))


@dataclass(frozen=True)
class Clock:
    """When the rest of a trajectory is executed, seen from an observation of the obstacles.

    What is before a phase is done. From there on the phase runs on at the rate that it has, and
    changes within `RAMP`, evenly in time, to the highest rate of each segment (`segment_rates`). So
    the joint velocities are continuous where the direction of the trajectory is. Without a rate it
    runs evenly, as fast as the whole rest allows.

    Attributes:
        phase: in [0, 1), from which on the trajectory is executed.
        delay: s, from the observation until then.
        rate: 1/s, of the phase then; None, if it runs evenly, as from rest to rest.
        most: 1/s, which the rate does not exceed, whatever the joints would allow.

    Raises:
        ValueError: a number is out of range.
    """

    phase: float = 0.0
    delay: float = 0.0
    rate: float | None = None
    most: float = math.inf

    def __post_init__(self) -> None:
        if not 0.0 <= self.phase < 1.0:
            raise ValueError(f"phase must lie in [0, 1), got {self.phase}")
        if not (math.isfinite(self.delay) and self.delay >= 0.0):
            raise ValueError(f"delay must be finite and not negative, got {self.delay}")
        if self.rate is not None and not math.isfinite(self.rate):
            raise ValueError(f"rate must be finite, got {self.rate}")
        if not self.most > 0.0:
            raise ValueError(f"most must be positive, got {self.most}")

    def first(self, samples: int) -> int:
        """Return the last of equal steps of phase that is not after the beginning."""
        return min(int(self.phase * (samples - 1) + 1e-9), samples - 2)

    def rates(self, trajectories: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return the rates (P,) 1/s at which the phase can run evenly over the rest.

        Args:
            trajectories: (P, T, n) rad, at equal steps of phase.
            velocity: (n,) rad/s, velocity limits.
        """
        rest = _allowed_rates(trajectories, velocity)[:, self.first(trajectories.shape[1]) :]
        return np.asarray(np.minimum(rest.min(axis=1), self.most))

    def times(self, trajectories: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return when each sample is passed, (P, T) s since the observation.

        What is done counts as passed when the rest begins.

        Args:
            trajectories: (P, T, n) rad, at equal steps of phase.
            velocity: (n,) rad/s, velocity limits.
        """
        count = trajectories.shape[1]
        ahead = np.maximum(np.linspace(0.0, 1.0, count) - self.phase, 0.0)
        if self.rate is None:
            return np.asarray(self.delay + ahead / self.rates(trajectories, velocity)[:, None])
        start = self.first(count)
        rates = segment_rates(trajectories, velocity, self.most)[:, start:]
        steady = np.zeros((len(trajectories), count))
        steady[:, start + 1 :] = np.cumsum(np.diff(ahead)[start:] / rates, axis=1)
        first = rates[:, :1]
        begin = max(self.rate, 0.0)
        ramped = 0.5 * (begin + first) * RAMP
        change = (first - begin) / RAMP
        # Solves ahead = begin t + change t^2 / 2, in the form that is finite without a change.
        root = np.sqrt(np.maximum(begin**2 + 2.0 * change * ahead, 0.0))
        early = 2.0 * ahead / np.maximum(begin + root, 1e-12)
        gone = np.array(
            [
                np.interp(phase, ahead, times)
                for phase, times in zip(ramped[:, 0], steady, strict=True)
            ]
        )
        late = RAMP + steady - gone[:, None]
        return np.asarray(self.delay + np.where(ahead < ramped, np.minimum(early, RAMP), late))
