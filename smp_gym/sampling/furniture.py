"""Pieces of furniture, made of boxes and cylinders: shelf, box, cage, table with objects.

The kinds are those of the scenes of MotionBenchMaker (Chamzas et al. 2022), built to the size of
this arm. Shelf, box and cage stand around a goal and open towards the robot, the box upwards; the
table stands between start and goal. All lengths are metres.

A piece is built in its own frame, which stands on the table top with x pointing away from the robot
and z up, and is then turned about the vertical and moved to its place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from smp_gym.scene import Obstacle

__all__ = ["FURNITURE", "Place", "draw_furniture"]

_PANEL = 0.01
"""Half thickness of panels and boards."""

_TURN = 0.25
"""Largest turn of a piece about the vertical, from facing the robot, rad."""

_SHELF_FRONT = (-0.22, -0.08)
_SHELF_HALF_WIDTH = (0.11, 0.17)
_SHELF_BACK = (0.14, 0.20)
_COMPARTMENT = (0.35, 0.43)
_UPPER_COMPARTMENT = (0.14, 0.24)
"""Front edge, half width and back of a shelf as seen from the goal, height of its compartment above
the goal and of the one over it."""

_BOX_FRONT = (0.11, 0.17)
_BOX_HALF_WIDTH = (0.11, 0.16)
_BOX_RIM = (0.36, 0.56)
_BOX_FRONT_RIM = (0.02, 0.12)
"""Distances of a box's walls from the goal, and how high they rise above it; the front wall, over
which the hand reaches in, is lower."""

_CAGE_FRONT = (-0.22, -0.10)
_CAGE_HALF_WIDTH = (0.12, 0.18)
_CAGE_BACK = (0.14, 0.20)
_CAGE_HEIGHT = (0.36, 0.48)
_POST_RADIUS = (0.010, 0.018)
_BAR_HEIGHT = (0.14, 0.28)
"""Of a cage: where its posts stand as seen from the goal, how high its top and the bars on its
sides lie above the goal, and how thick posts and bars are (radius, half width)."""

_TABLE_BEARING = (0.35, 0.65)
_TABLE_RADIUS = (0.42, 0.56)
_TABLE_HALF_DEPTH = (0.09, 0.15)
_TABLE_HALF_WIDTH = (0.07, 0.13)
_TABLE_TOP = (0.10, 0.20)
_OBJECTS = 5
_OBJECT_HALF_WIDTH = (0.02, 0.05)
_OBJECT_HALF_HEIGHT = (0.08, 0.20)
"""Of a table: its place (share of the turn from start to goal, distance from the base's axis), size
and height; number and size of the objects on it."""


@dataclass(frozen=True)
class Place:
    """The surroundings that a piece of furniture is fitted to.

    Attributes:
        goal: the surface on which the object shall end.
        start: the object's centre at the start.
    """

    goal: tuple[float, float, float]
    start: tuple[float, float, float]


def _box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Obstacle:
    """Return the box between these coordinates."""
    middles = [(low + high) / 2 for low, high in (x, y, z)]
    halves = [(high - low) / 2 for low, high in (x, y, z)]
    return Obstacle(
        shape="box",
        position=(middles[0], middles[1], middles[2]),
        size=(halves[0], halves[1], halves[2]),
    )


def _standing_cylinder(x: float, y: float, radius: float, bottom: float, top: float) -> Obstacle:
    half = (top - bottom) / 2
    return Obstacle(shape="cylinder", position=(x, y, bottom + half), size=(radius, radius, half))


def _bar(x: tuple[float, float], y: tuple[float, float], height: float, half: float) -> Obstacle:
    """Return a level bar between two points."""
    return _box(
        (x[0] - half, x[1] + half), (y[0] - half, y[1] + half), (height - half, height + half)
    )


def _shelf(place: Place, rng: np.random.Generator) -> list[Obstacle]:
    """Return side panels, back, two boards and a can on the lower of these."""
    floor = place.goal[2]
    front, back = rng.uniform(*_SHELF_FRONT), rng.uniform(*_SHELF_BACK)
    half = rng.uniform(*_SHELF_HALF_WIDTH)
    board = floor + rng.uniform(*_COMPARTMENT)
    top = board + rng.uniform(*_UPPER_COMPARTMENT)
    thick = 2 * _PANEL
    radius, height = rng.uniform(0.02, 0.04), rng.uniform(0.08, 0.12)
    x = rng.uniform(front + radius, back - radius)
    y = rng.uniform(-half + radius, half - radius)
    return [
        _box((front, back), (half, half + thick), (0.0, top)),
        _box((front, back), (-half - thick, -half), (0.0, top)),
        _box((back, back + thick), (-half, half), (0.0, top)),
        _box((front, back), (-half, half), (board, board + thick)),
        _box((front, back), (-half, half), (top - thick, top)),
        _standing_cylinder(x, y, radius, board + thick, board + thick + height),
    ]


def _open_box(place: Place, rng: np.random.Generator) -> list[Obstacle]:
    """Return four walls, the front one lower."""
    floor = place.goal[2]
    front, back = -rng.uniform(*_BOX_FRONT), rng.uniform(*_BOX_FRONT)
    half = rng.uniform(*_BOX_HALF_WIDTH)
    rim = floor + rng.uniform(*_BOX_RIM)
    front_rim = floor + rng.uniform(*_BOX_FRONT_RIM)
    thick = 2 * _PANEL
    return [
        _box((front - thick, back + thick), (half, half + thick), (0.0, rim)),
        _box((front - thick, back + thick), (-half - thick, -half), (0.0, rim)),
        _box((back, back + thick), (-half, half), (0.0, rim)),
        _box((front - thick, front), (-half, half), (0.0, front_rim)),
    ]


def _cage(place: Place, rng: np.random.Generator) -> list[Obstacle]:
    """Return four posts, bars on both sides (two of them towards the start), one over the front."""
    floor = place.goal[2]
    front, back = rng.uniform(*_CAGE_FRONT), rng.uniform(*_CAGE_BACK)
    half = rng.uniform(*_CAGE_HALF_WIDTH)
    top = floor + rng.uniform(*_CAGE_HEIGHT)
    radius = rng.uniform(*_POST_RADIUS)
    near, far = floor + rng.uniform(*_BAR_HEIGHT, size=2)
    side = half if _bearing(place.start) > _bearing(place.goal) else -half
    posts = [
        _standing_cylinder(x, y, radius, 0.0, top) for x in (front, back) for y in (-half, half)
    ]
    return [
        *posts,
        _bar((front, back), (side, side), near, radius),
        _bar((front, back), (side, side), top, radius),
        _bar((front, back), (-side, -side), far, radius),
        _bar((front, front), (-half, half), top, radius),
    ]


def _table(place: Place, rng: np.random.Generator) -> list[Obstacle]:
    """Return a board on two panels, with boxes and cylinders on it."""
    depth, width = rng.uniform(*_TABLE_HALF_DEPTH), rng.uniform(*_TABLE_HALF_WIDTH)
    top = rng.uniform(*_TABLE_TOP)
    bottom = top - 2 * _PANEL
    parts = [_box((-depth, depth), (-width, width), (bottom, top))]
    for x in (-depth, depth - 2 * _PANEL):
        parts.append(_box((x, x + 2 * _PANEL), (-width, width), (0.0, bottom)))
    for _ in range(_OBJECTS):
        half = rng.uniform(*_OBJECT_HALF_WIDTH)
        high = top + 2 * rng.uniform(*_OBJECT_HALF_HEIGHT)
        x, y = rng.uniform(half - depth, depth - half), rng.uniform(half - width, width - half)
        if rng.uniform() < 0.5:
            parts.append(_standing_cylinder(x, y, half, top, high))
        else:
            parts.append(_box((x - half, x + half), (y - half, y + half), (top, high)))
    return parts


def _bearing(point: tuple[float, float, float]) -> float:
    return float(np.arctan2(point[1], point[0]))


def _around_goal(place: Place, rng: np.random.Generator) -> tuple[float, float, float]:
    x, y, _ = place.goal
    return x, y, _bearing(place.goal) + rng.uniform(-_TURN, _TURN)


def _between(place: Place, rng: np.random.Generator) -> tuple[float, float, float]:
    begin, end = _bearing(place.start), _bearing(place.goal)
    bearing = begin + rng.uniform(*_TABLE_BEARING) * (end - begin)
    radius = rng.uniform(*_TABLE_RADIUS)
    turn = bearing + rng.uniform(-_TURN, _TURN)
    return float(radius * np.cos(bearing)), float(radius * np.sin(bearing)), turn


_Build = Callable[[Place, np.random.Generator], list[Obstacle]]
_Put = Callable[[Place, np.random.Generator], tuple[float, float, float]]

_BUILDERS: dict[str, tuple[_Build, _Put]] = {
    "shelf": (_shelf, _around_goal),
    "box": (_open_box, _around_goal),
    "cage": (_cage, _around_goal),
    "table": (_table, _between),
}

FURNITURE = tuple(_BUILDERS)
"""Kinds of furniture."""


def draw_furniture(kind: str, place: Place, rng: np.random.Generator) -> tuple[Obstacle, ...]:
    """Return a piece of furniture of random size, at a random turn, near its place.

    Nothing is known here of the robot: collisions of the piece with it or with the goal's own body
    are for the caller to find.

    Args:
        kind: one of `FURNITURE`.
        place: what it is built for.
        rng: source of all randomness.
    """
    build, put = _BUILDERS[kind]
    parts = build(place, rng)
    x, y, turn = put(place, rng)
    c, s = float(np.cos(turn)), float(np.sin(turn))
    half = turn / 2
    quaternion = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
    placed = []
    for part in parts:
        u, v, z = part.position
        position = (x + c * u - s * v, y + s * u + c * v, z)
        placed.append(part.model_copy(update={"position": position, "quaternion": quaternion}))
    return tuple(placed)
