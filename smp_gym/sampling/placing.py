"""Scenes of Placement and DoubleSidedPlacement."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot import kinematics
from smp_gym.sampling import kernels
from smp_gym.sampling.body import ObjectTask, make_task
from smp_gym.sampling.conversion import to_row
from smp_gym.sampling.obstacles import START_CLEARANCE
from smp_gym.sampling.specification import SPECIFICATIONS, DifficultySpecification
from smp_gym.sampling.way import Draw, draw_way
from smp_gym.scene import Goal, Obstacle
from smp_gym.tasks.double_sided_placement import rules as double_sided_placement
from smp_gym.tasks.placement import rules as placement

__all__ = [
    "double_sided_tasks",
    "draw_bin",
    "draw_double_sided",
    "draw_pads",
    "draw_placement",
    "placement_task",
    "side_specifications",
    "stopper",
]

FloatArray = NDArray[np.float64]


_FREE_SHARES = {"none": 1.0, "easy": 0.015, "medium": 0.0, "hard": 0.0}
_CLOSED = ("hard",)
"""Of DoubleSidedPlacement: which share of the proposals for each pad may stay free, and at which
difficulties the other side is closed off: its only obstacle stands on the pad and leaves no room
there."""

_STOPPER_HALF_EXTENTS = (0.05, 0.06)
"""m, of what stands on a pad that is closed off: between it and the pad's edge no object fits with
its centre over the pad."""

_PROPOSALS = 168
"""Of DoubleSidedPlacement, on each way: two ways are two chances to get through, so each has to
be blocked more surely."""


@functools.lru_cache(maxsize=1)
def placement_task() -> ObjectTask:
    """Return what sampling needs to know of Placement."""
    demonstrations = Demonstrations.load("Placement")
    goals = np.array([scene.goals[0].position for scene in demonstrations.scenes])
    return make_task(
        demonstrations.configurations,
        goals.mean(axis=0),
        placement.START_CONFIGURATION,
        placement.HELD_OBJECT_POSE,
        demonstrations.metadata["finger_angles"],
    )


@functools.lru_cache(maxsize=1)
def double_sided_tasks() -> tuple[ObjectTask, ObjectTask]:
    """Return what sampling needs to know of the ways to the left and to the right."""
    demonstrations = Demonstrations.load("DoubleSidedPlacement")
    left = kinematics.end_effector_pose(demonstrations.configurations[:, -1])[:, 1, 3] > 0.0
    tasks = [
        replace(
            make_task(
                demonstrations.configurations[of_side],
                np.array([scene.goals[side].position for scene in demonstrations.scenes]).mean(
                    axis=0
                ),
                double_sided_placement.START_CONFIGURATION,
                double_sided_placement.HELD_OBJECT_POSE,
                demonstrations.metadata["finger_angles"],
            ),
            proposals=_PROPOSALS,
        )
        for side, of_side in enumerate((left, ~left))
    ]
    return tasks[0], tasks[1]


def draw_bin(rng: np.random.Generator) -> Goal:
    """Draw a bin."""
    x, y, z = rng.uniform(placement.BIN_LOWER, placement.BIN_UPPER)
    return Goal(position=(float(x), float(y), float(z)))


def draw_pads(rng: np.random.Generator) -> tuple[Goal, ...]:
    """Draw a pad on either side."""
    pads = []
    for x, y, _ in double_sided_placement.NOMINAL_PADS:
        radius = double_sided_placement.PAD_SHIFT * np.sqrt(rng.uniform())
        angle = rng.uniform(-np.pi, np.pi)
        z = rng.uniform(double_sided_placement.PAD_LOWEST, double_sided_placement.PAD_TOP)
        position = (x + float(radius * np.cos(angle)), y + float(radius * np.sin(angle)), float(z))
        pads.append(Goal(kind="pad", position=position))
    return tuple(pads)


def draw_placement(difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw a goal, obstacles and a witness; None if they do not fit together."""
    goal = draw_bin(rng)
    return draw_way(placement_task(), SPECIFICATIONS[difficulty], goal, (goal,), rng)


def side_specifications(
    difficulty: str,
) -> tuple[DifficultySpecification, DifficultySpecification | None]:
    """Return what a difficulty means for the one and the other side; None if that is closed off."""
    share = _FREE_SHARES[difficulty]
    one = replace(SPECIFICATIONS[difficulty], free_share=share)
    return one, None if difficulty in _CLOSED else one


def draw_double_sided(difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw two pads, obstacles on both sides and a witness; None if they do not fit together.

    One side, drawn at random, is sure to be open, and the witness goes there. The other one either
    has a witness, too, or is closed off.
    """
    goals = draw_pads(rng)
    tasks = double_sided_tasks()
    side = int(rng.integers(2))
    one, other = side_specifications(difficulty)
    drawn = draw_way(tasks[side], one, goals[side], goals, rng)
    if drawn is None:
        return None
    if other is not None:
        return draw_way(tasks[1 - side], other, goals[1 - side], goals, rng, drawn)
    rows = stopper(goals[1 - side], rng)
    path, radius = tasks[side].paths(drawn.witness), tasks[side].spheres.radius
    clearance = kernels.path_clearances(path, radius, rows, 1.0).min()
    if clearance < max(one.clearance, START_CLEARANCE):
        return None
    return replace(drawn, rows=np.concatenate([drawn.rows, rows]))


def stopper(goal: Goal, rng: np.random.Generator) -> FloatArray:
    """Return the (1, 9) row of a box that leaves no room on a pad."""
    half = rng.uniform(*_STOPPER_HALF_EXTENTS, size=3)
    x, y, z = goal.position
    size = (float(half[0]), float(half[1]), float(half[2]))
    box = Obstacle(shape="box", position=(x, y, z + size[2]), size=size)
    return np.array([to_row(box)])
