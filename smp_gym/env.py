"""The environment: a task's scenes, played in a workcell, as a `gymnasium.Env`."""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from smp_gym.arrays import AnyFloatArray, BoolArray, FloatArray, checked_array, checked_count, shown
from smp_gym.control import joint_action
from smp_gym.episode_state import EpisodeState, fingerprint
from smp_gym.observation import (
    CONTROL_PERIOD,
    CONTROLS,
    LONGEST_LIMIT,
    MAX_EPISODE_STEPS,
    Control,
    Encoder,
    Observation,
    Sensing,
    check_observable,
    observation_space,
)
from smp_gym.physics.jaco import ACTION_SIZE
from smp_gym.physics.lines import Line
from smp_gym.physics.workcell import Workcell
from smp_gym.physics.world import Camera
from smp_gym.sampling import CROWDED, sample_scene
from smp_gym.scene import (
    DIFFICULTIES,
    EVALUATION_SEEDS_START,
    FAMILIES,
    Obstacle,
    Scene,
)
from smp_gym.sensing.depth_camera import DepthSensor
from smp_gym.sensing.sensors import ExactSensor, NoisySensor, Sensor, check_sensing
from smp_gym.tasks.registry import make_task, task_families

__all__ = [
    "FAILURE_REWARD",
    "SHAPING_DISCOUNT",
    "SUBGOAL_REWARD",
    "SUCCESS_REWARD",
    "ManipulationEnv",
]

SUCCESS_REWARD = 10.0
FAILURE_REWARD = -10.0
"""Rewards of the step that ends the episode: with success, or by a collision or the loss of the
object. All other steps have none. So whatever the length of an episode and whatever the discount,
success is worth more than running out of time, and that more than failing."""

SUBGOAL_REWARD = 0.2
"""Reward, in `compute_reward` only, of a goal that demands less than an episode's: the object at a
place, but in the hand. Such goals come from hindsight, which lets the episode go on where one is
reached: to stay there for good is worth 10, as much as a success, at a discount of 0.98, and 4 at
0.95."""

SHAPING_DISCOUNT = 0.99
"""Discount in the dense reward's difference of potentials. Shaping leaves the best policy what it
is if the agent discounts by the same."""

DEFAULT_CAMERA = Camera(target=(0.32, 0.0, 0.23), distance=1.5, yaw=62.0, pitch=-28.0)

_ACTION_TOLERANCE = 1e-6

_MOST_PIXELS = 4096
"""Along either side of a picture."""


class ManipulationEnv(gymnasium.Env[Observation, NDArray[np.float32]], EzPickle):
    """A manipulation task among obstacles, drawn anew in each episode.

    **Actions** are `Box(-1, 1, (7,))`: six joint velocities as fractions of the joints' limits
    (`smp_gym.robot.kinematics.JOINT_VELOCITY`), and the gripper's rate, +1 closing. With
    ``control`` "end_effector" the first six are instead linear and angular velocity of the end
    effector in the base frame, as fractions of 0.15 m/s and 0.5 rad/s (see `smp_gym.control`). An
    action with an entry that is not finite or further than 1e-6 outside the box is an error.

    **Observations** are goal-conditioned and complete; see `smp_gym.observation`.

    **Rewards**: 10 at success, -10 at a collision or when the task is lost for good (placing: the
    object rests, let go, where it should not), which end the episode, and 0 in every other step. So
    success is worth more than running out of time, and that more than failing, for episodes of all
    lengths and discounts. "dense" adds the difference of the task's potential, discounted by
    `SHAPING_DISCOUNT`, the potential being 0 once the episode has ended.

    **Time**: ``gymnasium.make(id, max_episode_steps=n)`` sets *the* limit of an episode, by default
    `smp_gym.observation.MAX_EPISODE_STEPS`: the observation's elapsed fraction and the failure
    "timeout" follow it.

    **Collisions**: any contact of the arm or of the held object that the task does not need, looked
    for after every physics step.

    **Seeds**: ``reset(seed=s)`` starts the episode whose scene is
    ``sample_scene(task, difficulty, s, family)``, a pure function. A reset without seed draws the
    next one from ``np_random``, always below `EVALUATION_SEEDS_START`: seeds from there on are kept
    for evaluation and come up only when asked for.

    **Info**, in every step: ``is_success``; ``collided``; ``collision``, the names of the two
    parts, or None; ``clearance``, the least distance so far of arm or held object to an obstacle,
    m, at most 0.05; ``failure``, "" or why the episode has failed: "collision", the task's own
    cause (of placing: "dropped", onto the table), "misplaced" (lost otherwise), or "timeout";
    ``seed`` (None for a scene that was handed in without one); ``difficulty``; ``family``;
    DoubleSidedPlacement: ``side``, "left" or "right" where the object was placed, otherwise "";
    with the dense reward also ``previous_achieved_goal``.

    **Pictures** ("rgb_array") show the lines of the attribute ``overlay``, too, none at first:
    `smp_gym.physics.lines.Line`s, such as a planned path.

    Args:
        task: one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        reward: "sparse" or "dense".
        render_mode: None, "rgb_array", or "human" for a window.
        width: of pictures, pixels, at most 4096.
        height: of pictures, pixels, likewise.
        camera: entries of `smp_gym.physics.world.Camera` that shall differ from the default.
        control: "joint_velocity" or "end_effector", what actions mean. It stands in the
            observation: planner policies act in joint velocities, and refuse the other mode.
        family: of the scenes, one of `smp_gym.tasks.registry.task_families`. Difficulty "none",
            without obstacles, there is in the first only.
        sensing: what observations say of obstacles, one of `smp_gym.observation.SENSINGS`: "exact"
            rows; rows with "noise" (`smp_gym.sensing.sensors.NoisySensor`); or a "depth" camera's
            ``points`` in place of ``obstacles`` (`smp_gym.sensing.depth_camera`). The physics, and
            so collisions and success, are not touched by it.
        noise: standard deviation of perceived positions along each axis, m; with ``sensing``
            "noise" only, and by default `smp_gym.sensing.sensors.DEFAULT_NOISE`.

    Raises:
        ValueError: an argument is not one of those allowed.
        RuntimeError: "human" without a display that answers.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["human", "rgb_array"],
        "render_fps": round(1.0 / CONTROL_PERIOD),
    }

    def __init__(
        self,
        task: str = "Placement",
        difficulty: str = "medium",
        reward: Literal["sparse", "dense"] = "sparse",
        render_mode: str | None = None,
        width: int = 480,
        height: int = 360,
        camera: Mapping[str, Any] | None = None,
        control: Control = "joint_velocity",
        family: str = FAMILIES[0],
        sensing: Sensing = "exact",
        noise: float | None = None,
    ) -> None:
        EzPickle.__init__(
            self,
            task,
            difficulty,
            reward,
            render_mode,
            width,
            height,
            camera,
            control,
            family,
            sensing,
            noise,
        )
        self.task = make_task(task)
        _check_choice("difficulty", difficulty, DIFFICULTIES)
        _check_choice("reward", reward, ("sparse", "dense"))
        _check_choice("control", control, CONTROLS)
        _check_choice(f"family of {task}", family, task_families(task))
        if family != FAMILIES[0]:
            _check_choice(f"difficulty of family {family}", difficulty, CROWDED)
        _check_choice("render_mode", render_mode, (None, *self.metadata["render_modes"]))
        for name, value in (("width", width), ("height", height)):
            checked_count(name, value, most=_MOST_PIXELS)
        self.difficulty = difficulty
        self.family = family
        self.reward = reward
        self.control = control
        self.sensing = sensing
        self.noise = check_sensing(sensing, noise)
        self._sensor = _make_sensor(sensing, self.noise)
        self.render_mode = render_mode
        self._width, self._height = int(width), int(height)
        self._camera = _make_camera(camera)
        self.observation_space = observation_space(self.task.name, sensing)  # type: ignore[assignment]
        self.action_space = spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)
        seen = render_mode is not None
        self._limit = MAX_EPISODE_STEPS
        self._cell = Workcell(self.task, gui=render_mode == "human", seen=seen)
        self._scene: Scene | None = None
        self._actions: list[NDArray[np.float64]] = []
        self._failure = ""
        self._succeeded = self._over = False
        self._looked_at: tuple[Obstacle, ...] | None = None
        self._next_frame = 0.0
        self.overlay: tuple[Line, ...] = ()

    # Gymnasium's interface

    @property
    def limit(self) -> int:
        """Steps after which an episode is truncated, by the `TimeLimit` around it."""
        return self._limit

    @limit.setter
    def limit(self, steps: int) -> None:
        if isinstance(steps, bool) or not isinstance(steps, int | np.integer):
            raise ValueError(f"limit must be a whole number of steps, got {steps!r}")
        if not 1 <= steps <= LONGEST_LIMIT:
            raise ValueError(f"limit must be from 1 to {LONGEST_LIMIT} steps, got {steps}")
        self._limit = int(steps)

    @property
    def scene(self) -> Scene:
        """The scene of the present episode."""
        if self._scene is None:
            raise gymnasium.error.ResetNeeded("call reset() before anything else")
        return self._scene

    @property
    def collision_point(self) -> FloatArray | None:
        """Where the forbidden contact of the present episode was, (3,) m; None without one."""
        _ = self.scene
        return self._cell.collision_point

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: of the scene; without one it is drawn from ``np_random``.
            options: ``{"scene": …}`` plays that scene instead: a `Scene`, its dictionary or its
                JSON text.

        Raises:
            ValueError: an option is unknown, or the scene does not parse, is of another task, or
                begins with a collision. The environment stays usable.
        """
        self._check_open()
        super().reset(seed=seed)
        observation = self._begin(self._choose_scene(seed, options))
        if self.render_mode == "human":
            self._cell.world.look(self._camera)
            self._cell.world.show_lines(())
            self.render()
        return observation, self._info()

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance by `CONTROL_PERIOD`.

        Args:
            action: (7,), each entry from -1 to 1.

        Raises:
            ValueError: the action has another shape, is not finite, or out of range; nothing
                has moved then.
        """
        self._check_open()
        checked = _checked_action(action)
        _ = self.scene
        if self.control == "end_effector":
            checked = joint_action(checked, self._cell.arm.reference)
        previous = self._achieved
        observation = self._advance(checked)
        info = self._info()
        if self.reward == "dense":
            info["previous_achieved_goal"] = previous
        failed = self._over and not self._succeeded
        reward = float(self._rewards(self._achieved, self._desired, self._succeeded, failed, info))
        if self.render_mode == "human":
            self.render()
        return observation, reward, self._over, False, info

    def compute_reward(
        self, achieved_goal: AnyFloatArray, desired_goal: AnyFloatArray, info: Any
    ) -> AnyFloatArray | float:
        """Return the reward of reaching goals, as `step` would give it.

        Args:
            achieved_goal: (..., G) achieved goals.
            desired_goal: (..., G) desired goals.
            info: unused by the sparse reward. The dense reward, being a difference, needs each
                step's ``info`` (one, or a sequence of them) for the goal achieved before: tell
                stable-baselines3's `HerReplayBuffer` to keep it with ``copy_info_dict=True``.

        Returns:
            A float for single goals, otherwise (...) rewards.

        Raises:
            ValueError: dense reward without the ``info`` of the steps.
        """
        achieved = np.asarray(achieved_goal, np.float64)
        desired = np.asarray(desired_goal, np.float64)
        collided = self.task.collided(achieved)
        success = self.task.success(achieved, desired)
        failed = collided | self.task.lost(achieved, desired)
        rewards = self._rewards(achieved, desired, success, failed, info)
        return float(rewards) if rewards.ndim == 0 else rewards

    def _rewards(
        self,
        achieved: AnyFloatArray,
        desired: AnyFloatArray,
        success: BoolArray | bool,
        failed: BoolArray | bool,
        info: Any,
    ) -> AnyFloatArray:
        """Return the rewards (...) of goals (..., G) of which it is known what came of them."""
        rewards = np.where(failed, FAILURE_REWARD, np.where(success, SUCCESS_REWARD, 0.0))
        if np.any(success):
            partial = np.logical_and(success, ~self.task.demands_all(desired))
            rewards = np.where(partial, SUBGOAL_REWARD, rewards)
        if self.reward == "dense":
            achieved, desired = np.asarray(achieved, np.float64), np.asarray(desired, np.float64)
            before = self.task.potential(_previous_goals(info, achieved.shape), desired)
            after = np.where(
                np.logical_or(failed, success), 0.0, self.task.potential(achieved, desired)
            )
            rewards = rewards + SHAPING_DISCOUNT * after - before
        return rewards

    def save_state(self) -> EpisodeState:
        """Return the present state, from which the episode can be continued later.

        States are plain data: any number may be kept, for as long as one likes, and saving changes
        nothing. Wrappers keep counts of their own (`TimeLimit`), which a state does not hold.
        """
        self._check_open()
        return EpisodeState(
            scene=self.scene,
            actions=np.array(self._actions).reshape(-1, ACTION_SIZE),
            generator=copy.deepcopy(self.np_random.bit_generator.state),
            generator_seed=self.np_random_seed,
            fingerprint=fingerprint(self._cell.robot, self._cell.manipulated),
        )

    def restore_state(self, state: EpisodeState) -> tuple[Observation, dict[str, Any]]:
        """Return to a state, exactly: what follows is the same bit for bit.

        The episode is played again from its start, or, where the state lies ahead in the present
        episode, from now; see `EpisodeState` for the reason. That takes about as long as playing
        it took. Also a state of another environment of the same task can be restored.

        Returns:
            What `reset` would return in this state.

        Raises:
            TypeError: not an `EpisodeState`.
            ValueError: the state is of another task.
            RuntimeError: the physics does not come to the same state again, as may be on another
                machine or with other package versions; a reset is needed then.
        """
        self._check_open()
        if not isinstance(state, EpisodeState):
            raise TypeError(f"state must be an EpisodeState, got {type(state).__name__}")
        self._check_scene(state.scene)
        played = len(self._actions)
        past = np.array(self._actions).reshape(-1, ACTION_SIZE)
        ahead = self._scene == state.scene and np.array_equal(past, state.actions[:played])
        observation = self._observe() if ahead else self._begin(state.scene)
        for action in state.actions[len(self._actions) :]:
            observation = self._advance(action)
        if fingerprint(self._cell.robot, self._cell.manipulated) != state.fingerprint:
            self._scene = None
            raise RuntimeError(
                f"the state after {len(state.actions)} steps cannot be restored: the same actions "
                "lead elsewhere here; states are exact for one machine and its package versions"
            )
        self.np_random.bit_generator.state = copy.deepcopy(dict(state.generator))
        self._np_random_seed = state.generator_seed
        return observation, self._info()

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (height, width, 3) in mode "rgb_array"; in "human", keep real time."""
        self._check_open()
        _ = self.scene
        if self.render_mode == "rgb_array":
            lines = (*self._cell.lines, *self.overlay)
            return self._cell.world.picture(self._camera, self._width, self._height, lines)
        if self.render_mode == "human":
            self._cell.world.show_lines(self._cell.lines)
            now = time.monotonic()
            time.sleep(max(0.0, self._next_frame - now))
            self._next_frame = max(self._next_frame, now) + CONTROL_PERIOD
        return None

    def close(self) -> None:
        """End the physics world; closing again does nothing."""
        self._cell.world.close()
        self._scene = None

    # Internals

    def _check_open(self) -> None:
        if self._cell.world.closed:
            raise RuntimeError("the environment is closed; make a new one")

    def _begin(self, scene: Scene) -> Observation:
        """Stand at the start of a scene."""
        self._sensor.begin(scene)
        self._scene = None
        self._cell.load(scene)
        self._scene = scene
        self._encoder = Encoder(scene, self.control, self._limit)
        self._actions = []
        self._looked_at = None
        self._perceive()
        self._failure = ""
        self._succeeded = self._over = False
        observation = self._observe()
        self._achieved, self._desired = observation["achieved_goal"], observation["desired_goal"]
        return observation

    def _advance(self, action: NDArray[np.float64]) -> Observation:
        """Move for one step and judge what came of it."""
        self._cell.advance(action)
        self._actions.append(action)
        self._perceive()
        observation = self._observe()
        self._achieved, self._desired = observation["achieved_goal"], observation["desired_goal"]
        collided = self._cell.collision is not None
        self._succeeded = bool(self.task.success(self._achieved, self._desired))
        lost = bool(self.task.lost(self._achieved, self._desired))
        self._over = self._succeeded or collided or lost
        if self._succeeded:
            self._failure = ""
        elif collided:
            self._failure = "collision"
        elif not self._failure:
            self._failure = self.task.failure(self._cell.status) or ("misplaced" if lost else "")
        if not (self._over or self._failure) and len(self._actions) >= self._limit:
            self._failure = "timeout"
        return observation

    def _choose_scene(self, seed: int | None, options: Mapping[str, Any] | None) -> Scene:
        options = dict(options or {})
        given = options.pop("scene", None)
        if options:
            raise ValueError(f"options may hold 'scene' only, got {sorted(map(str, options))}")
        if given is not None:
            scene = _parsed(given)
            self._check_scene(scene)
            return scene
        if seed is None:
            seed = int(self.np_random.integers(EVALUATION_SEEDS_START))
        return sample_scene(self.task.name, self.difficulty, seed, self.family)

    def _check_scene(self, scene: Scene) -> None:
        self.task.check_scene(scene)
        check_observable(scene)

    def _perceive(self) -> None:
        """Look at the obstacles, if the next look is due and would show something else."""
        obstacles, step = self._cell.obstacles, len(self._actions)
        changed = self._sensor.varies or obstacles is not self._looked_at
        if changed and step % self._sensor.period == 0:
            self._encoder.show(self._sensor.perceive(obstacles, self._cell.world, step))
            self._looked_at = obstacles

    def _observe(self) -> Observation:
        cell = self._cell
        achieved = self.task.achieved_goal(cell.status)
        return self._encoder.encode(cell.robot, cell.manipulated, achieved, len(self._actions))

    def _info(self) -> dict[str, Any]:
        return {
            "is_success": self._succeeded,
            "collided": self._cell.collision is not None,
            "collision": self._cell.collision,
            "clearance": self._cell.clearance,
            "failure": self._failure,
            "seed": self.scene.seed,
            "difficulty": self.scene.difficulty,
            "family": self.scene.family,
            **self.task.details(self._achieved, self._desired),
        }


def _check_choice(name: str, value: Any, allowed: Sequence[Any]) -> None:
    if value not in allowed:
        raise ValueError(
            f"{name} must be one of {', '.join(map(str, allowed))}; got {shown(value)}"
        )


def _make_sensor(sensing: Sensing, noise: float) -> Sensor:
    if sensing == "depth":
        return DepthSensor()
    return NoisySensor(noise) if sensing == "noise" else ExactSensor()


def _make_camera(changes: Mapping[str, Any] | None) -> Camera:
    try:
        return replace(DEFAULT_CAMERA, **({} if changes is None else changes))
    except TypeError:
        names = [field.name for field in fields(Camera)]
        raise ValueError(
            f"camera may hold the entries {', '.join(names)}; got {shown(changes)}"
        ) from None


def _parsed(given: Any) -> Scene:
    if isinstance(given, Scene):
        return given
    if isinstance(given, str | bytes):
        return Scene.from_json(given)
    if isinstance(given, Mapping):
        return Scene.model_validate(given)
    raise ValueError(
        f"options['scene'] must be a Scene, a dict or JSON text, got {type(given).__name__}"
    )


def _checked_action(action: Any) -> NDArray[np.float64]:
    checked = checked_array("action", action, (ACTION_SIZE,))
    if np.abs(checked).max() > 1.0 + _ACTION_TOLERANCE:
        raise ValueError(f"action must lie between -1 and 1, got {checked.tolist()}")
    return np.minimum(np.maximum(checked, -1.0), 1.0)


def _previous_goals(info: Any, shape: tuple[int, ...]) -> AnyFloatArray:
    infos = [info] if isinstance(info, Mapping) else list(info)
    try:
        goals = np.array([entry["previous_achieved_goal"] for entry in infos], np.float64)
        return goals.reshape(shape)
    except (KeyError, ValueError):
        raise ValueError(
            "the dense reward is a difference of potentials and needs info with "
            "'previous_achieved_goal' for each of the goals; with stable-baselines3's "
            "HerReplayBuffer set copy_info_dict=True, or use the sparse reward"
        ) from None
