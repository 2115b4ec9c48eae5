"""Rewards of trajectories in the training of `mp_rl`: by the planners' check, or the physics.

Both say of trajectories in a scene how good each is, and whether it has succeeded. `CheckedRewards`
are those of the exact distances, at 40 samples of a trajectory and with 3 mm for what lies between
them: its least clearance, or what it misses a constraint by if that is more, in units of 0.15 m,
and 1 more if it is clear of everything, within joint limits and the limit of duration, and meets
the constraints. `ExecutedRewards` know no distance: each trajectory is executed as a plan is, in an
episode of the environment, and is worth 1 for success, and the share of its way that was done
before the episode ended.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.rollout import rollout
from smp_gym.scene import Obstacle, Scene
from smp_planner.agents.posed_scenes import environment, posed, primitive_of
from smp_planner.planning.bumps import SoftenedCheck
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings
from smp_planner.policy.tracking import Track, gripper_event

__all__ = [
    "CheckedRewards",
    "ExecutedRewards",
    "PosedScene",
    "RewardName",
    "TrajectoryRewards",
    "make_rewards",
]

_FLOOR, _ENOUGH = -0.15, 0.01
"""m, least clearance told apart by the check, and that from which on more is worth no more."""

RewardName = Literal["check", "physics"]
"""Names of the rewards, see `make_rewards`."""


@dataclass(frozen=True, eq=False)
class PosedScene:
    """A scene, and the problem that its first observation poses.

    Attributes:
        scene: that can be played.
        problem: of a planner; its obstacles are those of the scene, in single precision.
    """

    scene: Scene
    problem: Problem


class TrajectoryRewards(Protocol):
    """Protocol of what says how good trajectories are in a scene."""

    @property
    def samples(self) -> int:
        """T of the trajectories that are looked at, at equal steps of phase."""
        ...

    def met(self, known: PosedScene, obstacles: tuple[Obstacle, ...]) -> PosedScene:
        """Return a scene as it is met with other obstacles.

        Args:
            known: the scene as it was drawn.
            obstacles: in place of its own.
        """
        ...

    def of(self, met: PosedScene, trajectories: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the rewards (N,) of trajectories, and whether each has succeeded (N,).

        Args:
            met: where they begin.
            trajectories: (N, T, 6) rad.
        """
        ...


@dataclass(frozen=True)
class CheckedRewards:
    """Rewards of the planners' check.

    Attributes:
        settings: limit of the duration, and what constraints may be missed by.
    """

    settings: PlanSettings

    samples = 40

    def met(self, known: PosedScene, obstacles: tuple[Obstacle, ...]) -> PosedScene:
        """Return a scene with other obstacles, whatever they touch."""
        old = set(known.problem.movable)
        stages = tuple(
            replace(stage, obstacles=(*obstacles, *(o for o in stage.obstacles if o not in old)))
            for stage in known.problem.stages
        )
        problem = replace(known.problem, stages=stages, movable=obstacles)
        return PosedScene(_with_obstacles(known.scene, obstacles), problem)

    def of(self, met: PosedScene, trajectories: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return rewards (N,) from -1 to 1.07, and whether trajectories are clear (N,)."""
        check = SoftenedCheck(met.problem, trajectories.shape[1], _FLOOR, self.settings)
        clearance = check.clearance(trajectories)
        clear = clearance > 0.0
        return np.minimum(clearance, _ENOUGH) / -_FLOOR + clear, clear


class ExecutedRewards:
    """Rewards of the physics alone.

    Episodes are played in the environment of this process (`posed_scenes.environment`), each from
    its own reset, so nothing of one is left in the next.

    Args:
        task: of the scenes; its demonstrations say when the hand opens or closes.
    """

    samples = 200

    def __init__(self, task: str) -> None:
        self._event = gripper_event(Demonstrations.load(task).gripper)

    def met(self, known: PosedScene, obstacles: tuple[Obstacle, ...]) -> PosedScene:
        """Return a scene with other obstacles, or as it was drawn if it cannot begin with them."""
        scene = _with_obstacles(known.scene, obstacles)
        try:
            (problem,) = posed([scene])
        except ValueError:
            # The environment refuses what begins with a collision.
            return known
        return PosedScene(scene, problem)

    def of(self, met: PosedScene, trajectories: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return rewards (N,) from 0 to 2, and whether trajectories succeed (N,).

        A success has done all of its way, though the episode may end shortly before its last step.
        """
        env = environment(met.scene.task)
        # Shortest durations are those of plans; whether limits hold is left to the physics.
        _, durations = met.problem.body.execution(trajectories, np.inf)
        done, succeeded = np.empty(len(trajectories)), np.empty(len(trajectories), np.bool_)
        for index, trajectory in enumerate(trajectories):
            track = Track(trajectory, float(durations[index]), self._event)
            episode = rollout(env, track, scene=met.scene)
            succeeded[index] = episode.success
            done[index] = 1.0 if episode.success else track.phase(episode.steps)
        return done + succeeded, succeeded


def make_rewards(name: RewardName, task: str) -> TrajectoryRewards:
    """Return rewards by their name.

    Args:
        name: "check" for `CheckedRewards`, "physics" for `ExecutedRewards`.
        task: of the scenes.
    """
    if name == "physics":
        return ExecutedRewards(task)
    return CheckedRewards(primitive_of(task).plan_settings)


def _with_obstacles(scene: Scene, obstacles: tuple[Obstacle, ...]) -> Scene:
    """Return a scene with other obstacles, which no seed draws."""
    changes = {"obstacles": obstacles, "seed": None, "difficulty": "custom"}
    return scene.model_copy(update=changes)
