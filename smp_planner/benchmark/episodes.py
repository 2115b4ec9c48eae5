"""One episode of the benchmark: its key, its rollout, and its row of results."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.frozen import load_episodes
from smp_gym.observation import SENSINGS, DecodedObservation, decode
from smp_gym.registration import environment_id
from smp_gym.rollout import FieldRecorder, Policy, Recorder, rollout
from smp_gym.scene import FAMILIES, Scene
from smp_gym.suites import Cell
from smp_planner.benchmark.methods import resolve_method
from smp_planner.benchmark.row_table import compressed
from smp_planner.planning.plan import Plan
from smp_planner.policy.planner_policy import Execution, PlannerPolicy
from smp_planner.policy.replanned_execution import LATENCY

__all__ = [
    "TIMES",
    "WARM_UP_SEED",
    "EpisodeKey",
    "EpisodePlayer",
    "EpisodeRow",
    "PlayMethods",
    "PlayedEpisode",
    "contact_in_words",
    "environment_id",
    "play_episode",
]

TIMES = ("replanning_time", "planning_time", "episode_time", "stage_times")
"""Fields of a row that differ from run to run."""

WARM_UP_SEED = 0
"""Tuning seed whose episode a worker plans once, unrecorded, so that no row times a compilation."""


@dataclass(frozen=True, order=True)
class EpisodeKey:
    """Identifier of an episode of a method.

    Attributes:
        task: name of the task, one of `smp_gym.scene.TASKS`.
        method: name of the method.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        seed: with which the environment is reset; equal seeds are equal scenes for every method.
        half: of the frozen list that the episode is from, one of
            `smp_gym.datasets.frozen.HALVES`; its seed then names it there. Empty for an episode
            that is drawn from its seed.
        family: of the scene, one of `smp_gym.scene.FAMILIES`.
        sensing: of the environment, see `smp_gym.suites.Cell`.
        noise: of the environment, m; see there.
    """

    task: str
    method: str
    difficulty: str
    seed: int
    half: str = ""
    family: str = FAMILIES[0]
    sensing: str = SENSINGS[0]
    noise: float = 0.0

    @classmethod
    def of(cls, cell: Cell, method: str, seed: int, half: str = "") -> EpisodeKey:
        """Return the identifier of an episode of a cell."""
        return cls(
            cell.task,
            method,
            cell.difficulty,
            seed,
            half,
            cell.family,
            cell.sensing,
            cell.noise,
        )

    @property
    def cell(self) -> Cell:
        """The cell of the episode."""
        return Cell(self.task, self.difficulty, self.family, self.sensing, self.noise)


@dataclass(frozen=True)
class EpisodeRow:
    """Record of one episode.

    All but the times at the end depends on the key alone. ``None`` stands where a method has no
    particles.

    Attributes:
        task: see `EpisodeKey`, as the next three.
        method: name of the method.
        difficulty: name of the difficulty.
        seed: of the episode.
        success: whether the physics engine judged the episode a success.
        collision: whether a forbidden contact ended it.
        cause: of the failure; empty after a success.
        contact: the two parts of the forbidden contact, if there was one.
        goal_error: distance from the object's centre, or the pen, to where it should end, when the
            episode ended, m.
        path_length: of the end effector, m.
        clearance: least distance of arm or held object to an obstacle, judged by the physics, m;
            the environment reports distances up to 0.05 only.
        steps: environment steps.
        half: of the frozen list, see `EpisodeKey`.
        family: of the scene, see `EpisodeKey`, as the next two.
        sensing: of the environment.
        noise: of the environment, m.
        share_collision_free: share of the particles that are collision-free on the exact map.
        share_executable: share within the joint limits and the planner's limit of duration.
        share_good: share that are both.
        chosen_collision_free: whether the executed particle is collision-free.
        chosen_executable: whether it is executable.
        chosen_clearance: its least distance to anything in the exact map, m.
        chosen_goal_error: distance of its end to the nearest goal region, m.
        chosen_duration: its shortest execution within the joint velocity limits, s.
        message: of the planner when no particle was good, or how often none was when plans were
            made anew.
        replan_every: control steps after which a plan is made anew at the latest; 0 where the
            method plans once. The columns of particles are of the first plan.
        latency: control steps from asking for a plan to its taking effect; 0 where it plans once.
        replans: how many plans were made anew.
        failed_replans: how many of these held no good particle.
        replanning_time: mean time of these, s.
        planning_time: time of the whole plan, s; 0 where a method plans nothing.
        episode_time: time of the episode from reset to its end, planning included, s.
        stage_times: time of each stage of the plan by name, s; not in the CSV, nor is the next.
        scene: that was played, as JSON.
    """

    task: str
    method: str
    difficulty: str
    seed: int
    success: bool
    collision: bool
    cause: str
    contact: str
    goal_error: float
    path_length: float
    clearance: float
    steps: int
    half: str = ""
    family: str = FAMILIES[0]
    sensing: str = SENSINGS[0]
    noise: float = 0.0
    share_collision_free: float | None = None
    share_executable: float | None = None
    share_good: float | None = None
    chosen_collision_free: bool | None = None
    chosen_executable: bool | None = None
    chosen_clearance: float | None = None
    chosen_goal_error: float | None = None
    chosen_duration: float | None = None
    message: str = ""
    replan_every: int = 0
    latency: int = 0
    replans: int = 0
    failed_replans: int = 0
    replanning_time: float = 0.0
    planning_time: float = 0.0
    episode_time: float = 0.0
    stage_times: Mapping[str, float] = field(default_factory=dict)
    scene: str = compressed()

    @property
    def outcome(self) -> str:
        """Success, or the failure with its cause, for titles."""
        return "success" if self.success else f"failed: {self.cause}"

    @property
    def key(self) -> EpisodeKey:
        """Identifier of the episode."""
        return EpisodeKey(
            self.task,
            self.method,
            self.difficulty,
            self.seed,
            self.half,
            self.family,
            self.sensing,
            self.noise,
        )


class EpisodePlayer(Protocol):
    """Protocol of what plays an episode by its key; must be picklable."""

    def __call__(self, key: EpisodeKey) -> EpisodeRow:
        """Return the row of one episode."""
        ...


@dataclass(frozen=True)
class PlayedEpisode:
    """A played episode: its scene, plan and row.

    Attributes:
        row: what the store keeps.
        scene: decoded from the first observation.
        plan: the particles; None of a method that plans nothing.
        object_path: (steps + 1, 3) m, positions of the object's centre.
    """

    row: EpisodeRow
    scene: Scene
    plan: Plan | None
    object_path: NDArray[np.float64]


def contact_in_words(contact: str) -> str:
    """Return a pair of parts without the name of the arm's model and with spaces."""
    return re.sub(r"\bj2s6s200_|\blink_(?=finger)", "", contact).replace("_", " ")


def _goal_error(decoded: DecodedObservation) -> float:
    """Return the distance of object or pen to the nearest place where it should end, m."""
    goals = decoded.scene.goals
    places = np.array([goal.position for goal in goals])
    # What is set down rests on its goal, with its centre half its height above.
    set_down = [goal.kind in ("bin", "pad") for goal in goals]
    places[set_down, 2] += decoded.object.size[2]
    return float(np.linalg.norm(places - decoded.object.position, axis=1).min())


def _of_plan(plan: Plan) -> dict[str, Any]:
    """Return the columns that speak of the particles."""
    chosen = plan.chosen
    return {
        "share_collision_free": float(plan.collision_free.mean()),
        "share_executable": float(plan.executable.mean()),
        "share_good": float(plan.good.mean()),
        "chosen_collision_free": bool(plan.collision_free[chosen]),
        "chosen_executable": bool(plan.executable[chosen]),
        "chosen_clearance": float(plan.clearance[chosen]),
        "chosen_goal_error": float(plan.goal_error[chosen]),
        "chosen_duration": float(plan.duration[chosen]),
        "message": plan.message,
        "planning_time": plan.planning_time,
        "stage_times": {name: float(seconds) for name, seconds in plan.timings.items()},
    }


def _of_planning(policy: PlannerPolicy, execution: Execution) -> dict[str, Any]:
    """Return the columns that speak of the plan, and of those made anew."""
    columns = _of_plan(execution.plan)
    pursuit, replanning = execution.pursuit, policy.replanning
    if pursuit is None or replanning is None:
        return columns
    messages = (execution.plan.message, pursuit.message)
    return {
        **columns,
        "message": "; ".join(message for message in messages if message),
        "replan_every": replanning.every,
        "latency": replanning.latency,
        "replans": pursuit.replans,
        "failed_replans": pursuit.failed,
        "replanning_time": pursuit.seconds / max(pursuit.replans, 1),
    }


def _scene_of(key: EpisodeKey, folder: Path | None) -> Scene | None:
    """Return the stored scene of an episode of a frozen list."""
    if not key.half:
        return None
    for episode in load_episodes(key.cell, folder):
        if (episode.half, episode.seed) == (key.half, key.seed):
            return episode.scene
    raise ValueError(f"no frozen list holds the episode {key}")


def play_episode(
    key: EpisodeKey,
    env: gym.Env[Any, Any],
    policy: Policy,
    recorders: Sequence[Recorder] = (),
    lists: Path | None = None,
) -> PlayedEpisode:
    """Play one episode to its end, of a planner with the best particle of each plan.

    Args:
        key: names the episode.
        env: an environment of the key's cell.
        policy: acts.
        recorders: see `smp_gym.rollout.rollout`.
        lists: folder of the frozen lists; by default that of the package.
    """
    hand = FieldRecorder("end_effector_position")
    carried = FieldRecorder("object_position")
    began = time.perf_counter()
    scene = _scene_of(key, lists)
    played = rollout(
        env,
        policy,
        seed=key.seed if scene is None else None,
        scene=scene,
        recorders=(hand, carried, *recorders),
    )
    elapsed = time.perf_counter() - began
    plan, of_planning = None, {}
    if isinstance(policy, PlannerPolicy):
        plan, of_planning = played.state[0].plan, _of_planning(policy, played.state[0])
    row = EpisodeRow(
        task=key.task,
        method=key.method,
        difficulty=key.difficulty,
        seed=key.seed,
        success=played.success,
        collision=bool(played.info["collided"]),
        cause=played.info["failure"],
        contact=" – ".join(played.info["collision"] or ()),
        goal_error=_goal_error(decode(played.last, key.task)),
        path_length=float(np.linalg.norm(np.diff(hand.values, axis=0), axis=1).sum()),
        clearance=float(played.info["clearance"]),
        steps=played.steps,
        half=key.half,
        family=key.family,
        sensing=key.sensing,
        noise=key.noise,
        episode_time=elapsed,
        scene=env.get_wrapper_attr("scene").to_json(),
        **of_planning,
    )
    return PlayedEpisode(row, decode(played.first, key.task).scene, plan, carried.values)


@lru_cache(maxsize=16)
def _ready(
    cell: Cell, spec: str, replan_every: int | None, latency: int
) -> tuple[gym.Env[Any, Any], Policy]:
    """Return environment and policy of this process, after one unrecorded action."""
    env = gym.make(environment_id(cell.task), **cell.make_arguments())
    policy = resolve_method(spec).policy(
        cell.task, cell.sensing, replan_every=replan_every, latency=latency
    )
    observation, _ = env.reset(seed=WARM_UP_SEED)
    policy.predict(observation, deterministic=True)
    return env, policy


@dataclass(frozen=True)
class PlayMethods:
    """Plays episodes of methods; environment and policy are made once per process.

    Attributes:
        specs: of the methods by name; see `smp_planner.benchmark.methods.resolve_method`.
        lists: folder of the frozen lists; None for that of the package.
        replan_every: see `PlannerPolicy`, as the next; None plans once.
        latency: of plans, where they are made anew.
    """

    specs: Mapping[str, str] = field(default_factory=dict)
    lists: Path | None = None
    replan_every: int | None = None
    latency: int = LATENCY

    def policy(self, key: EpisodeKey) -> Policy:
        """Return a new policy of the method of an episode."""
        return resolve_method(self._spec(key)).policy(
            key.task, key.cell.sensing, replan_every=self.replan_every, latency=self.latency
        )

    def _spec(self, key: EpisodeKey) -> str:
        return self.specs.get(key.method, key.method)

    def __call__(self, key: EpisodeKey) -> EpisodeRow:
        """Play one episode and return its row."""
        env, policy = _ready(key.cell, self._spec(key), self.replan_every, self.latency)
        return play_episode(key, env, policy, lists=self.lists).row
