"""What moves ahead of the arm, and how fast it may go along its trajectory because of that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.observation import CONTROL_PERIOD
from smp_gym.scene import Obstacle
from smp_planner.collision.clearance_in_time import clearance_in_time
from smp_planner.collision.forecast import is_moving
from smp_planner.planning.assessment import HOLD
from smp_planner.planning.constraints import at_phases
from smp_planner.planning.forecasting import Looks, forecast_of, surprising
from smp_planner.planning.settings import PlanSettings
from smp_planner.policy.pursuit import Pursuit, course

__all__ = [
    "FACTORS",
    "LOOKAHEAD",
    "SAFE_DISTANCE",
    "TURN_WINDOW",
    "Turns",
    "clearances",
    "is_surprising",
    "outlook",
    "turns_of",
]

FACTORS = (1.0, 0.5, 0.0, -1.0)
"""Speeds along the trajectory that are tried in turn, as shares of the highest."""

LOOKAHEAD = 40
"""Control steps for which nothing that moves must be expected to be met: as far as forecasts reach.
"""

SAFE_DISTANCE = 0.005
"""m, beyond the margins of what moves, that count as safe."""

TURN_WINDOW = (2, 5)
"""Fewest and most control steps between two observations whose velocities say how these turn."""

Turns = Mapping[Obstacle, tuple[float, ...]]
"""At which rate (3,) rad/s the velocities of obstacles turn."""


def turns_of(
    seen: Sequence[tuple[int, tuple[Obstacle, ...]]],
) -> Turns:
    """Return at which rate the velocities of obstacles turn, from the last observations."""
    step, now = seen[-1]
    fewest, most = TURN_WINDOW
    before = [(k, then) for k, then in seen if fewest <= step - k <= most]
    if not before:
        return {}
    first, then = before[0]
    turns: dict[Obstacle, tuple[float, ...]] = {}
    for old, new in zip(then, now, strict=True):
        if not (is_moving(old) and is_moving(new)):
            continue
        v, w = np.array(old.velocity), np.array(new.velocity)
        axis = np.cross(v, w)
        sine = float(np.linalg.norm(axis))
        if sine > 0.0:
            angle = np.arctan2(sine, float(v @ w))
            rate = axis / sine * angle / ((step - first) * CONTROL_PERIOD)
            turns[new] = tuple(rate.tolist())
    return turns


def is_surprising(pursuit: Pursuit, looks: Looks, step: int, settings: PlanSettings) -> bool:
    """Return whether an obstacle is not where the present plan expected it, and noise is not why.

    The expectation is a mean of looks, as what is known now; both may have looks in common.
    """
    if not looks.obstacles:
        return False
    forecast = forecast_of(pursuit.expected.movable, pursuit.expected.turns, settings)
    expected = forecast.positions((step - pursuit.observed) * CONTROL_PERIOD)
    actual = np.array([obstacle.position for obstacle in looks.obstacles])
    away = np.linalg.norm(actual - expected, axis=1)
    variances = 1.0 / pursuit.weight + 1.0 / looks.count
    return bool(surprising(away, looks.deviation, variances).any())


def _near(pursuit: Pursuit, now: Sequence[Obstacle]) -> list[Obstacle]:
    """Return obstacles that move, or stand elsewhere than where the present plan was made for."""
    return [
        o
        for o, planned in zip(now, pursuit.problem.movable, strict=True)
        if is_moving(o) or float(np.abs(np.subtract(o.position, planned.position)).max()) > 1e-3
    ]


def outlook(
    pursuit: Pursuit,
    now: Sequence[Obstacle],
    turns: Turns,
    settings: PlanSettings,
    factors: Sequence[float] = FACTORS,
) -> tuple[float, float]:
    """Return the speed to choose, as a share of the highest, and its clearance, m.

    It is the first that is safe, or the one that keeps farthest away.

    Args:
        pursuit: the state.
        now: obstacles as they are known.
        turns: of these.
        settings: of forecasts.
        factors: speeds to choose from.
    """
    found = clearances([pursuit], now, turns, settings, factors)[0]
    safe = np.flatnonzero(found >= SAFE_DISTANCE)
    chosen = int(safe[0]) if len(safe) else int(found.argmax())
    return factors[chosen], float(found[chosen])


def clearances(
    pursuits: Sequence[Pursuit],
    now: Sequence[Obstacle],
    turns: Turns,
    settings: PlanSettings,
    factors: Sequence[float],
) -> FloatArray:
    """Return the clearances (N, F) m, margins taken off, of states that go on at speeds.

    Only what moves, or stands elsewhere than where the plan was made for, can be met; infinity
    without it.

    Args:
        pursuits: N states of one robot, whose plans were made for the same problem.
        now: obstacles as they are known.
        turns: of these.
        settings: of forecasts.
        factors: F speeds, as shares of the highest.
    """
    near = _near(pursuits[0], now)
    if not near:
        return np.full((len(pursuits), len(factors)), np.inf)
    steps, every = np.arange(LOOKAHEAD + 1), [(p, f) for p in pursuits for f in factors]
    phases = np.stack([[p.phase, *course(p, factor, LOOKAHEAD)[0]] for p, factor in every])
    paths = np.stack(
        [at_phases(p.trajectory[None], own)[0] for (p, _), own in zip(every, phases, strict=True)]
    )
    # What comes after the arm is done is nothing to it.
    arrival = np.where((phases >= 1.0).any(axis=1), (phases >= 1.0).argmax(axis=1), LOOKAHEAD)
    times = np.minimum(steps * CONTROL_PERIOD, arrival[:, None] * CONTROL_PERIOD + HOLD)
    robot = pursuits[0].problem.robot
    found = clearance_in_time(paths, times, robot, forecast_of(near, turns, settings))
    return found.reshape(len(pursuits), len(factors))
