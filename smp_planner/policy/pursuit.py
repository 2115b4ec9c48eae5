"""State of an execution with replanning: a trajectory, and how it is gone along.

The phase runs as fast as the velocity limits of each segment allow, at most at a share of it that
was chosen, and comes to rest where the trajectory may turn a corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import FloatArray, IntArray
from smp_gym.control import execution_times
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.observation import CONTROL_PERIOD
from smp_gym.scene import Obstacle
from smp_planner.planning.clock import RAMP, segment_rates
from smp_planner.planning.forecasting import Looks
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Problem

__all__ = ["Pending", "Pursuit", "course", "highest_rate", "limits_of"]

MOST_HASTE = 1.25
"""Highest rate of the phase, in that of the demonstrations: what is left of a trajectory slows down
towards its end, and could be run through in no time."""

_ROUNDING = 1e-9

_NEAR_CORNER = 1e-3
"""Of the phase, within which a corner counts as reached."""


@dataclass(frozen=True, eq=False)
class Pending:
    """A plan that has been asked for.

    Attributes:
        due: step of the episode from which on it takes effect.
        plan: the plan.
        problem: that it solves.
        standing: whether it begins with the arm at rest, which must wait for it.
        backwards: whether the arm retreats, and must not go on before.
    """

    due: int
    plan: Plan
    problem: Problem
    standing: bool
    backwards: bool


@dataclass(frozen=True, eq=False)
class Pursuit:
    """State of an episode's execution with replanning.

    Attributes:
        plan: the last plan that has taken effect, good or not.
        problem: that it solves.
        particle: which of its particles is executed.
        trajectory: (T, 6) rad, what is done and what is ahead.
        limits: (T - 1,) 1/s, highest rates of the phase, see `limits_of`.
        expected: the problem that a plan was last asked for, with what it expects of obstacles.
        weight: (N,) of how many looks at each obstacle that is the mean.
        observed: step of the observation that this one is of.
        begins: step at which the first plan takes effect.
        phase: that has been reached.
        rate: 1/s, of the phase.
        factor: share of the highest speed that was chosen last.
        clearance: m, of the course that was chosen last, margins taken off.
        asked: step at which a plan was last asked for.
        pending: what was asked for and has not taken effect.
        seen: obstacles as they were known at the last observations, with their steps.
        looks: at obstacles, all together.
        corners: phases at which the trajectory may change its direction, for it was planned from
            rest there; they are passed at rest only, ascending.
        closing: control steps for which the arm still stands while the hand closes.
        arrived: step at which the end was reached.
        replans: how many plans were made anew.
        failed: how many of these held no good particle.
        stuck: how many of the last did not, one after the other.
        seconds: time of all these, s.
    """

    plan: Plan
    problem: Problem
    particle: int
    trajectory: FloatArray
    limits: FloatArray
    expected: Problem
    weight: IntArray
    observed: int
    begins: int
    phase: float = 0.0
    rate: float = 0.0
    factor: float = 1.0
    clearance: float = np.inf
    asked: int = 0
    pending: Pending | None = None
    seen: tuple[tuple[int, tuple[Obstacle, ...]], ...] = ()
    looks: Looks | None = None
    corners: tuple[float, ...] = ()
    closing: int = 0
    arrived: int | None = None
    replans: int = 0
    failed: int = 0
    stuck: int = 0
    seconds: float = 0.0

    @property
    def message(self) -> str:
        """Empty, or how many plans made anew held no good particle."""
        if not self.failed:
            return ""
        return f"{self.failed} of {self.replans} replans found no good particle"


def highest_rate(demonstrations: Demonstrations) -> float:
    """Return the highest rate, 1/s, of the phase where plans are made anew.

    It is `MOST_HASTE` times that at which demonstrations are executed.
    """
    return float(MOST_HASTE / np.median(execution_times(demonstrations.configurations)))


def limits_of(problem: Problem, trajectory: FloatArray) -> FloatArray:
    """Return the highest rates (T - 1,) 1/s of the phase on the segments of a trajectory."""
    return np.asarray(
        segment_rates(trajectory[None], problem.robot.velocity, problem.clock.most)[0]
    )


def _highest(pursuit: Pursuit, phase: float, backwards: bool = False) -> float:
    """Return the highest rate at a phase; backwards, that at which all that is done can be."""
    segment = min(int(phase * len(pursuit.limits) + 1e-9), len(pursuit.limits) - 1)
    if backwards:
        return float(pursuit.limits[: segment + 1].min())
    return float(pursuit.limits[segment])


def _turned(rate: float, target: float, highest: float) -> float:
    """Return the rate of the phase one control step later, on its way to a target."""
    change = max(highest, abs(rate)) * CONTROL_PERIOD / RAMP
    return rate + min(max(target - rate, -change), change)


def course(pursuit: Pursuit, factor: float, steps: int) -> tuple[FloatArray, float]:
    """Return phases (steps,) at the next control steps for a speed, and the last rate."""
    phases, phase, rate = np.empty(steps), pursuit.phase, pursuit.rate
    for k in range(steps):
        below = max((c for c in pursuit.corners if c < phase - _ROUNDING), default=0.0)
        above = min((c for c in pursuit.corners if c > phase + _ROUNDING), default=np.inf)
        # What has been done is retreated along no faster than all of it can be.
        highest = _highest(pursuit, phase, backwards=min(factor, rate) < 0.0)
        rate = _turned(rate, factor * highest, highest)
        # What has to be passed at rest is approached ever more slowly.
        rate = min(max(rate, (below - phase) / RAMP), (above - phase) / RAMP)
        phase = min(max(phase + rate * CONTROL_PERIOD, 0.0), 1.0)
        for corner in (below, above):
            towards = rate < 0.0 if corner == below else rate > 0.0
            if towards and abs(corner - phase) < _NEAR_CORNER:
                phase, rate = corner, 0.0
        phases[k] = phase
    return phases, rate
