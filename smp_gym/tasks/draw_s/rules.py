"""DrawS: draw an S in the air with a pen, past obstacles on the stroke."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import AnyFloatArray, BoolArray
from smp_gym.geometry import polylines
from smp_gym.geometry.distance import signed_distance
from smp_gym.robot.pen import PEN_POSE
from smp_gym.scene import STROKE_POINTS, Goal, Obstacle, Scene
from smp_gym.tasks.common import POTENTIAL_PER_METRE, CommonRules
from smp_gym.tasks.draw_s import stroke_kernels
from smp_gym.tasks.goals import GoalCodec, flag, position
from smp_gym.tasks.status import Status

__all__ = [
    "CHECKPOINT_TOLERANCE",
    "COVERED_DISTANCE",
    "END_TOLERANCE",
    "RULES",
    "DrawS",
    "covered",
    "equal_arc",
    "passed_in_order",
]

CHECKPOINT_TOLERANCE = 0.04
"""Metres: distance of the pen from a checkpoint up to which it passes it."""

END_TOLERANCE = 0.025
"""Metres: distance of the pen from the end of the stroke up to which the S is done."""

COVERED_DISTANCE = 0.06
"""Metres: a checkpoint nearer than this to an obstacle's surface, or inside it, is covered: the pen
has to go round there, and the checkpoint is not demanded."""

_SUBDIVISION = 3
"""Points into which the line between two neighbouring points of the trace is cut."""


def _encode(scene: Scene) -> dict[str, Any]:
    """Return the desired goal: the stroke, and flags of the checkpoints that the pen must pass."""
    stroke = scene.goals[0]
    demanded = [float(flag) for flag in stroke.demanded]
    return {"stroke": np.ravel(stroke.checkpoints), "demanded": demanded, "collided": 0.0}


def _decode(desired: Mapping[str, NDArray[np.float64]], size: AnyFloatArray) -> tuple[Goal, ...]:
    if desired["demanded"][-1] != 1.0:
        raise ValueError("demand the stroke's end")
    points = tuple((x, y, z) for x, y, z in desired["stroke"].reshape(-1, 3).tolist())
    demanded = tuple(bool(flag > 0.5) for flag in desired["demanded"])
    return (Goal(kind="stroke", position=points[-1], checkpoints=points, demanded=demanded),)


_GOALS = GoalCodec(
    (position("stroke", STROKE_POINTS), flag("demanded", STROKE_POINTS), flag("collided")),
    _encode,
    _decode,
    with_object=False,
)
"""``stroke`` holds points at equal steps of arc, of what the pen has drawn so far or shall draw;
``demanded`` says which of the latter count, and is 1 throughout in what was drawn."""

_STROKE = _GOALS.columns("stroke")
_END = slice(_STROKE.stop - 3, _STROKE.stop)
_DEMANDED = _GOALS.columns("demanded")


def equal_arc(line: AnyFloatArray, count: int = STROKE_POINTS) -> NDArray[np.float64]:
    """Return `count` points of a line at equal steps of arc length.

    Args:
        line: (M, 3) m, at least one point; where it has no length, its last point is repeated.
        count: at least 2.

    Returns:
        (count, 3), the first and last being those of the line.
    """
    return polylines.equal_arc(np.ascontiguousarray(line, np.float64), count)


def covered(points: AnyFloatArray, obstacles: Sequence[Obstacle]) -> BoolArray:
    """Return a mask (N,) of points nearer than `COVERED_DISTANCE` to an obstacle."""
    return np.asarray(signed_distance(points, obstacles) < COVERED_DISTANCE)


def passed_in_order(
    trace: AnyFloatArray, checkpoints: AnyFloatArray, demanded: AnyFloatArray
) -> NDArray[np.int64]:
    """Return the progress of a trace along a stroke.

    The trace is taken as the line through its points. A checkpoint counts as passed where the line
    comes within `CHECKPOINT_TOLERANCE` of it, not before the place where the previous demanded one
    was passed. A detour round an obstacle, which lengthens the arc and moves all later points of
    the trace, therefore costs nothing.

    Args:
        trace: (..., N, 3) m.
        checkpoints: (..., N, 3) m.
        demanded: (..., N), above 0.5 where a checkpoint counts.

    Returns:
        (...) index of the first demanded checkpoint that was not passed, N if all were.
    """
    shape = np.broadcast_shapes(trace.shape[:-2], checkpoints.shape[:-2], demanded.shape[:-1])
    reached = stroke_kernels.passed_in_order(
        _batch(trace, shape, 2),
        _batch(checkpoints, shape, 2),
        _batch(demanded, shape, 1),
        CHECKPOINT_TOLERANCE,
        _SUBDIVISION,
    )
    return np.asarray(reached.reshape(shape))


def _batch(values: AnyFloatArray, shape: tuple[int, ...], axes: int) -> NDArray[np.float64]:
    """Return (..., A...) values, broadcast to a shape, as contiguous (B, A...)."""
    own = values.shape[values.ndim - axes :]
    return np.ascontiguousarray(np.broadcast_to(values, shape + own).reshape(-1, *own), np.float64)


@dataclass(frozen=True)
class DrawS(CommonRules):
    """The task of `smp_gym/DrawS-v0`.

    The pen is part of the hand and draws all the time. Success: it is at the end of the stroke,
    has passed the demanded checkpoints in their order (`passed_in_order`), and nothing collided.
    The gripper moves the fingers but not the pen.
    """

    name: str = "DrawS"

    goals: ClassVar[GoalCodec] = _GOALS
    object_in_hand: ClassVar[AnyFloatArray] = PEN_POSE

    def check_scene(self, scene: Scene) -> None:
        """Raise ValueError if an episode of this task cannot be played in the scene."""
        super().check_scene(scene)
        if scene.manipulated is not None:
            raise ValueError(f"scene.manipulated must be None, got {scene.manipulated!r}")
        if [goal.kind for goal in scene.goals] != ["stroke"]:
            kinds = ", ".join(goal.kind for goal in scene.goals)
            raise ValueError(f"scene.goals must hold one stroke, got {kinds}")

    def permitted_contacts(self, held: bool) -> frozenset[tuple[str, str]]:
        """Return the pairs of groups that may touch; see `Task.permitted_contacts`."""
        return frozenset({("hand", "hand")})

    def achieved_goal(self, status: Status) -> dict[str, Any]:
        """Return the values of the achieved goal by field name."""
        return {
            "stroke": equal_arc(status.trace).ravel(),
            "demanded": np.ones(STROKE_POINTS),
            "collided": float(status.collided),
        }

    def success(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return whether goals are reached.

        Args:
            achieved: (..., 129) achieved goals.
            desired: (..., 129) desired goals.

        Returns:
            (...) whether the trace ends within `END_TOLERANCE` of the stroke's end, has passed the
            demanded checkpoints in order, and nothing collided.
        """
        offset = achieved[..., _END] - desired[..., _END]
        ended = np.sqrt((offset * offset).sum(axis=-1)) <= END_TOLERANCE
        ended = np.asarray(ended & ~self.collided(achieved))
        # Few traces end where they should; only they are worth a closer look.
        if not ended.any():
            return ended
        achieved, desired = np.broadcast_arrays(achieved, desired)
        reached = _reached(achieved[ended], desired[ended])
        ended[ended] = reached == STROKE_POINTS
        return ended

    def potential(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> AnyFloatArray:
        """Return minus the length that is left of the stroke, (...), 2 per metre.

        It is the distance of the pen to the next demanded checkpoint, and from there the length of
        the stroke.
        """
        achieved, desired = np.broadcast_arrays(achieved, desired)
        stroke = _points(desired)
        upcoming = np.minimum(_reached(achieved, desired), STROKE_POINTS - 1)[..., None]
        point = np.take_along_axis(stroke, upcoming[..., None], axis=-2)[..., 0, :]
        steps = np.linalg.norm(np.diff(stroke, axis=-2), axis=-1)
        left = np.zeros(stroke.shape[:-1])
        left[..., :-1] = np.cumsum(steps[..., ::-1], axis=-1)[..., ::-1]
        distance = np.linalg.norm(_points(achieved)[..., -1, :] - point, axis=-1)
        remaining = np.take_along_axis(left, upcoming, axis=-1)[..., 0]
        return np.asarray(-POTENTIAL_PER_METRE * (distance + remaining))


def _points(goals: AnyFloatArray) -> AnyFloatArray:
    """Return the points (..., N, 3) of goals (..., 129)."""
    return goals[..., _STROKE].reshape(*goals.shape[:-1], STROKE_POINTS, 3)


def _reached(achieved: AnyFloatArray, desired: AnyFloatArray) -> NDArray[np.int64]:
    return passed_in_order(_points(achieved), _points(desired), desired[..., _DEMANDED])


RULES = DrawS()
