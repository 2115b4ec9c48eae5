"""Execution with replanning: plans asked for while the arm moves, and its speed along the present.

A plan that is asked for takes effect a given number of control steps later, whatever time planning
took. Until then the arm goes on along the present trajectory, which the new one leaves at the phase
that would be reached by then at most. So both are one up to there, and whenever the new one takes
effect, neither position nor velocity jumps.

How fast the arm goes along its trajectory is decided at every step: as fast as nothing that moves
is expected to be met for a while; else slower; else it stops, or retreats along what it has done.
Where nothing of that is safe, it does what keeps farthest away.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray, IntArray
from smp_gym.control import execution_times, reference_action
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.observation import CONTROL_PERIOD, DecodedObservation
from smp_gym.robot.kinematics import UnreachableError
from smp_gym.scene import Obstacle
from smp_planner.collision.moving import clearance_in_time, is_moving
from smp_planner.planning.assessment import HOLD
from smp_planner.planning.clock import RAMP, Clock, segment_rates
from smp_planner.planning.constraints import at_phases
from smp_planner.planning.forecasting import Looks, forecast_of, surprising
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Problem
from smp_planner.planning.replanning import LEAST_RATE, resumed
from smp_planner.planning.settings import PlanSettings
from smp_planner.policy.observed_problem import seen_map
from smp_planner.policy.tracking import CLOSING_STEPS, SETTLING_STEPS, GripperEvent

__all__ = [
    "LATENCY",
    "Pursuit",
    "Replanner",
    "Replanning",
    "begin",
    "foreseen",
    "highest_rate",
    "pursue",
]

LATENCY = 2
"""Control steps from asking for a plan to its taking effect, unless another number is given."""

FACTORS = (1.0, 0.5, 0.0, -1.0)
"""Speeds along the trajectory that are tried in turn, as shares of the highest."""

LOOKAHEAD = 40
"""Control steps for which nothing that moves must be expected to be met: as far as forecasts reach.
"""

SAFE_DISTANCE = 0.005
"""m, beyond the margins of what moves, that count as safe."""

LAG = 0.15
"""rad, by which a joint may lag behind its reference before the arm slows down."""

_TURN_WINDOW = (2, 5)
"""Fewest and most control steps between two observations whose velocities say how these turn."""

_STANDING_RATE = 1e-6
_ROUNDING = 1e-9
_NEAR_CORNER = 1e-3
"""Of the phase, within which a corner counts as reached."""

MOST_HASTE = 1.25
"""Highest rate of the phase, in that of the demonstrations: what is left of a trajectory slows down
towards its end, and could be run through in no time."""

PATIENCE = 4
"""Plans without a good particle, one after the other, after which a whole plan is made."""

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

    def plan(self, problems: Sequence[Problem]) -> list[Plan]:
        """Return one plan for each problem."""
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


@dataclass(frozen=True, eq=False)
class _Pending:
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
        limits: (T - 1,) 1/s, highest rates of the phase, see `segment_rates`.
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
    pending: _Pending | None = None
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


def highest_rate(demonstrations: Demonstrations) -> float:
    """Return the highest rate, 1/s, of the phase where plans are made anew.

    It is `MOST_HASTE` times that at which demonstrations are executed.
    """
    return float(MOST_HASTE / np.median(execution_times(demonstrations.configurations)))


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
        limits=_limits(problem, trajectory),
        expected=problem,
        weight=np.ones(len(problem.movable), np.int64),
        observed=step,
        begins=step + replanning.latency,
        asked=step,
    )


def _limits(problem: Problem, trajectory: FloatArray) -> FloatArray:
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


def _course(pursuit: Pursuit, factor: float, steps: int) -> tuple[FloatArray, float]:
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


def _turns(
    seen: Sequence[tuple[int, tuple[Obstacle, ...]]],
) -> dict[Obstacle, tuple[float, ...]]:
    """Return at which rate the velocities of obstacles turn, from the last observations."""
    step, now = seen[-1]
    fewest, most = _TURN_WINDOW
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


def _surprising(pursuit: Pursuit, looks: Looks, step: int, settings: PlanSettings) -> bool:
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


def _outlook(
    pursuit: Pursuit,
    now: Sequence[Obstacle],
    turns: Mapping[Obstacle, tuple[float, ...]],
    settings: PlanSettings,
    factors: Sequence[float],
) -> tuple[float, float]:
    """Return the speed to choose, as a share of the highest, and its clearance, m.

    It is the first that is safe, or the one that keeps farthest away.
    """
    near = _near(pursuit, now)
    if not near:
        return factors[0], np.inf
    courses = np.stack([_course(pursuit, factor, LOOKAHEAD)[0] for factor in factors])
    courses = np.concatenate([np.full((len(factors), 1), pursuit.phase), courses], axis=1)
    paths = np.stack([at_phases(pursuit.trajectory[None], course)[0] for course in courses])
    steps = np.arange(LOOKAHEAD + 1)
    # What comes after the arm is done is nothing to it.
    arrival = np.where((courses >= 1.0).any(axis=1), (courses >= 1.0).argmax(axis=1), LOOKAHEAD)
    times = np.minimum(steps * CONTROL_PERIOD, arrival[:, None] * CONTROL_PERIOD + HOLD)
    clearance = clearance_in_time(
        paths, times, pursuit.problem.robot, forecast_of(near, turns, settings)
    )
    safe = np.flatnonzero(clearance >= SAFE_DISTANCE)
    chosen = int(safe[0]) if len(safe) else int(clearance.argmax())
    return factors[chosen], float(clearance[chosen])


def _ask(
    pursuit: Pursuit,
    planner: Replanner,
    decoded: DecodedObservation,
    looks: Looks,
    turns: Mapping[Obstacle, tuple[float, ...]],
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
        phases, rate = _course(pursuit, 0.0 if backwards else 1.0, latency)
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
    )
    problem = replace(problem, foresight=delay + LOOKAHEAD * CONTROL_PERIOD)
    if pursuit.stuck < PATIENCE:
        plan = planner.replan(pursuit.plan, problem, pursuit.particle)
    else:
        try:
            (plan,) = planner.plan([replace(problem, seed=problem.seed + 1 + pursuit.replans)])
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
        pending=_Pending(step + latency, plan, problem, standing, backwards),
        replans=pursuit.replans + 1,
        failed=pursuit.failed + failed,
        stuck=(pursuit.stuck + 1) % (PATIENCE + 1) if failed else 0,
        seconds=pursuit.seconds + plan.planning_time,
    )


def _take_effect(
    pursuit: Pursuit,
    now: Sequence[Obstacle],
    turns: Mapping[Obstacle, tuple[float, ...]],
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
        if _outlook(best, now, turns, settings, FACTORS[:1])[1] >= SAFE_DISTANCE:
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
    clearance = _clearances(courses, now, turns, settings)
    safe = np.flatnonzero(clearance >= SAFE_DISTANCE)
    if best is not None and len(safe):
        return courses[int(safe[0])]
    evading = courses[int(clearance.argmax())]
    kept = _outlook(pursuit, now, turns, settings, FACTORS)[1]
    gained = _outlook(evading, now, turns, settings, FACTORS)[1] - kept
    if kept < SAFE_DISTANCE and gained > _GAIN:
        return evading
    return pursuit if best is None else best


def _clearances(
    pursuits: Sequence[Pursuit],
    now: Sequence[Obstacle],
    turns: Mapping[Obstacle, tuple[float, ...]],
    settings: PlanSettings,
) -> FloatArray:
    """Return the clearances (N,) m of states that go on at the highest speed."""
    return np.array([_outlook(p, now, turns, settings, FACTORS[:1])[1] for p in pursuits])


def _on(pursuit: Pursuit, pending: _Pending, particle: int) -> Pursuit:
    """Return the state on the trajectory of a particle of a plan that was asked for."""
    trajectory = np.array(pending.plan.trajectories[particle])
    return replace(
        pursuit,
        plan=pending.plan,
        problem=pending.problem,
        particle=particle,
        trajectory=trajectory,
        limits=_limits(pending.problem, trajectory),
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
    seen = (*(entry for entry in pursuit.seen if step - entry[0] <= _TURN_WINDOW[1]), (step, now))
    pursuit = replace(pursuit, seen=seen, looks=looks)
    turns = _turns(seen)
    if pursuit.pending is not None and step >= pursuit.pending.due:
        pursuit = _take_effect(pursuit, now, turns, settings)
        # What was said of the trajectory of before must not make the arm retreat from a safe one.
        factor, clearance = _outlook(pursuit, now, turns, settings, FACTORS)
        pursuit = replace(pursuit, factor=factor, clearance=clearance)
    opened = _opened(pursuit, step, event)
    lagging = float(np.abs(decoded.robot.configuration - decoded.robot.reference).max()) > LAG
    idle = opened or pursuit.closing > 0 or pursuit.phase >= 1.0
    if pursuit.pending is None and not idle:
        due = step - pursuit.asked >= replanning.every
        threatened = pursuit.clearance < SAFE_DISTANCE
        if due or lagging or threatened or _surprising(pursuit, looks, step, settings):
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
    turns: Mapping[Obstacle, tuple[float, ...]],
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
    factor, clearance = _outlook(pursuit, now, turns, settings, factors)
    if waiting and factor < 0.0:
        # What begins at rest here cannot be entered in motion.
        pursuit = replace(pursuit, pending=None)
    phases, rate = _course(pursuit, factor, 1)
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
