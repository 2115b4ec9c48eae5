"""Limits of a motion along a path, and a motion along it, by which it is gone through in time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from smp_gym.arrays import FloatArray
from smp_planner.library.joint_path import JointPath

__all__ = ["Motion", "MotionLimits", "refused_speeds", "too_long"]


class Motion(Protocol):
    """Protocol of motions along a path: the length that is gone through, as a function of time."""

    @property
    def duration(self) -> float:
        """Time from start to end, s."""
        ...

    def progress(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return length (rad), speed, acceleration and jerk along the path at times (N,) s."""
        ...


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """What a motion of n joints along a path must keep.

    Attributes:
        velocity: (n,) rad/s or m/s.
        acceleration: (n,) rad/s² or m/s².
        jerk: (n,) rad/s³ or m/s³; None leaves it unlimited.
        start_speed: rate of the length where the path begins, rad/s.
        end_speed: where it ends, likewise.
        pace: s, see `TimingSettings`; None sets none.
    """

    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray | None
    start_speed: float
    end_speed: float
    pace: float | None

    @property
    def from_rest_to_rest(self) -> bool:
        """Whether a motion that is uniformly slower keeps all that this one keeps."""
        return self.start_speed == 0.0 and self.end_speed == 0.0

    def slower(self, share: float, velocity_share: float | None = None) -> MotionLimits:
        """Return limits that a motion keeps if it is slower by a share, but for the ends.

        Args:
            share: of the speed.
            velocity_share: of the limits of velocity, if it is another.
        """
        return MotionLimits(
            (share if velocity_share is None else velocity_share) * self.velocity,
            share**2 * self.acceleration,
            None if self.jerk is None else share**3 * self.jerk,
            self.start_speed,
            self.end_speed,
            None if self.pace is None else self.pace / share,
        )

    def greatest_speed(self, path: JointPath, lengths: FloatArray) -> FloatArray:
        """Return the greatest rate of the length, rad/s, that velocity and pace allow there."""
        with np.errstate(divide="ignore"):
            most = (self.velocity / np.abs(path.spline(lengths, 1))).min(axis=1)
        if self.pace is not None:
            most = np.minimum(most, path.demonstrated_speed(lengths, self.pace))
        return np.asarray(most)

    def exceeded(self, path: JointPath, motion: Motion, times: FloatArray) -> tuple[float, float]:
        """Return how many times slower a motion must be to keep the limits at times (N,) s.

        Those of velocity, and the others.
        """
        _, velocity, acceleration, jerk = path.moved(*motion.progress(times))
        other = np.sqrt((np.abs(acceleration) / self.acceleration).max())
        if self.jerk is not None:
            other = max(other, np.cbrt((np.abs(jerk) / self.jerk).max()))
        return float((np.abs(velocity) / self.velocity).max()), float(other)


def refused_speeds(
    path: JointPath, limits: MotionLimits, name: str, least: float, most: float
) -> ValueError:
    """Return the error of a velocity where a path begins or ends, with those that are allowed.

    Args:
        path: that is gone through.
        limits: of the motion.
        name: of the argument, ``start_velocity`` or ``end_velocity``.
        least: allowed rate of the length there, rad/s.
        most: likewise.
    """
    end = name == "end_velocity"
    norm = float(np.linalg.norm(path.tangent(end=end)))
    given = limits.end_speed if end else limits.start_speed
    between = f"of at most {norm * most:.4g}"
    if norm * least > 1e-3:
        between = f"from {norm * least:.4g} to {norm * most:.4g}"
    unit = " and ".join(f"{name}/s" for name in path.unit.split(" and "))
    other = "" if end else f", and an end_velocity of {_end_norm(path, limits):.4g} {unit}"
    return ValueError(
        f"{name} must have a norm {between} {unit} for this path and these limits{other}, got "
        f"{norm * given:.4g}"
    )


def _end_norm(path: JointPath, limits: MotionLimits) -> float:
    return float(np.linalg.norm(path.tangent(end=True)) * limits.end_speed)


def too_long(longest: float, duration: float) -> ValueError:
    """Return the error of a duration (s) that speeds at the ends do not allow."""
    return ValueError(
        f"duration must be at most {longest:.4g} s with these velocities where the path begins and "
        f"ends, got {duration:.4g}"
    )
