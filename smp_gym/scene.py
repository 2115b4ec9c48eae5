"""Scenes: what an episode contains, as frozen data that goes to JSON and back.

A scene holds everything that `reset` draws at random: obstacles, goals, the manipulated object and
the start configuration. Lengths are metres in the robot's base frame, whose origin lies on the
table top (z = 0, z up); angles are radians; quaternions are (x, y, z, w).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from smp_gym.arrays import FloatArray, checked_array, shown
from smp_gym.geometry.registry import REGISTRY, SHAPES

__all__ = [
    "BIN_FLOOR_THICKNESS",
    "BIN_HEIGHT",
    "BIN_INNER_HALF_WIDTH",
    "BIN_WALL_THICKNESS",
    "DIFFICULTIES",
    "EVALUATION_RANGE_START",
    "EVALUATION_SEEDS_START",
    "FAMILIES",
    "MAX_OBSTACLES",
    "PAD_DEPTH",
    "PAD_HALF_WIDTH",
    "SHAPES",
    "STROKE_POINTS",
    "TABLE",
    "TASKS",
    "Goal",
    "GoalKind",
    "ManipulatedObject",
    "Motion",
    "Obstacle",
    "Scene",
    "fixtures",
    "goal_bodies",
    "goal_boxes",
    "goal_kind",
]

TASKS: tuple[str, ...]
"""Names of the tasks, as they stand in the environment ids; looked up in `smp_gym.tasks`."""

DIFFICULTIES = ("none", "easy", "medium", "hard")
"""Difficulties, from no obstacles to many with little room between them."""

FAMILIES = (
    "obstacles",
    "shelf",
    "box",
    "cage",
    "table",
    "clutter",
    "moving",
    "displaced",
)
"""Families of scenes: few bodies set against the demonstrated movement, four kinds of furniture,
many small solids, obstacles that move, and obstacles that are shifted in mid-episode. Which of them
a task has says `smp_gym.tasks.registry.task_families`."""

if not TYPE_CHECKING:

    def __getattr__(name: str) -> tuple[str, ...]:
        # The tasks are made of scenes: they can be asked only once this module is complete.
        from smp_gym.tasks.registry import task_definitions

        if name == "TASKS":
            return tuple(task.name for task in task_definitions())
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


MAX_OBSTACLES = 16
"""Rows of obstacles in an observation; a scene never holds more."""

EVALUATION_SEEDS_START = 100_000
"""Seeds below are for tuning, seeds from here on for evaluation only."""

EVALUATION_RANGE_START = 200_000
"""First seed of the present range of evaluation, from which the frozen lists are drawn.

The range before it, from `EVALUATION_SEEDS_START` on, has been looked at: numbers from there are
not those of unseen scenes.
"""

BIN_INNER_HALF_WIDTH = 0.08
BIN_WALL_THICKNESS = 0.01
BIN_FLOOR_THICKNESS = 0.01
BIN_HEIGHT = 0.10
"""The bin of Placement, a square open box, m; `BIN_HEIGHT` is from its floor's top to its rim."""

PAD_HALF_WIDTH = 0.07
PAD_DEPTH = 0.2
"""A pad of DoubleSidedPlacement, a square column, m. It reaches `PAD_DEPTH` down from its surface
and stands in the table with its lower end, so that pads of all heights are one shape."""


STROKE_POINTS = 32
"""Checkpoints of a stroke, at equal steps of its arc, first and last point included."""


def _unit(quaternion: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    norm = math.sqrt(sum(c * c for c in quaternion))
    if abs(norm - 1.0) > 1e-3:
        raise ValueError(f"quaternion must have norm 1, got {quaternion} with norm {norm:.6g}")
    return quaternion


def _shape(name: str) -> str:
    if name not in REGISTRY:
        raise ValueError(f"shape must be one of {', '.join(SHAPES)}; got {shown(name)}")
    return name


def _family(name: str) -> str:
    if name not in FAMILIES:
        raise ValueError(f"family must be one of {', '.join(FAMILIES)}; got {shown(name)}")
    return name


def _plain(value: Any) -> Any:
    """Return a vector of real numbers as plain floats."""
    if type(value) in (tuple, list) and all(type(entry) in (float, int) for entry in value):
        return value
    return tuple(checked_array("the vector", value, (None,)).tolist())


_Plain = BeforeValidator(_plain)
Vector3 = Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat], _Plain]
Configuration = Annotated[
    tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat], _Plain
]
Quaternion = Annotated[
    tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat], _Plain, AfterValidator(_unit)
]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Size = Annotated[tuple[Positive, Positive, Positive], _Plain]


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


_VELOCITY_TOLERANCE = 1e-6
"""m/s, by which the velocity of an obstacle may differ from that of its motion at time 0."""


class Motion(_Frozen):
    """A smooth path of an obstacle's centre in time: a cubic Hermite spline through given knots.

    The velocity at a knot is that of the parabola through it and its two neighbours (Catmull-Rom
    for unequal intervals), and 0 where the path rests before or after the knot. At the first knot
    it is that of the parabola which leads to the velocity at the second. After the last knot the
    body rests where it is.

    Attributes:
        times: s since the episode began, from 0 on, increasing; at least two.
        points: m, where the centre is then.
    """

    times: tuple[FiniteFloat, ...] = Field(min_length=2)
    points: tuple[Vector3, ...]

    @model_validator(mode="after")
    def _knots_agree(self) -> Motion:
        if self.times[0] != 0.0:
            raise ValueError(f"times of a motion must begin with 0, got {self.times[0]}")
        for before, after in zip(self.times, self.times[1:], strict=False):
            if after <= before:
                raise ValueError(f"times of a motion must increase, got {after} after {before}")
        if len(self.points) != len(self.times):
            raise ValueError(
                f"points of a motion must be as many as its times, {len(self.times)}, "
                f"got {len(self.points)}"
            )
        return self

    @cached_property
    def _velocities(self) -> tuple[tuple[float, ...], ...]:
        """(K, 3) m/s at the knots; an array would not let motions be compared."""
        interval = np.diff(self.times)[:, None]
        slope = np.diff(np.array(self.points), axis=0) / interval
        velocities = np.zeros((len(self.times), 3))
        before, after = interval[:-1], interval[1:]
        inner = (after * slope[:-1] + before * slope[1:]) / (before + after)
        moving = np.asarray(slope.any(axis=1))
        velocities[1:-1] = np.where((moving[:-1] & moving[1:])[:, None], inner, 0.0)
        if moving[0]:
            velocities[0] = 2.0 * slope[0] - velocities[1]
        return tuple(map(tuple, velocities.tolist()))

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) m and velocity (3,) m/s at a time, s since the episode began."""
        times = self.times
        if time >= times[-1]:
            return np.array(self.points[-1]), np.zeros(3)
        time = max(0.0, time)
        k = bisect_right(times, time) - 1
        length = times[k + 1] - times[k]
        s = (time - times[k]) / length
        begin, end = np.array(self.points[k]), np.array(self.points[k + 1])
        leaving, arriving = np.array(self._velocities[k]), np.array(self._velocities[k + 1])
        span = end - begin
        position = (
            begin
            + s * s * (3.0 - 2.0 * s) * span
            + length * s * (1.0 - s) * ((1.0 - s) * leaving - s * arriving)
        )
        velocity = (
            6.0 * s * (1.0 - s) / length * span
            + (1.0 - s) * (1.0 - 3.0 * s) * leaving
            + s * (3.0 * s - 2.0) * arriving
        )
        return position, velocity


def _has_three(size: Any) -> bool:
    """Return whether a size is no single number and not of another length."""
    return isinstance(size, Sequence | np.ndarray) and len(np.atleast_1d(size)) == 3


class Obstacle(_Frozen):
    """A rigid body that nothing may touch.

    Attributes:
        shape: one of `SHAPES`: "box", "cylinder" (axis along its z), "sphere", or one of another
            package (`smp_gym.geometry.registry`).
        position: centre, m.
        quaternion: orientation (x, y, z, w).
        size: half-extents along its own axes, m: (hx, hy, hz) of a box, (radius, radius,
            half height) of a cylinder, (radius, radius, radius) of a sphere.
        velocity: linear velocity, m/s, as it is observed. With a motion it is that at time 0, and
            may be left out.
        motion: path of the centre in time, beginning at `position`; None where none is known. A
            scene in which something moves can be played only with it.
    """

    shape: Annotated[str, AfterValidator(_shape)]
    position: Vector3
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
    size: Size
    velocity: Vector3 = (0.0, 0.0, 0.0)
    motion: Motion | None = None

    @model_validator(mode="before")
    @classmethod
    def _size_has_three_numbers(cls, fields: Any) -> Any:
        given = fields if isinstance(fields, Mapping) else {}
        shape, size = given.get("shape"), given.get("size", (1.0, 1.0, 1.0))
        if isinstance(shape, str) and shape in REGISTRY and not _has_three(size):
            raise ValueError(f"size of a {shape} is {REGISTRY[shape].measures}, got {shown(size)}")
        return fields

    @model_validator(mode="before")
    @classmethod
    def _velocity_of_motion(cls, fields: Any) -> Any:
        if not isinstance(fields, Mapping) or fields.get("motion") is None or "velocity" in fields:
            return fields
        try:
            motion = Motion.model_validate(fields["motion"])
        except ValueError as error:
            raise ValueError(f"motion of an obstacle is none: {error}") from error
        return {**fields, "motion": motion, "velocity": tuple(motion.at(0.0)[1].tolist())}

    @model_validator(mode="after")
    def _sizes_agree(self) -> Obstacle:
        shape = REGISTRY[self.shape]
        if tuple(shape.fitted(np.array(self.size)).tolist()) != self.size:
            raise ValueError(f"size of a {self.shape} is {shape.measures}, got {self.size}")
        return self

    @model_validator(mode="after")
    def _motion_begins_here(self) -> Obstacle:
        if self.motion is None:
            return self
        if self.motion.points[0] != self.position:
            raise ValueError(
                f"the first point of a motion must be the position {self.position}, "
                f"got {self.motion.points[0]}"
            )
        velocity = self.motion.at(0.0)[1]
        if np.abs(velocity - self.velocity).max() > _VELOCITY_TOLERANCE:
            raise ValueError(
                f"velocity of an obstacle with a motion must be that at time 0, "
                f"{velocity.tolist()}, got {self.velocity}"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_absent_motion(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields: dict[str, Any] = handler(self)
        if self.motion is None:
            del fields["motion"]
        return fields

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) m and velocity (3,) m/s of the centre at a time.

        Without a motion the obstacle is taken to go on at its velocity.

        Args:
            time: s since the obstacle was as it is here; with a motion, since the episode began.
        """
        if self.motion is not None:
            return self.motion.at(time)
        velocity = np.array(self.velocity)
        return np.array(self.position) + time * velocity, velocity

    def moved(self, time: float) -> Obstacle:
        """Return the obstacle as it is at a time, see `at`, with its velocity and no motion."""
        if self.motion is None:
            return self
        position, velocity = (tuple(vector.tolist()) for vector in self.at(time))
        return self.model_copy(update={"position": position, "velocity": velocity, "motion": None})


class ManipulatedObject(_Frozen):
    """The box that the task moves.

    Attributes:
        size: half-extents, m.
        mass: kg.
        position: of its centre at the start, m; None where it is in the hand then.
        yaw: its turn about the vertical at the start, rad; 0 where it is in the hand.
    """

    size: Size = (0.025, 0.025, 0.03)
    mass: Positive = 0.1
    position: Vector3 | None = None
    yaw: FiniteFloat = 0.0

    @model_validator(mode="after")
    def _pose_is_whole(self) -> ManipulatedObject:
        if self.position is None and self.yaw != 0.0:
            raise ValueError(f"yaw of an object without position must be 0, got {self.yaw}")
        return self

    @model_serializer(mode="wrap")
    def _without_absent_pose(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields: dict[str, Any] = handler(self)
        if self.position is None:
            del fields["position"], fields["yaw"]
        return fields


def _known_kind(name: str) -> str:
    return goal_kind(name).name


class Goal(_Frozen):
    """A goal: the place of the object at the end, or the stroke that the pen shall draw.

    Attributes:
        kind: "bin", an open box in which the object must come to rest; "pad", a raised square on
            which it must; "stroke", a line in space that the pen must follow; "lift", a point in
            the air to which the hand must bring the object; or a kind that a task brings
            (`smp_gym.tasks.definition.TaskDefinition.goal_kinds`).
        position: centre of the surface on which the object comes to rest, end of the stroke, or
            that point, m.
        checkpoints: `STROKE_POINTS` points of a stroke, the last of which is `position`, m.
        demanded: which of these the pen must pass, the last always; others an obstacle covers.
    """

    kind: Annotated[str, AfterValidator(_known_kind)] = "bin"
    position: Vector3
    checkpoints: tuple[Vector3, ...] = ()
    demanded: tuple[bool, ...] = ()

    @model_validator(mode="after")
    def _stroke_is_whole(self) -> Goal:
        count = STROKE_POINTS if self.kind == "stroke" else 0
        for name in ("checkpoints", "demanded"):
            if len(getattr(self, name)) != count:
                raise ValueError(
                    f"{name} of a {self.kind} must be {count}, got {len(getattr(self, name))}"
                )
        if count and self.checkpoints[-1] != self.position:
            raise ValueError(
                f"position of a stroke must be its last checkpoint {self.checkpoints[-1]}, "
                f"got {self.position}"
            )
        if count and not self.demanded[-1]:
            raise ValueError("demanded must be True for the last checkpoint, got False")
        return self

    @model_serializer(mode="wrap")
    def _without_empty_fields(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields: dict[str, Any] = handler(self)
        return {name: value for name, value in fields.items() if value != () and value != []}


class Scene(_Frozen):
    """Everything that one episode draws at random.

    Attributes:
        task: name of the task, one of `TASKS`.
        version: version of the task's scene distribution; part of what determines the scene.
        family: one of `FAMILIES`.
        difficulty: one of `DIFFICULTIES`, or "custom" for a scene made by hand.
        seed: the seed it was drawn from, or None for a scene made by hand.
        start: joint angles at the start of the episode, rad.
        manipulated: the object, or None in tasks without one.
        goals: at least one goal; reaching any one of them is success.
        obstacles: at most `MAX_OBSTACLES`.
    """

    task: str
    version: int = 0
    family: Annotated[str, AfterValidator(_family)] = FAMILIES[0]
    difficulty: Literal["none", "easy", "medium", "hard", "custom"] = "custom"
    seed: int | None = Field(default=None, ge=0)
    start: Configuration
    manipulated: ManipulatedObject | None = None
    goals: tuple[Goal, ...] = Field(min_length=1)
    obstacles: tuple[Obstacle, ...] = Field(default=(), max_length=MAX_OBSTACLES)

    @model_validator(mode="after")
    def _task_exists(self) -> Scene:
        from smp_gym.tasks.registry import task_definition

        task_definition(self.task)
        return self

    def to_json(self) -> str:
        """Return the scene as one JSON object; `from_json` gives it back exactly."""
        return self.model_dump_json()

    @classmethod
    def from_json(cls, text: str | bytes) -> Scene:
        """Parse what `to_json` wrote.

        Raises:
            ValueError: the text is not JSON or not a scene; the message names field and value.
        """
        return cls.model_validate_json(text)


TABLE = Obstacle(shape="box", position=(0.0, 0.0, -0.3), size=(1.5, 1.5, 0.3))
"""The table, its top at z = 0; so thick that the top is its nearest side wherever the arm gets."""


@dataclass(frozen=True)
class GoalKind:
    """A kind of goals.

    Attributes:
        name: `Goal.kind`.
        boxes: returns the boxes that make up the body of such a goal.
        body_names: what the bodies of a scene's goals are called, in their order; none where such
            goals have no body. What stands before the first underscore is the group that
            `smp_gym.tasks.Task.permitted_contacts` names.
        color: of the bodies, red, green, blue and opacity from 0 to 1.
    """

    name: str
    boxes: Callable[[Goal], tuple[Obstacle, ...]] = lambda goal: ()
    body_names: tuple[str, ...] = ()
    color: tuple[float, float, float, float] = (0.36, 0.60, 0.42, 1.0)


def _bin_boxes(goal: Goal) -> tuple[Obstacle, ...]:
    x, y, z = goal.position
    inner, wall = BIN_INNER_HALF_WIDTH, BIN_WALL_THICKNESS / 2
    outer = inner + BIN_WALL_THICKNESS
    floor = BIN_FLOOR_THICKNESS / 2
    height = BIN_HEIGHT / 2
    floor_box = Obstacle(shape="box", position=(x, y, z - floor), size=(outer, outer, floor))
    walls = (
        ((x + inner + wall, y, z + height), (wall, outer, height)),
        ((x - inner - wall, y, z + height), (wall, outer, height)),
        ((x, y + inner + wall, z + height), (inner, wall, height)),
        ((x, y - inner - wall, z + height), (inner, wall, height)),
    )
    return (floor_box, *(Obstacle(shape="box", position=p, size=s) for p, s in walls))


def _pad_boxes(goal: Goal) -> tuple[Obstacle, ...]:
    x, y, z = goal.position
    half = PAD_DEPTH / 2
    size = (PAD_HALF_WIDTH, PAD_HALF_WIDTH, half)
    return (Obstacle(shape="box", position=(x, y, z - half), size=size),)


_GOAL_KINDS = (
    GoalKind("bin", _bin_boxes, ("bin",), (0.30, 0.45, 0.62, 1.0)),
    GoalKind("pad", _pad_boxes, ("pad_left", "pad_right")),
    GoalKind("stroke"),
    GoalKind("lift"),
)


def goal_kind(name: str) -> GoalKind:
    """Return a kind of goals: one of those here, or one that a task brings.

    Raises:
        ValueError: no such kind.
    """
    kinds = {kind.name: kind for kind in _GOAL_KINDS}
    if name not in kinds:
        from smp_gym.tasks.registry import task_definitions

        kinds |= {kind.name: kind for task in task_definitions() for kind in task.goal_kinds}
    if name not in kinds:
        raise ValueError(f"kind must be one of {', '.join(kinds)}; got {shown(name)}")
    return kinds[name]


def goal_bodies(scene: Scene) -> dict[str, Goal]:
    """Return the bodies that the goals of a scene bring: their names, and the goals that they mark.

    A bin is called ``bin``; of two pads the first is called ``pad_left``, the second ``pad_right``.
    A stroke or a point in the air brings none.
    """
    goals = [goal for goal in scene.goals if goal_kind(goal.kind).body_names]
    names = (goal_kind(goal.kind).body_names[number] for number, goal in enumerate(goals))
    return dict(zip(names, goals, strict=True))


def goal_boxes(goal: Goal) -> tuple[Obstacle, ...]:
    """Return the boxes that make up the body of a goal; a stroke or a point in the air has none."""
    return goal_kind(goal.kind).boxes(goal)


def fixtures(scene: Scene) -> tuple[Obstacle, ...]:
    """Return the bodies that the task itself brings: the table first, then those of the goals.

    They are no obstacles (the object may rest on them), but the arm must not touch them.
    """
    return (TABLE, *(box for goal in scene.goals for box in goal_boxes(goal)))
