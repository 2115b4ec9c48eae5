"""Transfers: demonstrated movements of a held object to a goal, carried to another goal."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot import kinematics
from smp_gym.sampling.blind_detours import FUNCTIONS, load_blind_detours
from smp_gym.sampling.detours import resample, smoothstep
from smp_gym.sampling.moving_body import MovingBody
from smp_gym.sampling.swept_path import SweptPath
from smp_gym.scene import Configuration, Goal, ManipulatedObject

__all__ = ["Query", "Transfer", "carry", "make_transfer", "release_configuration"]


@dataclass(frozen=True, eq=False)
class Transfer(MovingBody):
    """A demonstrated movement that sets an object down, as the samplers take it.

    Attributes:
        start: (6,) rad.
        release_rotation: (3, 3) orientation of the end effector at the demonstrations' mean end.
        release_height: m, of the object's centre over the goal there.
        nominal_goal: (3,) m, mean goal of the demonstrations.
        held: (4, 4) pose of the held object in the end-effector frame.
        goal_clearance: m, of obstacles from the bodies of goals, sideways.
        samples: of each member of a family.
        proposals: how many detours of ordinary width are drawn.
        wide: how many wide ones.
        blind_side: task and side whose blind detours are kept blocked; None for none.
    """

    start: FloatArray
    release_rotation: FloatArray
    release_height: float
    nominal_goal: FloatArray
    held: FloatArray
    goal_clearance: float
    samples: int = 20
    proposals: int = 104
    wide: int = 180
    blind_side: tuple[str, int] | None = None

    @property
    def blind(self) -> FloatArray:
        """(K, 3, 6) rad, detours that are the same in every scene."""
        if self.blind_side is None:
            return np.empty((0, FUNCTIONS, 6))
        return load_blind_detours(*self.blind_side)

    @cached_property
    def at_start(self) -> SweptPath:
        """The body at the start."""
        return self.swept_path(self.start[None])

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of detours of ordinary width and of wide ones."""
        return self.proposals, self.wide


def make_transfer(
    demonstrations: Demonstrations,
    which: NDArray[np.bool_] | slice,
    goal: int,
    start: Configuration,
    held: FloatArray,
    goal_clearance: float,
    **more: Any,
) -> Transfer:
    """Return the transfer that demonstrations show.

    Args:
        demonstrations: of the task.
        which: of them show it.
        goal: index of the goal in each of their scenes.
        start: rad.
        held: (4, 4) pose of the held object in the end-effector frame.
        goal_clearance: m, of obstacles from the bodies of goals, sideways.
        more: fields that differ from their defaults, such as `proposals`.
    """
    shown = demonstrations.configurations[which]
    goals = np.array([scene.goals[goal].position for scene in demonstrations.scenes]).mean(axis=0)
    pose = kinematics.end_effector_pose(shown.mean(axis=0)[-1])
    return Transfer.holding(
        shown,
        demonstrations.metadata["finger_angles"],
        kinematics.box_spheres(ManipulatedObject().size, held),
        start=np.asarray(start, np.float64),
        release_rotation=pose[:3, :3],
        release_height=float((pose @ held)[2, 3] - goals[2]),
        nominal_goal=goals,
        held=np.asarray(held),
        goal_clearance=goal_clearance,
        **more,
    )


def release_configuration(transfer: Transfer, goal: Goal) -> FloatArray:
    """Return the (6,) rad of the release over a goal: the demonstrated one, turned about the base.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    position = np.asarray(goal.position)
    turn = np.arctan2(position[1], position[0]) - np.arctan2(
        transfer.nominal_goal[1], transfer.nominal_goal[0]
    )
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ transfer.release_rotation
    center = position + np.array([0.0, 0.0, transfer.release_height])
    held = transfer.held[:3, 3]
    seed = transfer.demonstrations[:, -1].mean(axis=0)
    seed[0] -= turn
    return kinematics.inverse_kinematics(center - rotation @ held, rotation, seed=seed)


@dataclass(frozen=True, eq=False)
class Query:
    """The query of a scene: one transfer, to one of its goals.

    Attributes:
        transfer: the movement that leads there.
        goals: all of the scene; the bodies of all must be left free.
        number: index of the goal in which the transfer ends.
    """

    transfer: Transfer
    goals: tuple[Goal, ...]
    number: int = 0

    @property
    def goal(self) -> Goal:
        """The goal in which the transfer ends."""
        return self.goals[self.number]

    @cached_property
    def release(self) -> FloatArray:
        """(6,) rad, the configuration in which it ends; UnreachableError if it is out of reach."""
        return release_configuration(self.transfer, self.goal)


def carry(transfer: Transfer, goal: FloatArray, samples: int) -> FloatArray:
    """Return the demonstrations, (N, samples, 6), blended to start and goal configuration (6,)."""
    carried = resample(transfer.demonstrations, samples)
    blend = smoothstep(np.linspace(0.0, 1.0, samples))[:, None]
    to_start = (transfer.start - carried[:, 0])[:, None]
    to_goal = (goal - carried[:, -1])[:, None]
    result: FloatArray = carried + (1.0 - blend) * to_start + blend * to_goal
    return result
