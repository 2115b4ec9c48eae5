"""Planning anew while the arm moves: from the last particles, conditioned on its present state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch

from smp_gym.arrays import FloatArray, IntArray
from smp_gym.robot.kinematics import UnreachableError
from smp_gym.scene import Obstacle
from smp_planner.adaptation import Adaptation, Runs, SteinSettings
from smp_planner.adaptation.continuing import continue_stein, moved_memory
from smp_planner.movement_primitives import ProMP
from smp_planner.occupancy.point_cloud import CloudMap
from smp_planner.planning.assessment import make_plan
from smp_planner.planning.clock import Clock
from smp_planner.planning.conditioning import Part, condition
from smp_planner.planning.constraints import Constraint, Exactly, at_phases
from smp_planner.planning.maps import SceneMaps
from smp_planner.planning.pipeline import PlanState
from smp_planner.planning.plan import Plan
from smp_planner.planning.prior import Prior
from smp_planner.planning.problem import Problem, difference_of_robots
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.stopwatch import Stopwatch
from smp_planner.planning.target import SceneTarget
from smp_planner.planning.threads import Threads, default_threads
from smp_planner.planning.tool_constraints import Poses, ToolPath
from smp_planner.torch_threads import one_thread

__all__ = ["ITERATIONS", "LEAST_RATE", "direction", "replan", "resumed"]

ITERATIONS = 12
"""Iterations of inference when a plan is made anew."""

STEP_SIZE = 0.05
"""Step size of these, in standard deviations of the prior."""

MODE_BONUS = 10.0
"""By how much, in units of the log-prior, a trajectory of another homotopy class must be better
than one of the present class to be chosen in its place."""

SAME_BONUS = 3.0
"""By how much one of the present class must be better than the present trajectory itself."""

SECOND = 2.0
"""What a second of the rest's duration is worth in units of the log-prior."""

LEAST_RATE = 1e-3
"""1/s, rate of the phase below which the arm counts as standing."""


def direction(trajectory: FloatArray, phase: float) -> FloatArray:
    """Return the derivative (D,) with respect to phase of a trajectory (T, D)."""
    slopes = np.gradient(trajectory, 1.0 / (len(trajectory) - 1), axis=0)
    return np.asarray(at_phases(slopes[None], phase)[0, 0])


def _ahead(constraint: Constraint, phase: float) -> Constraint | None:
    """Return what is left of a constraint after a phase; None if nothing."""
    if isinstance(constraint, ToolPath):
        left = tuple(via for via in constraint.via_points if via.phase > phase)
        return replace(constraint, via_points=left) if left else None
    if isinstance(constraint, Poses):
        poses = tuple(via for via in constraint.via_poses if via.phase > phase)
        return replace(constraint, via_poses=poses) if poses else None
    return constraint if min(constraint.phases) > phase else None


def resumed(
    problem: Problem,
    trajectory: FloatArray,
    clock: Clock,
    obstacles: Sequence[Obstacle],
    turns: Mapping[Obstacle, tuple[float, ...]] | None = None,
    cloud: CloudMap | None = None,
    seed: int | None = None,
    doubt: float = 0.0,
) -> Problem:
    """Return what is left of a problem while one of its trajectories is executed.

    The rest begins where the trajectory is at the clock's phase, and, in motion, in its direction;
    constraints of earlier phases are done.

    Args:
        problem: that the trajectory solves.
        trajectory: (T, D) rad, at the steps of a plan.
        clock: when the rest begins, and how fast.
        obstacles: `Problem.movable` as they are observed now, in the same order.
        turns: see `Problem`.
        cloud: map of a point cloud as it is now, where there was one.
        seed: of the randomness; by default that of the problem.
        doubt: see `Problem`.

    Raises:
        ValueError: other obstacles than those of the problem.
    """
    now = tuple(obstacles)
    if [o.shape for o in now] != [o.shape for o in problem.movable]:
        raise ValueError(
            f"obstacles must be the {len(problem.movable)} of the problem in their order, got "
            f"{len(now)}: {', '.join(o.shape for o in now) or 'none'}"
        )
    moved = dict(zip(problem.movable, now, strict=True))
    stages = tuple(
        replace(
            stage,
            obstacles=tuple(moved.get(o, o) for o in stage.obstacles),
            cloud=stage.cloud if cloud is None else cloud,
        )
        for stage in problem.stages
    )
    phase = clock.phase
    here = at_phases(trajectory[None], phase)[0, 0]
    constraints: list[Constraint] = [Exactly("start", phase, here)]
    if clock.rate is None:
        constraints.append(
            Exactly("rest at the start", phase, np.zeros_like(here), derivative=True)
        )
    elif abs(clock.rate) > LEAST_RATE:
        slope = direction(trajectory, phase)
        constraints.append(Exactly("direction at the start", phase, slope, derivative=True))
    for constraint in problem.constraints:
        # Where the problem's own rest began binds no more, not even after a retreat.
        if isinstance(constraint, Exactly) and constraint.phase == problem.clock.phase:
            continue
        left = _ahead(constraint, phase)
        if left is not None:
            constraints.append(left)
    return replace(
        problem,
        constraints=tuple(constraints),
        stages=stages,
        seed=problem.seed if seed is None else seed,
        movable=now,
        clock=clock,
        turns=dict(turns or {}),
        done=np.array(trajectory[: clock.first(len(trajectory)) + 1]),
        doubt=doubt,
    )


def _checked(plan: Plan, problem: Problem, prior: Prior) -> PlanState:
    state = plan.state
    if not isinstance(state, PlanState) or state.prior != prior.digest:
        raise ValueError(
            "plan must be of this planner, which has learned from these demonstrations; got "
            + ("one that cannot be gone on from" if state is None else "one of another planner")
        )
    if problem.body.dimension != prior.single.dimension:
        raise ValueError(
            f"problem must be of a robot with {prior.single.dimension} joints, as the plan; got "
            f"{problem.body.dimension}"
        )
    if problem.done is None:
        raise ValueError(
            "problem must say what is done: make it with smp_planner.planning.replanning.resumed"
        )
    planned = state.problem
    difference = difference_of_robots(problem.robot, planned.robot)
    if difference:
        raise ValueError(f"problem must be of the robot of the plan, got another {difference}")
    if _task(problem) != _task(planned):
        raise ValueError(
            "problem must be of the task of the plan, with stages, constraints at the end and "
            f"number of goals and spheres {_task(planned)}; got {_task(problem)}"
        )
    return state


def _task(problem: Problem) -> tuple[Any, ...]:
    """Return what problems of one task have in common, however much of them is done."""
    stages = tuple((stage.first, stage.last) for stage in problem.stages)
    ends = tuple(sorted(c.name for c in problem.constraints if max(c.phases) == 1.0))
    return stages, ends, len(problem.goals), len(problem.robot.spheres.radius)


def _reconditioned(part: Part, component: ProMP, problem: Problem, settings: PlanSettings) -> Part:
    """Return particles as near as possible to what they were that obey present constraints."""
    constraints = problem.constraints if settings.modulation == "exact" else ()
    branches = condition(component, constraints, settings)
    primitive = max(branches, key=lambda branch: branch[1])[0]
    latent = primitive.whiten(part.primitive.unwhiten(part.latent))
    memory = None
    if part.memory is not None:
        scale = torch.linalg.vector_norm(primitive.factor, dim=0).square()
        memory = moved_memory(part.memory, (primitive.factor / scale).mT @ part.primitive.factor)
    return replace(part, primitive=primitive, latent=latent, memory=memory)


def replan(
    plan: Plan,
    problem: Problem,
    prior: Prior,
    adaptation: Adaptation,
    settings: PlanSettings,
    *,
    particle: int | None = None,
    iterations: int = ITERATIONS,
    maps: SceneMaps | None = None,
) -> Plan:
    """Return a plan for what is left of a problem, from the particles of the last one.

    Each particle is moved as little as the new start demands, then some iterations of inference
    adapt all of them to where obstacles are now. What is done stays as it was executed. The
    homotopy class of the present particle is kept, unless a trajectory of another is clearly
    better, or none in it is good.

    Args:
        plan: the last one.
        problem: from `resumed`.
        prior: that the plan was made with.
        adaptation: likewise; Stein Movement Primitives, or none.
        settings: likewise.
        particle: of the plan, that is executed; by default the best.
        iterations: of inference.
        maps: of standing obstacles, if there are some already.

    Returns:
        A plan of as many particles, in the same order; if none is good, its message says why.

    Raises:
        ValueError: the plan is of another planner or cannot be gone on from, the problem of another
            robot or task, or the adaptation is one that cannot go on.
    """
    state = _checked(plan, problem, prior)
    own = adaptation.settings
    if adaptation.adapt is not None and not isinstance(own, SteinSettings):
        raise ValueError(
            "planning anew goes on from particles: the method must be smp or promp, got settings "
            f"{type(own).__name__}"
        )
    watch = Stopwatch()
    present = plan.chosen if particle is None else particle
    with Threads(default_threads()) as pool, one_thread():
        with watch.stage("conditioning"):
            components = prior.components()
            try:
                parts = [
                    _reconditioned(
                        part,
                        prior.widened(components[part.component], part.width),
                        problem,
                        settings,
                    )
                    for part in state.parts
                ]
            except UnreachableError as error:
                # A goal that was reached before is out of reach on this course.
                none = np.zeros(len(plan.trajectories), np.bool_)
                return replace(
                    plan,
                    collision_free=none,
                    standing_free=none,
                    message=f"not planned anew: {error}",
                    timings=watch.timings,
                )
        costs: dict[str, FloatArray] = {}
        target = None
        if isinstance(own, SteinSettings):
            with watch.stage("map"):
                target = SceneTarget(problem, settings, threads=pool, maps=maps)
            with watch.stage("inference"):
                parts = _continued(parts, target, own, settings, iterations)
        weights = torch.cat([part.primitive.unwhiten(part.latent) for part in parts])
        costs["prior"] = np.concatenate([part.surprise for part in parts])
        with watch.stage("verification"):
            primitive = prior.single
            trajectories = primitive.trajectory(weights, settings.samples).numpy()
            assert problem.done is not None
            trajectories[:, : len(problem.done)] = problem.done
            made = make_plan(
                problem,
                trajectories,
                costs,
                settings,
                weights=weights.numpy().reshape(-1, primitive.basis.count, primitive.dimension),
                components=plan.components,
                bonus=partial(_bonus, present),
            )
    return made.changed(timings=watch.timings, state=PlanState(state.prior, problem, tuple(parts)))


def _continued(
    parts: Sequence[Part],
    target: SceneTarget,
    own: SteinSettings,
    settings: PlanSettings,
    iterations: int,
) -> list[Part]:
    """Return the particles of all parts after some more iterations."""
    found = continue_stein(
        [Runs.of([part.primitive], settings.planning_steps) for part in parts],
        [part.latent for part in parts],
        target,
        own,
        iterations,
        STEP_SIZE,
        [part.memory for part in parts],
        [part.iteration for part in parts],
    )
    return [
        replace(
            part,
            latent=latent,
            memory=memory,
            iteration=0 if memory is None else part.iteration + iterations,
        )
        for part, (latent, memory) in zip(parts, found, strict=True)
    ]


def _bonus(present: int, classes: IntArray, duration: FloatArray) -> FloatArray:
    """Return what is added to the merit (P,) of particles, see `MODE_BONUS` and the next two."""
    same = (classes == classes[present]).all(axis=1)
    bonus = MODE_BONUS * same.astype(np.float64) - SECOND * duration
    bonus[present] += SAME_BONUS
    return bonus
