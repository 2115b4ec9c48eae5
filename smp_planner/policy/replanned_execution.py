"""Execution with replanning: plans asked for while the arm moves, and its speed along the present.

A plan that is asked for takes effect a given number of control steps later, whatever time planning
took. Until then the arm goes on along the present trajectory, which the new one leaves at the phase
that would be reached by then at most. So both are one up to there, and whenever the new one takes
effect, neither position nor velocity jumps.

How fast the arm goes along its trajectory is decided at every step, see
`smp_planner.policy.outlook`: as fast as nothing that moves is expected to be met for a while; else
slower; else it stops, or retreats along what it has done. Where nothing of that is safe, it does
what keeps farthest away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from smp_gym.control import reference_action
from smp_gym.observation import CONTROL_PERIOD, DecodedObservation
from smp_gym.robot.kinematics import UnreachableError
from smp_gym.scene import Obstacle
from smp_planner.planning.clock import Clock
from smp_planner.planning.constraints import at_phases
from smp_planner.planning.forecasting import Looks
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Problem
from smp_planner.planning.replanning import LEAST_RATE, resumed
from smp_planner.planning.settings import PlanSettings
from smp_planner.policy.observed_problem import seen_map
from smp_planner.policy.outlook import (
    FACTORS,
    LOOKAHEAD,
    SAFE_DISTANCE,
    TURN_WINDOW,
    Turns,
    clearances,
    is_surprising,
    outlook,
    turns_of,
)
from smp_planner.policy.pursuit import Pending, Pursuit, course, limits_of
from smp_planner.policy.tracking import CLOSING_STEPS, SETTLING_STEPS, GripperEvent

__all__ = ["LATENCY", "Replanner", "Replanning", "begin", "foreseen", "pursue"]

LATENCY = 2
"""Control steps from asking for a plan to its taking effect, unless another number is given."""

LAG = 0.15
"""rad, by which a joint may lag behind its reference before the arm slows down."""

_STANDING_RATE = 1e-6

PATIENCE = 4
"""Plans without a good particle, one after the other, after which one begins from the prior."""

_GAIN = 0.005
"""m, by which a trajectory that is not good must keep farther away to be taken all the same."""


@runtime_checkable
class Replanner(Protocol):
    """Protocol of planners that go on from a plan."""

    @property
    def can_replan(self) -> bool:
        """Whether its method can."""
        ...

    @property
    def plan_settings(self) -> PlanSettings:
        """Settings of plans."""
        ...

    def plan_once(self, problem: Problem) -> Plan:
        """Return a plan in one try, from the prior."""
        ...

    def replan(self, plan: Plan, problem: Problem, particle: int | None = None) -> Plan:
        """Return a plan for what is left of a problem."""
        ...


@dataclass(frozen=True)
class Replanning:
    """When plans are made anew.

    Attributes:
        every: control steps from one plan to the next, at most.
        latency: control steps from asking for a plan to its taking effect.

    Raises:
        ValueError: a number is not a positive integer.
    """

    every: int
    latency: int = LATENCY

    def __post_init__(self) -> None:
        for name, value in (("replan_every", self.every), ("latency", self.latency)):
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not whole or value < 1:
                raise ValueError(
                    f"{name} must be a positive whole number of control steps, got {value!r}"
                )


def foreseen(problem: Problem, replanning: Replanning, most: float) -> Problem:
    """Return a first problem as it is planned where plans will be made anew.

    Args:
        problem: that is posed.
        replanning: when the plan takes effect.
        most: 1/s, highest rate of the phase.
    """
    delay = replanning.latency * CONTROL_PERIOD
    horizon = delay + LOOKAHEAD * CONTROL_PERIOD
    return replace(problem, clock=Clock(delay=delay, rate=0.0, most=most), foresight=horizon)


def begin(
    plan: Plan, problem: Problem, particle: int, step: int, replanning: Replanning
) -> Pursuit:
    """Return the state in which an episode's execution begins.

    Args:
        plan: the first one.
        problem: that it solves, from `foreseen`.
        particle: that is executed.
        step: environment steps since the episode began.
        replanning: when the plan takes effect.
    """
    trajectory = np.array(plan.trajectories[particle])
    return Pursuit(
        plan=plan,
        problem=problem,
        particle=particle,
        trajectory=trajectory,
        limits=limits_of(problem, trajectory),
        expected=problem,
        weight=np.ones(len(problem.movable), np.int64),
        observed=step,
        begins=step + replanning.latency,
        asked=step,
    )


def _ask(
    pursuit: Pursuit,
    planner: Replanner,
    decoded: DecodedObservation,
    looks: Looks,
    turns: Turns,
    replanning: Replanning,
) -> Pursuit:
    """Return the state after a plan was asked for, from where the arm will be when it is there."""
    step, latency = decoded.elapsed_steps, replanning.latency
    waiting = step < pursuit.begins
    resting = abs(pursuit.rate) <= _STANDING_RATE
    standing = resting and (pursuit.factor <= 0.0 or waiting)
    backwards = pursuit.factor < 0.0 and not waiting
    phase, rate = pursuit.phase, 0.0
    if not standing:
        # At most so far does the arm get until then.
        phases, rate = course(pursuit, 0.0 if backwards else 1.0, latency)
        phase = float(phases[-1])
        # It may be passed in motion: what begins there has the present direction.
        rate = min(rate, -2.0 * LEAST_RATE) if backwards else max(rate, 2.0 * LEAST_RATE)
    if phase >= 1.0:
        return replace(pursuit, asked=step)
    delay = latency * CONTROL_PERIOD
    begins = None if phase == 0.0 and standing else rate
    cloud = None
    if decoded.points is not None:
        cloud = seen_map(decoded, pursuit.problem.robot.spheres)
    problem = resumed(
        pursuit.problem,
        pursuit.trajectory,
        Clock(phase, delay, begins, pursuit.problem.clock.most),
        looks.obstacles,
        turns,
        cloud,
        doubt=looks.doubt,
    )
    problem = replace(problem, foresight=delay + LOOKAHEAD * CONTROL_PERIOD)
    if pursuit.stuck < PATIENCE:
        plan = planner.replan(pursuit.plan, problem, pursuit.particle)
    else:
        try:
            plan = planner.plan_once(replace(problem, seed=problem.seed + 1 + pursuit.replans))
        except UnreachableError:
            return replace(
                pursuit,
                asked=step,
                expected=problem,
                weight=looks.count,
                observed=step,
                stuck=0,
            )
    failed = not plan.solved
    return replace(
        pursuit,
        asked=step,
        expected=problem,
        weight=looks.count,
        observed=step,
        pending=Pending(step + latency, plan, problem, standing, backwards),
        replans=pursuit.replans + 1,
        failed=pursuit.failed + failed,
        stuck=(pursuit.stuck + 1) % (PATIENCE + 1) if failed else 0,
        seconds=pursuit.seconds + plan.planning_time,
    )


def _take_effect(
    pursuit: Pursuit,
    now: Sequence[Obstacle],
    turns: Turns,
    settings: PlanSettings,
) -> Pursuit:
    """Return the state after the plan that was asked for has taken effect.

    Of the good particles it is the best that is safe by what is known now; what moves may have
    turned since the plan was asked for. Without a good particle the arm stays on its trajectory, at
    a speed that is safe. If nothing is safe, it takes the particle that keeps farthest from what
    moves, if that is farther than the present trajectory does.
    """
    pending = pursuit.pending
    assert pending is not None
    pursuit = replace(pursuit, pending=None)
    plan = pending.plan
    if plan.solved:
        best = _on(pursuit, pending, plan.chosen)
        if outlook(best, now, turns, settings, FACTORS[:1])[1] >= SAFE_DISTANCE:
            return best
        candidates = [int(p) for p in np.argsort(plan.ranks) if plan.good[p]]
    else:
        able = plan.executable & (True if plan.standing_free is None else plan.standing_free)
        if (able & plan.passing).mean() >= 0.5:
            pursuit = replace(pursuit, plan=plan)
        if plan.apart is None or not able.any():
            return pursuit
        candidates = [int(particle) for particle in np.flatnonzero(able)]
        best = None
    courses = [_on(pursuit, pending, particle) for particle in candidates]
    clearance = clearances(courses, now, turns, settings, FACTORS[:1])[:, 0]
    safe = np.flatnonzero(clearance >= SAFE_DISTANCE)
    if best is not None and len(safe):
        return courses[int(safe[0])]
    evading = courses[int(clearance.argmax())]
    kept = outlook(pursuit, now, turns, settings)[1]
    gained = outlook(evading, now, turns, settings)[1] - kept
    if kept < SAFE_DISTANCE and gained > _GAIN:
        return evading
    return pursuit if best is None else best


def _on(pursuit: Pursuit, pending: Pending, particle: int) -> Pursuit:
    """Return the state on the trajectory of a particle of a plan that was asked for."""
    trajectory = np.array(pending.plan.trajectories[particle])
    return replace(
        pursuit,
        plan=pending.plan,
        problem=pending.problem,
        particle=particle,
        trajectory=trajectory,
        limits=limits_of(pending.problem, trajectory),
        corners=(
            *(corner for corner in pursuit.corners if corner < pending.problem.clock.phase),
            *((pending.problem.clock.phase,) if pending.standing else ()),
        ),
    )


def pursue(
    pursuit: Pursuit,
    decoded: DecodedObservation,
    planner: Replanner,
    event: GripperEvent | None,
    replanning: Replanning,
) -> tuple[Pursuit, NDArray[np.float32]]:
    """Return the state after one environment step, and its action (7,).

    Args:
        pursuit: the state.
        decoded: what the observation says.
        planner: that makes plans anew.
        event: of the gripper, if there is one.
        replanning: when plans are made anew.
    """
    step, settings = decoded.elapsed_steps, planner.plan_settings
    looks = Looks.first(decoded.scene.obstacles)
    if pursuit.looks is not None:
        seconds = (step - pursuit.seen[-1][0]) * CONTROL_PERIOD
        looks = pursuit.looks.then(decoded.scene.obstacles, seconds)
    now = looks.obstacles
    seen = (*(entry for entry in pursuit.seen if step - entry[0] <= TURN_WINDOW[1]), (step, now))
    pursuit = replace(pursuit, seen=seen, looks=looks)
    turns = turns_of(seen)
    if pursuit.pending is not None and step >= pursuit.pending.due:
        pursuit = _take_effect(pursuit, now, turns, settings)
        # What was said of the trajectory of before must not make the arm retreat from a safe one.
        factor, clearance = outlook(pursuit, now, turns, settings)
        pursuit = replace(pursuit, factor=factor, clearance=clearance)
    opened = _opened(pursuit, step, event)
    lagging = float(np.abs(decoded.robot.configuration - decoded.robot.reference).max()) > LAG
    idle = opened or pursuit.closing > 0 or pursuit.phase >= 1.0
    if pursuit.pending is None and not idle:
        due = step - pursuit.asked >= replanning.every
        threatened = pursuit.clearance < SAFE_DISTANCE
        if due or lagging or threatened or is_surprising(pursuit, looks, step, settings):
            pursuit = _ask(pursuit, planner, decoded, looks, turns, replanning)
    if opened or step < pursuit.begins or pursuit.closing > 0:
        pursuit = replace(pursuit, closing=max(pursuit.closing - 1, 0))
    else:
        pursuit = _advanced(pursuit, now, turns, settings, event, step, lagging)
    target = at_phases(pursuit.trajectory[None], pursuit.phase)[0, 0]
    gripper = _gripper(pursuit, step, event)
    return pursuit, reference_action(target, decoded.robot.reference, gripper)


def _advanced(
    pursuit: Pursuit,
    now: Sequence[Obstacle],
    turns: Turns,
    settings: PlanSettings,
    event: GripperEvent | None,
    step: int,
    lagging: bool,
) -> Pursuit:
    """Return the state one control step farther along the trajectory."""
    pending = pursuit.pending
    waiting = pending is not None and pending.standing
    held = pending is not None and (waiting or pending.backwards)
    factors = (0.0, -1.0) if held else FACTORS[1:] if lagging else FACTORS
    factor, clearance = outlook(pursuit, now, turns, settings, factors)
    if waiting and factor < 0.0:
        # What begins at rest here cannot be entered in motion.
        pursuit = replace(pursuit, pending=None)
    phases, rate = course(pursuit, factor, 1)
    phase, closing = float(phases[0]), 0
    if event is not None and event.command > 0.0 and pursuit.phase < event.phase <= phase:
        phase, closing = event.phase, CLOSING_STEPS
    if phase in (0.0, 1.0):
        rate = 0.0
    arrived = None
    if phase >= 1.0:
        arrived = step if pursuit.arrived is None else pursuit.arrived
    return replace(
        pursuit,
        phase=phase,
        rate=rate,
        factor=factor,
        clearance=clearance,
        closing=closing,
        arrived=arrived,
    )


def _opened(pursuit: Pursuit, step: int, event: GripperEvent | None) -> bool:
    """Return whether the hand has been told to open at the end."""
    return (
        event is not None
        and event.command < 0.0
        and pursuit.arrived is not None
        and step - pursuit.arrived > SETTLING_STEPS
    )


def _gripper(pursuit: Pursuit, step: int, event: GripperEvent | None) -> float:
    """Return the gripper's action of a step."""
    if event is None:
        return 0.0
    if event.command < 0.0 and event.phase >= 1.0:
        return event.command if _opened(pursuit, step + 1, event) else -event.command
    return event.command if pursuit.phase >= event.phase else -event.command
