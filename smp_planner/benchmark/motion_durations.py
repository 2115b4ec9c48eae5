"""Durations of motions along planned paths, with and without limits of jerk.

`fastest_motion` leaves the jerk unlimited, `smooth_motion` limits it. One profile is one rise of
the length with limited jerk for the whole path, as a generator for a single degree of freedom gives
it, within limits that hold where the path is hardest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import FloatArray, checked_number
from smp_gym.assets import asset_path
from smp_planner.library.joint_path import JointPath
from smp_planner.library.smp import SMP, Robot

__all__ = ["MotionDurations", "durations_table", "least_of_one_profile", "motion_durations"]

_SHARES = np.linspace(0.05, 1.0, 60)
"""Shares of the greatest speed and acceleration that are tried for one profile."""


@dataclass(frozen=True)
class MotionDurations:
    """Durations of one path, s.

    Attributes:
        jerk: rad/s³, the limit.
        unlimited: of the fastest motion without it.
        smooth: with it.
        one_profile: with one rise of the length for the whole path.
    """

    jerk: float
    unlimited: float
    smooth: float
    one_profile: float


def motion_durations(
    tasks: Sequence[str], paths: int, acceleration: float, jerks: Sequence[float], seed: int
) -> list[MotionDurations]:
    """Return durations of paths that are drawn from the primitives of tasks.

    Args:
        tasks: whose demonstrations are learned from.
        paths: of each task.
        acceleration: rad/s², of all joints.
        jerks: rad/s³, limits of all joints.
        seed: of the paths.

    Raises:
        ValueError: a limit is not above 0.
    """
    acceleration = checked_number("acceleration", acceleration, above=0.0)
    jerks = [checked_number("jerk", jerk, above=0.0) for jerk in jerks]
    robot = Robot.from_urdf(asset_path("jaco", "jaco.urdf"), tip="j2s6s200_end_effector")
    found = []
    for task in tasks:
        arm = SMP.fit(asset_path("demonstrations", f"{task}.npz"), robot=robot)
        ends = {"start": arm.demonstrations[0][0], "goal": arm.demonstrations[0][-1]}
        plan = arm.adapt(**ends, particles=paths, seed=seed, method="promp")
        for path in plan.trajectories:
            # A rate at which no duration is rounded by much.
            unlimited = robot.timed(path, acceleration, rate=1000.0).duration
            for jerk in jerks:
                smooth = robot.timed(path, acceleration, jerk=jerk, rate=1000.0).duration
                one = least_of_one_profile(
                    JointPath(path, robot.dimension), robot.model.velocity, acceleration, jerk
                )
                found.append(MotionDurations(jerk, unlimited, smooth, one))
    return found


def durations_table(found: Sequence[MotionDurations]) -> str:
    """Return the medians, and the shares that are added to the fastest motion, in Markdown."""
    lines = [
        "| jerk, rad/s³ | paths | unlimited, s | limited, s | longer, % | one profile, % |",
        "|---|---|---|---|---|---|",
    ]
    for jerk in sorted({each.jerk for each in found}):
        group = [each for each in found if each.jerk == jerk]
        unlimited = np.array([each.unlimited for each in group])
        smooth = np.array([each.smooth for each in group])
        one = np.array([each.one_profile for each in group])
        longer, longest = 100.0 * (smooth / unlimited - 1.0), 100.0 * (one / unlimited - 1.0)
        lines.append(
            f"| {jerk:g} | {len(group)} | {np.median(unlimited):.2f} | {np.median(smooth):.2f} | "
            f"{np.median(longer):.1f} (at most {longer.max():.1f}) | {np.median(longest):.0f} |"
        )
    return "\n".join(lines)


def least_of_one_profile(
    path: JointPath, velocity: FloatArray, acceleration: float, jerk: float
) -> float:
    """Return the least duration, s, of one rise of the length in seven pieces of equal jerk.

    Args:
        path: whose limits it keeps everywhere.
        velocity: (n,) rad/s, limits of the joints.
        acceleration: rad/s², of all joints.
        jerk: rad/s³, of all joints.
    """
    at = np.linspace(0.0, path.length, 20 * len(path.knots))
    first, second, third = (np.abs(path.spline(at, order)) for order in (1, 2, 3))
    best = np.inf
    fastest = 1.0 / (first.max(axis=0) / velocity).max()
    for v in fastest * _SHARES:
        greatest = ((acceleration - second * v**2) / np.maximum(first, 1e-9)).min()
        if greatest <= 0.0:
            break
        for a in greatest * _SHARES:
            left = jerk - third * v**3 - 3.0 * second * v * a
            j = (left / np.maximum(first, 1e-9)).min()
            if j <= 0.0:
                break
            best = min(best, _seven_pieces(path.length, v, a, j))
    return best


def _seven_pieces(length: float, v: float, a: float, j: float) -> float:
    """Return the duration, s, from rest to rest within limits of speed, acceleration and jerk."""

    def gaining(top: float) -> float:
        return top / a + a / j if top * j > a**2 else 2.0 * np.sqrt(top / j)

    if length >= v * gaining(v):
        return float(length / v + gaining(v))
    tops = np.linspace(0.0, v, 1001)[1:]
    gains = np.where(tops * j > a**2, tops / a + a / j, 2.0 * np.sqrt(tops / j))
    return float(2.0 * np.interp(length, tops * gains, gains))
