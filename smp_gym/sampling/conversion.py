"""Scene data as arrays for the kernels, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.scene import (
    BIN_FLOOR_THICKNESS,
    BIN_HEIGHT,
    BIN_INNER_HALF_WIDTH,
    BIN_WALL_THICKNESS,
    SHAPES,
    TABLE,
    Configuration,
    Goal,
    Motion,
    Obstacle,
    goal_boxes,
)

__all__ = ["fixture_rows", "to_configuration", "to_obstacle", "to_row", "to_solid_row"]


def to_configuration(q: FloatArray) -> Configuration:
    """Return (6,) rad as a scene's configuration."""
    a, b, c, d, e, f = q.tolist()
    return a, b, c, d, e, f


def fixture_rows(goals: tuple[Goal, ...]) -> FloatArray:
    """Return the (F, 9) rows of the table and the bodies of goals, as `smp_gym.scene.fixtures`."""
    bodies = (TABLE, *(box for goal in goals for box in goal_boxes(goal)))
    return np.array([to_row(body) for body in bodies])


def to_solid_row(goal: Goal) -> list[float]:
    """Return the body of a goal as one box."""
    if goal.kind != "bin":
        return to_row(goal_boxes(goal)[0])
    half = BIN_INNER_HALF_WIDTH + BIN_WALL_THICKNESS
    height = (BIN_HEIGHT + BIN_FLOOR_THICKNESS) / 2
    x, y, z = goal.position
    middle = z - BIN_FLOOR_THICKNESS + height
    return to_row(Obstacle(shape="box", position=(x, y, middle), size=(half, half, height)))


def to_row(obstacle: Obstacle) -> list[float]:
    """Return an upright obstacle as a row for the kernels."""
    _, _, z, w = obstacle.quaternion
    yaw = 2.0 * np.arctan2(z, w)
    return [
        float(SHAPES.index(obstacle.shape)),
        *obstacle.position,
        float(np.cos(yaw)),
        float(np.sin(yaw)),
        *obstacle.size,
    ]


def to_obstacle(row: FloatArray, motion: Motion | None = None) -> Obstacle:
    """Return the obstacle of a (9,) row; with a motion, it begins where that does."""
    yaw = float(np.arctan2(row[5], row[4]))
    fields: dict[str, Any] = {} if motion is None else {"motion": motion}
    here = (float(row[1]), float(row[2]), float(row[3]))
    return Obstacle(
        shape=SHAPES[int(row[0])],
        position=here if motion is None else motion.points[0],
        quaternion=(0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))),
        size=(float(row[6]), float(row[7]), float(row[8])),
        **fields,
    )
