"""Observations: the one place where state and scene become arrays, and arrays become a scene again.

An observation is a `Dict` of four float32 vectors: ``observation`` (robot, object, time; see
`STATE_LAYOUT`), ``achieved_goal`` and ``desired_goal`` (laid out as the task says, see
`smp_gym.tasks.Task.goals`), and ``obstacles`` (`MAX_OBSTACLES` rows of `OBSTACLE_LAYOUT`,
flattened). With ``sensing`` "depth" there is ``points`` in place of ``obstacles``: `CLOUD_POINTS`
points of their surfaces (x, y, z), m, flattened. It is complete: `decode` gives back all that a
planner needs, raw or flattened by `gymnasium.spaces.flatten`, of either kind.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray, checked_array
from smp_gym.scene import MAX_OBSTACLES, SHAPES, ManipulatedObject, Obstacle, Scene
from smp_gym.tasks.goals import Field
from smp_gym.tasks.registry import make_task

__all__ = [
    "CLOUD_POINTS",
    "CONTROLS",
    "CONTROL_PERIOD",
    "GRIPPER_RATE",
    "LONGEST_LIMIT",
    "MAX_EPISODE_STEPS",
    "MAX_SUPPORTS",
    "OBSTACLE_LAYOUT",
    "SENSINGS",
    "STATE_LAYOUT",
    "Control",
    "DecodedObservation",
    "Encoder",
    "Field",
    "ObjectState",
    "RobotState",
    "Sensing",
    "check_observable",
    "decode",
    "encode_desired_goal",
    "observation_space",
    "space_of",
    "state_field",
    "state_places",
]

CONTROL_PERIOD = 0.05
"""Seconds per environment step (20 Hz)."""

MAX_EPISODE_STEPS = 400
"""Steps after which an episode is truncated, unless ``gymnasium.make`` is given another limit."""

LONGEST_LIMIT = 10_000
"""Largest limit of an episode's steps."""

Control = Literal["joint_velocity", "end_effector"]
"""Control mode: what the first six entries of an action mean."""

CONTROLS: tuple[Control, ...] = get_args(Control)
"""Control modes; an observation holds the index."""

Sensing = Literal["exact", "noise", "depth"]
"""What an observation says of obstacles: rows that are exact, rows with errors, or points."""

SENSINGS: tuple[Sensing, ...] = get_args(Sensing)
"""Kinds of sensing."""

CLOUD_POINTS = 512
"""Points in an observation of a depth camera; where fewer were seen, the last are zero. The origin
lies in the arm's base, so that no point of an obstacle is taken for an absent one."""

GRIPPER_RATE = 1.0
"""Change per second of the gripper reference (0 open, 1 closed) at gripper action 1."""


MAX_SUPPORTS = 2
"""Bodies at most on which the object may be set down."""

STATE_LAYOUT = (
    Field("configuration", 6, -7.0, 7.0),
    Field("reference", 6, -7.0, 7.0),
    Field("joint_velocity", 6, -10.0, 10.0),
    Field("finger_angles", 4, -0.5, 2.5),
    Field("gripper_reference", 1, 0.0, 1.0),
    Field("finger_velocity", 4, -50.0, 50.0),
    Field("end_effector_position", 3, -2.0, 2.0),
    Field("end_effector_quaternion", 4, -1.0, 1.0),
    Field("object_position", 3, -5.0, 5.0),
    Field("object_quaternion", 4, -1.0, 1.0),
    Field("object_linear_velocity", 3, -20.0, 20.0),
    Field("object_angular_velocity", 3, -200.0, 200.0),
    Field("object_size", 3, 0.0, 1.0),
    Field("supports", 3 * MAX_SUPPORTS, -2.0, 2.0),
    Field("elapsed", 1, 0.0, 1.0),
    Field("limit", 1, 0.0, LONGEST_LIMIT / MAX_EPISODE_STEPS),
    Field("control", 1, 0.0, float(len(CONTROLS) - 1)),
)
"""``observation``: rad, rad/s, m, m/s; ``elapsed`` is the fraction of the
episode's limit of steps, ``limit`` that limit in units of `MAX_EPISODE_STEPS`, ``control`` the
index of the control mode in `CONTROLS`.

In tasks without an object, the object's entries are those of the pen's tip, its size the pen's
radius. ``supports`` are the bodies on which the object may be set down, as `Task.supports` tells
them, zero where there are none: they stay where they are when hindsight replaces the desired goal,
which tells of the same places."""

OBSTACLE_LAYOUT = (
    Field("present", 1, 0.0, 1.0),
    Field("shape", len(SHAPES), 0.0, 1.0),
    Field("position", 3, -2.0, 2.0),
    Field("quaternion", 4, -1.0, 1.0),
    Field("size", 3, 0.0, 2.0),
    Field("velocity", 3, -5.0, 5.0),
)
"""One row of ``obstacles``; absent rows are all zero."""

POINT_LAYOUT = (Field("point", 3, -2.0, 2.0),)
"""One point of ``points``, m; absent ones are all zero, and follow those that are present."""

_LEAST_POINT_HEIGHT = -0.05
_LEAST_POINT_DISTANCE = 0.02
"""Metres: no point is below the table top by more than noise, or in the middle of the arm's base.
A normalised cloud is."""

_BETWEEN = (0.25, 0.5, 0.75)
"""Shares of the interval between two knots at which a motion is looked at, too."""

_ROUNDING = 1e-3
"""By how much norms, step counts and goals may be off, having been float32."""
Observation = dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class RobotState:
    """State of arm and gripper; angles in rad, rates in rad/s, positions in m.

    Attributes:
        configuration: (6,) measured joint angles.
        reference: (6,) integrated joint reference that the motors track.
        joint_velocity: (6,).
        finger_angles: (4,) proximal 1, proximal 2, tip 1, tip 2.
        gripper_reference: 0 (open) to 1 (closed).
        finger_velocity: (4,).
        end_effector_position: (3,).
        end_effector_quaternion: (4,) x, y, z, w.
    """

    configuration: FloatArray
    reference: FloatArray
    joint_velocity: FloatArray
    finger_angles: FloatArray
    gripper_reference: float
    finger_velocity: FloatArray
    end_effector_position: FloatArray
    end_effector_quaternion: FloatArray


@dataclass(frozen=True)
class ObjectState:
    """State of the object: position (3,) m, quaternion (4,), velocities (3,), half-extents (3,)."""

    position: FloatArray
    quaternion: FloatArray
    linear_velocity: FloatArray
    angular_velocity: FloatArray
    size: FloatArray


@dataclass(frozen=True)
class DecodedObservation:
    """The content of an observation: scene, states of robot and object, time, contact, control.

    Attributes:
        scene: obstacles, goals and object; its start is the *present* configuration.
        robot: state of arm and gripper.
        object: state of the manipulated object, or of the pen's tip.
        elapsed_steps: environment steps since the episode began; 0 in its first observation.
        limit: steps after which the episode is truncated.
        collided: whether a forbidden contact has happened.
        control: what actions mean in the environment that it is from.
        points: (M, 3) m, what a depth camera sees of the obstacles, of which the scene then has
            none; None where the observation has rows of obstacles.
    """

    scene: Scene
    robot: RobotState
    object: ObjectState
    elapsed_steps: int
    limit: int
    collided: bool
    control: Control
    points: FloatArray | None = None


def _bounds(layout: tuple[Field, ...], repeat: int = 1) -> spaces.Box:
    low = np.concatenate([np.full(f.size, f.low, np.float32) for f in layout])
    high = np.concatenate([np.full(f.size, f.high, np.float32) for f in layout])
    return spaces.Box(np.tile(low, repeat), np.tile(high, repeat), dtype=np.float32)


@cache
def _places(layout: tuple[Field, ...]) -> dict[str, slice]:
    ends = np.cumsum([f.size for f in layout]).tolist()
    return {f.name: slice(end - f.size, end) for f, end in zip(layout, ends, strict=True)}


def _split(vector: FloatArray, layout: tuple[Field, ...]) -> dict[str, FloatArray]:
    return {name: vector[place] for name, place in _places(layout).items()}


@cache
def _limits(layout: tuple[Field, ...]) -> tuple[FloatArray, FloatArray]:
    low = np.repeat([f.low for f in layout], [f.size for f in layout])
    high = np.repeat([f.high for f in layout], [f.size for f in layout])
    return low, high


class _Join:
    """Puts the values of a layout's fields into one vector, clipped to their bounds."""

    def __init__(self, layout: tuple[Field, ...]) -> None:
        self._places = tuple(_places(layout).items())
        self._low, self._high = _limits(layout)

    def __call__(self, values: Mapping[str, Any]) -> NDArray[np.float32]:
        joined = np.empty(len(self._low))
        for name, place in self._places:
            joined[place] = values[name]
        # Twice as quick as `np.clip` on vectors as short as these.
        np.maximum(joined, self._low, out=joined)
        np.minimum(joined, self._high, out=joined)
        return joined.astype(np.float32)


def state_places(name: str) -> slice:
    """Return the entries of ``observation`` that hold a field of `STATE_LAYOUT`.

    Raises:
        KeyError: no such field.
    """
    return _places(STATE_LAYOUT)[name]


def state_field(observation: Mapping[str, Any], name: str) -> FloatArray:
    """Return one field of `STATE_LAYOUT` of an observation (dict), unchecked, as float64.

    Raises:
        KeyError: no such field.
    """
    return np.asarray(observation["observation"][state_places(name)], np.float64)


def observation_space(task: str, sensing: Sensing = "exact") -> spaces.Dict:
    """Return the observation space of a task: four bounded float32 vectors.

    Args:
        task: one of `smp_gym.tasks.task_names`.
        sensing: one of `SENSINGS`; "exact" and "noise" look alike.

    Raises:
        ValueError: no such task or sensing.
    """
    if sensing not in SENSINGS:
        raise ValueError(f"sensing must be one of {', '.join(SENSINGS)}; got {sensing!r}")
    layout = make_task(task).goals.layout
    seen = {"obstacles": _bounds(OBSTACLE_LAYOUT, MAX_OBSTACLES)}
    if sensing == "depth":
        seen = {"points": _bounds(POINT_LAYOUT, CLOUD_POINTS)}
    return spaces.Dict(
        {
            "observation": _bounds(STATE_LAYOUT),
            "achieved_goal": _bounds(layout),
            "desired_goal": _bounds(layout),
            **seen,
        }
    )


@cache
def _space(task: str, sensing: Sensing) -> spaces.Dict:
    return observation_space(task, sensing)


def space_of(observation: Any, task: str) -> spaces.Dict:
    """Return the space of one observation: that with points, where it has them, or that with rows.

    Args:
        observation: raw (dict), or flattened (vector) and recognised by its length.
        task: the task it is from.
    """
    with_rows, with_points = _space(task, "exact"), _space(task, "depth")
    if isinstance(observation, Mapping):
        return with_points if "points" in observation else with_rows
    flat = np.shape(observation) == (spaces.flatdim(with_points),)
    return with_points if flat else with_rows


def encode_desired_goal(scene: Scene) -> NDArray[np.float32]:
    """Return ``desired_goal`` (G,) of a scene, laid out as the task says."""
    codec = make_task(scene.task).goals
    return _Join(codec.layout)(codec.encode(scene))


def _places_of_supports(scene: Scene) -> FloatArray:
    """Return ``supports`` (6,) of a scene, m."""
    places = np.zeros((MAX_SUPPORTS, 3))
    found = make_task(scene.task).supports(scene)
    places[: len(found)] = np.reshape(found, (-1, 3))
    return places.ravel()


# Looked up here once: to hash a layout takes longer than to fill its rows.
_OBSTACLE_PLACES = tuple(_places(OBSTACLE_LAYOUT).items())
_OBSTACLE_LOW, _OBSTACLE_HIGH = _limits(OBSTACLE_LAYOUT)


def _encode_obstacles(obstacles: tuple[Obstacle, ...]) -> NDArray[np.float32]:
    rows = np.zeros((MAX_OBSTACLES, len(_OBSTACLE_LOW)))
    shown = obstacles[:MAX_OBSTACLES]
    if shown:
        values: dict[str, Any] = {
            "present": [(1.0,)] * len(shown),
            "shape": [[float(o.shape == shape) for shape in SHAPES] for o in shown],
            "position": [o.position for o in shown],
            "quaternion": [o.quaternion for o in shown],
            "size": [o.size for o in shown],
            "velocity": [o.velocity for o in shown],
        }
        for name, place in _OBSTACLE_PLACES:
            rows[: len(shown), place] = values[name]
    return np.clip(rows, _OBSTACLE_LOW, _OBSTACLE_HIGH).astype(np.float32).ravel()


def check_observable(scene: Scene) -> None:
    """Raise ValueError if an observation cannot hold what is in a scene.

    Obstacles must come back from their rows as they were, but for rounding, wherever they go;
    goals and object must be within the bounds of their fields.
    """
    for number, obstacle in enumerate(scene.obstacles):
        times = np.zeros(1)
        if obstacle.motion is not None:
            knots = np.array(obstacle.motion.times)
            times = np.concatenate([knots, *(knots[:-1] + s * np.diff(knots) for s in _BETWEEN)])
        for time in times.tolist():
            there = obstacle.moved(time)
            values = {name: getattr(there, name) for name in ("position", "size", "velocity")}
            _check_held(values, OBSTACLE_LAYOUT, f"scene.obstacles[{number}]")
    goals = make_task(scene.task).goals
    _check_held(goals.encode(scene), goals.layout, "scene.goals, as the desired goal,")
    if scene.manipulated is not None:
        held: dict[str, Any] = {"object_size": scene.manipulated.size}
        if scene.manipulated.position is not None:
            held["object_position"] = scene.manipulated.position
        _check_held(held, STATE_LAYOUT, "scene.manipulated")


def _check_held(values: Mapping[str, Any], layout: tuple[Field, ...], where: str) -> None:
    """Raise ValueError if a value is clipped or vanishes in a vector of float32."""
    bounds = {field.name: (field.low, field.high) for field in layout}
    for name, value in values.items():
        low, high = bounds[name]
        given = np.asarray(value, np.float64)
        vanished = (given != 0.0) & (given.astype(np.float32) == 0.0)
        if given.min() < low or given.max() > high or (name.endswith("size") and vanished.any()):
            raise ValueError(
                f"{where} must have its {name} within [{low}, {high}], which is what an "
                f"observation holds, got {given.tolist()}"
            )


def _encode_points(points: FloatArray) -> NDArray[np.float32]:
    rows = np.zeros((CLOUD_POINTS, 3), np.float32)
    low, high = _limits(POINT_LAYOUT)
    rows[: len(points)] = np.clip(points, low, high)
    return rows.ravel()


class Encoder:
    """Turns the states of one episode into observations.

    Args:
        scene: the episode's scene; until `show` is called, its obstacles are perceived exactly.
        control: what actions mean.
        limit: steps after which the episode is truncated.
    """

    def __init__(
        self, scene: Scene, control: Control = "joint_velocity", limit: int = MAX_EPISODE_STEPS
    ) -> None:
        self._limit = limit
        self._control = CONTROLS.index(control)
        self._state = _Join(STATE_LAYOUT)
        self._goal = _Join(make_task(scene.task).goals.layout)
        self._desired_goal = encode_desired_goal(scene)
        self._supports = _places_of_supports(scene)
        self.show(scene.obstacles)

    def show(self, perceived: tuple[Obstacle, ...] | FloatArray) -> None:
        """Take what is perceived of the obstacles into the observations from now on.

        Args:
            perceived: obstacles, at most `MAX_OBSTACLES`, or points (M, 3) m, M at most
                `CLOUD_POINTS`.
        """
        if isinstance(perceived, tuple):
            self._seen = {"obstacles": _encode_obstacles(perceived)}
        else:
            self._seen = {"points": _encode_points(perceived)}

    def encode(
        self,
        robot: RobotState,
        manipulated: ObjectState,
        achieved_goal: Mapping[str, Any],
        elapsed_steps: int,
    ) -> Observation:
        """Return the observation of a state.

        Args:
            robot: state of arm and gripper.
            manipulated: state of the object.
            achieved_goal: values of the task's goal fields by name.
            elapsed_steps: environment steps since the episode began.

        Returns:
            The four vectors, float32, clipped to the bounds of `observation_space`.
        """
        state = {
            **vars(robot),
            **{f"object_{name}": value for name, value in vars(manipulated).items()},
            "supports": self._supports,
            "elapsed": elapsed_steps / self._limit,
            "limit": self._limit / MAX_EPISODE_STEPS,
            "control": self._control,
        }
        return {
            "observation": self._state(state),
            "achieved_goal": self._goal(achieved_goal),
            "desired_goal": self._desired_goal.copy(),
            **{key: vector.copy() for key, vector in self._seen.items()},
        }


def _decode_obstacles(flat: FloatArray) -> tuple[Obstacle, ...]:
    obstacles = []
    for row in flat.reshape(MAX_OBSTACLES, -1):
        fields = _split(row, OBSTACLE_LAYOUT)
        if fields["present"][0] < 0.5:
            continue
        quaternion = fields["quaternion"]
        obstacles.append(
            Obstacle(
                shape=SHAPES[int(np.argmax(fields["shape"]))],
                position=tuple(fields["position"].tolist()),
                quaternion=tuple((quaternion / np.linalg.norm(quaternion)).tolist()),
                size=tuple(fields["size"].tolist()),
                velocity=tuple(fields["velocity"].tolist()),
            )
        )
    return tuple(obstacles)


def _as_dict(observation: Any, task: str) -> dict[str, FloatArray]:
    """Check one raw or flattened observation and return its four vectors as float64."""
    space = space_of(observation, task)
    if isinstance(observation, Mapping):
        if set(observation) != set(space.spaces):
            raise ValueError(
                f"observation must have the keys {sorted(space.spaces)}, got "
                f"{sorted(map(str, observation))}: is it from a smp_gym environment?"
            )
        vectors = {
            key: checked_array(f"observation[{key!r}]", observation[key], nan=True)
            for key in space.spaces
        }
    else:
        flat = np.asarray(observation)
        if flat.shape != (spaces.flatdim(space),):
            raise ValueError(
                f"observation must be a dict or a flat vector of {spaces.flatdim(space)} entries "
                f"(of {spaces.flatdim(_space(task, 'depth'))} with points), "
                f"got {type(observation).__name__} of shape {flat.shape}"
            )
        vectors = dict(spaces.unflatten(space, flat))  # type: ignore[arg-type]
    for key, vector in vectors.items():
        box = space[key]
        if vector.shape != box.shape:
            raise ValueError(
                f"observation[{key!r}] must have shape {box.shape}, got {vector.shape}"
            )
        outside = ~((vector >= box.low) & (vector <= box.high))  # type: ignore[attr-defined]
        if outside.any():
            index = int(np.argmax(outside))
            raise ValueError(
                f"observation[{key!r}][{index}] is {vector[index]}, outside its bounds "
                f"[{box.low[index]}, {box.high[index]}]: "  # type: ignore[attr-defined]
                "a normalised observation cannot be decoded"
            )
    return {key: vector.astype(np.float64) for key, vector in vectors.items()}


def _abnormal(key: str, expectation: str) -> ValueError:
    return ValueError(
        f"observation[{key!r}] must {expectation}: a normalised observation cannot be decoded"
    )


def _check_raw(vectors: Mapping[str, FloatArray], state: Mapping[str, FloatArray]) -> None:
    """Raise ValueError if state or obstacles are no encoding of any.

    Normalised values often stay inside the bounds, but not what must be a unit quaternion, a whole
    number or a flag.
    """
    for name in ("end_effector_quaternion", "object_quaternion"):
        norm = float(np.linalg.norm(state[name]))
        if abs(norm - 1.0) > _ROUNDING:
            raise _abnormal("observation", f"have {name} of norm 1, not {norm}")
    limit = float(state["limit"][0]) * MAX_EPISODE_STEPS
    steps = float(state["elapsed"][0]) * limit
    for name, count in (("limit", limit), ("elapsed", steps)):
        if abs(count - round(count)) > _ROUNDING * max(1.0, limit / MAX_EPISODE_STEPS):
            raise _abnormal("observation", f"have {name} a whole number of steps, not {count}")
    if limit < 0.5:
        raise _abnormal("observation", f"have a limit of at least one step, not {limit}")
    control = float(state["control"][0])
    if not control.is_integer():
        raise _abnormal("observation", f"have an index as control, not {control}")
    if not (state["object_size"] > 0.0).all():
        raise _abnormal("observation", f"have a positive object_size, not {state['object_size']}")
    if "points" in vectors:
        _check_points(vectors["points"].reshape(CLOUD_POINTS, 3))
        return
    rows = vectors["obstacles"].reshape(MAX_OBSTACLES, -1)
    flags, rest = rows[:, : 1 + len(SHAPES)], rows[:, 1 + len(SHAPES) :]
    sound = ((flags == 0.0) | (flags == 1.0)).all()
    if not sound or (flags[:, 0] != flags[:, 1:].sum(axis=1)).any():
        raise _abnormal("obstacles", "have one shape in each row that is present, and none else")
    if rest[flags[:, 0] == 0.0].any():
        raise _abnormal("obstacles", "be zero in rows that are not present")


def _check_points(rows: FloatArray) -> None:
    present = np.abs(rows).max(axis=1) > 0.0
    if (present[1:] & ~present[:-1]).any():
        raise _abnormal("points", "have all points that are present before those that are not")
    points = rows[present]
    near = np.linalg.norm(points, axis=1) < _LEAST_POINT_DISTANCE
    below = points[:, 2] < _LEAST_POINT_HEIGHT
    if near.any() or below.any():
        raise _abnormal("points", "have no points below the table or in the arm's base")


def decode(observation: Any, task: str) -> DecodedObservation:
    """Decode one observation into scene, states and control mode.

    Args:
        observation: one observation, raw (dict) or flattened (vector); not a batch.
        task: the task it is from, one of `smp_gym.tasks.task_names`.

    Raises:
        ValueError: keys, shapes or values are not those of such an observation.
    """
    vectors = _as_dict(observation, task)
    state = _split(vectors["observation"], STATE_LAYOUT)
    codec = make_task(task).goals
    desired = _split(vectors["desired_goal"], codec.layout)
    achieved = _split(vectors["achieved_goal"], codec.layout)
    _check_raw(vectors, state)
    limit = round(float(state["limit"][0]) * MAX_EPISODE_STEPS)
    size = state["object_size"]
    cloud = None
    if "points" in vectors:
        cloud = vectors["points"].reshape(CLOUD_POINTS, 3)
        cloud = cloud[cloud.any(axis=1)]
    try:
        goals = codec.decode(desired, size)
    except ValueError as error:
        raise _abnormal("desired_goal", str(error)) from error
    scene = Scene(
        task=task,
        start=tuple(state["configuration"].tolist()),
        manipulated=ManipulatedObject(size=tuple(size.tolist())) if codec.with_object else None,
        goals=goals,
        obstacles=() if cloud is not None else _decode_obstacles(vectors["obstacles"]),
    )
    if np.abs(encode_desired_goal(scene) - vectors["desired_goal"]).max() > _ROUNDING:
        raise _abnormal("desired_goal", f"demand what {task} demands")
    if np.abs(_places_of_supports(scene) - state["supports"]).max() > _ROUNDING:
        raise _abnormal("observation", "have its supports where the desired goal has them")
    robot = RobotState(
        configuration=state["configuration"],
        reference=state["reference"],
        joint_velocity=state["joint_velocity"],
        finger_angles=state["finger_angles"],
        gripper_reference=float(state["gripper_reference"][0]),
        finger_velocity=state["finger_velocity"],
        end_effector_position=state["end_effector_position"],
        end_effector_quaternion=state["end_effector_quaternion"],
    )
    manipulated = ObjectState(
        position=state["object_position"],
        quaternion=state["object_quaternion"],
        linear_velocity=state["object_linear_velocity"],
        angular_velocity=state["object_angular_velocity"],
        size=size,
    )
    return DecodedObservation(
        scene=scene,
        robot=robot,
        object=manipulated,
        elapsed_steps=round(float(state["elapsed"][0]) * limit),
        limit=limit,
        collided=bool(achieved["collided"][0] > 0.5),
        control=CONTROLS[round(float(state["control"][0]))],
        points=cloud,
    )
