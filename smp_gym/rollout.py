"""The one episode loop: any policy, from the reset to the end, seen by any recorders."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray
from smp_gym.control import execution_time, reference_action
from smp_gym.observation import CONTROL_PERIOD, state_field
from smp_gym.scene import Scene

__all__ = [
    "FieldRecorder",
    "FrameRecorder",
    "Moment",
    "Policy",
    "Recorder",
    "Rollout",
    "Waypoints",
    "play",
    "rollout",
]

_WAITING_STEPS = 60
_CLOSING_STEPS = 20
_HOLDING_STEPS = 10
"""Steps after a release, while the hand closes, and at the end with the object held."""

Env = gymnasium.Env[Any, Any]


class Policy(Protocol):
    """Anything that acts: the prediction interface of stable-baselines3's agents."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Return an action, and the state to hand back with the next observation."""
        ...


@dataclass(frozen=True)
class Moment:
    """One moment of an episode: what `reset`, or a step, has returned.

    Attributes:
        env: the environment, for recorders that render it or say that they look into it.
        step: environment steps since the episode began; 0 after the reset.
        observation: of this moment.
        info: of this moment.
        action: that led here; None after the reset.
        reward: of the step that led here; 0 after the reset.
        terminated: whether the episode has ended.
        truncated: whether it has been cut off.
    """

    env: Env
    step: int
    observation: Any
    info: dict[str, Any]
    action: Any = None
    reward: float = 0.0
    terminated: bool = False
    truncated: bool = False


Recorder = Callable[[Moment], None]
"""Sees each moment of an episode once, in order, the reset's included.

The ``append`` of a list is one: it keeps observations, actions, rewards and contacts (``info``)."""


class FieldRecorder:
    """Records one field of the robot's or the object's state, by its name in `STATE_LAYOUT`.

    Args:
        name: for example ``"end_effector_position"`` or ``"object_position"``.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._values: list[FloatArray] = []

    def __call__(self, moment: Moment) -> None:
        """Take the field from the observation."""
        self._values.append(state_field(moment.observation, self.name))

    @property
    def values(self) -> FloatArray:
        """(steps + 1, size of the field), in the units of `STATE_LAYOUT`."""
        return np.array(self._values)


class FrameRecorder:
    """Records what the environment renders, (H, W, 3) uint8; nothing if it does not render."""

    def __init__(self) -> None:
        self.frames: list[NDArray[np.uint8]] = []

    def __call__(self, moment: Moment) -> None:
        """Render a frame."""
        if moment.env.render_mode is not None:
            self.frames.append(moment.env.render())  # type: ignore[arg-type]


@dataclass(frozen=True)
class Rollout:
    """The outcome of an episode: first and last observation, return, length.

    Attributes:
        first: first observation.
        last: last observation.
        info: of the last step.
        steps: environment steps that were played.
        reward: undiscounted sum of the rewards.
        state: what the policy handed back last.
    """

    first: Any
    last: Any
    info: dict[str, Any]
    steps: int
    reward: float
    state: Any

    @property
    def success(self) -> bool:
        """True if the environment judged the episode a success."""
        return bool(self.info["is_success"])


def rollout(
    env: Env,
    policy: Policy,
    *,
    seed: int | None = None,
    scene: Scene | None = None,
    steps: int | None = None,
    deterministic: bool = True,
    recorders: Sequence[Recorder] = (),
    ends: Callable[[Moment], bool] | None = None,
) -> Rollout:
    """Play one episode.

    Args:
        env: what it is played in.
        policy: acts, on the observations alone.
        seed: of the reset.
        scene: to be played; by default the environment draws one.
        steps: most steps that are played; by default the episode is played to its end.
        deterministic: handed to the policy.
        recorders: called in turn with each moment of the episode.
        ends: whether to stop at a moment; by default when the episode is terminated or truncated.
    """
    observation, info = env.reset(seed=seed, options=None if scene is None else {"scene": scene})
    moment = Moment(env, 0, observation, info)
    total, state = 0.0, None
    while True:
        for record in recorders:
            record(moment)
        over = moment.terminated or moment.truncated if ends is None else ends(moment)
        if over or moment.step == steps:
            break
        begins = np.array([moment.step == 0])
        action, state = policy.predict(moment.observation, state, begins, deterministic)
        outcome, reward, terminated, truncated, info = env.step(action)
        total += float(reward)
        moment = Moment(
            env, moment.step + 1, outcome, info, action, float(reward), terminated, truncated
        )
    return Rollout(observation, moment.observation, moment.info, moment.step, total, state)


@dataclass(frozen=True)
class Waypoints:
    """A policy that leads the joint reference through given configurations, one a step.

    It acts in joint velocities, and holds the last configuration once all are passed.

    Attributes:
        configurations: (M, 6) rad, where the reference shall be after each step.
        gripper: (M,) the gripper's action in each, -1 opening to 1 closing.
    """

    configurations: FloatArray
    gripper: FloatArray

    def predict(
        self,
        observation: Any,
        state: int | None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], int]:
        """Return the action (7,) of a step, and the number of steps so far as the state."""
        step = state or 0
        at = min(step, len(self.configurations) - 1)
        reference = state_field(observation, "reference")
        return reference_action(self.configurations[at], reference, self.gripper[at]), step + 1

    @classmethod
    def along(
        cls, trajectory: FloatArray, duration: float | None = None, grasp: int | None = None
    ) -> Waypoints:
        """Return the waypoints of a trajectory at constant speed of phase; see `play`."""
        phase = np.linspace(0.0, 1.0, len(trajectory))
        duration = execution_time(trajectory) if duration is None else duration
        steps = int(np.ceil(duration / CONTROL_PERIOD))
        at = np.linspace(0.0, 1.0, steps + 1)
        passed = np.stack([np.interp(at, phase, column) for column in trajectory.T], axis=1)
        if grasp is None:
            waiting = np.repeat(passed[-1:], _WAITING_STEPS - 1, axis=0)
            targets = np.concatenate([passed[1:], waiting])
            return cls(targets, np.where(np.arange(1, len(targets) + 1) > steps, -1.0, 0.0))
        close = round(grasp / (len(trajectory) - 1) * steps)
        closing = np.repeat(passed[close][None], _CLOSING_STEPS, axis=0)
        holding = np.repeat(passed[-1:], _HOLDING_STEPS, axis=0)
        targets = np.concatenate([passed[1 : close + 1], closing, passed[close + 1 :], holding])
        return cls(targets, np.where(np.arange(1, len(targets) + 1) <= close, -1.0, 1.0))


def play(
    env: Env,
    scene: Scene,
    trajectory: FloatArray,
    duration: float | None = None,
    grasp: int | None = None,
) -> dict[str, Any]:
    """Execute a trajectory, as demonstrations and witnesses are judged; return the last ``info``.

    Args:
        env: of the scene's task.
        scene: what to play it in.
        trajectory: (T, 6) rad at equal steps of phase.
        duration: s; default as fast as 0.9 times the velocity limits allow.
        grasp: sample at which the hand, open until then, closes on the object and holds it from
            then on; by default the object is in the hand, which lets go at the end.
    """
    waypoints = Waypoints.along(trajectory, duration, grasp)
    return rollout(env, waypoints, scene=scene, steps=len(waypoints.gripper)).info
