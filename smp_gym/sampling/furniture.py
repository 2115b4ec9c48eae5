"""Pieces of furniture, made of boxes and cylinders: shelf, box, cage, desk with objects on it.

The kinds are those of the scenes of MotionBenchMaker (Chamzas et al. 2022), built to the size of
this arm. Every piece stands around a goal and leaves one opening for the hand: between the stiles
of a shelf, the flaps of a box, the front posts of a cage, the pedestals of a desk. How wide the
opening is and how high it must be, a `Passage` says. All lengths are metres.

A piece is built in the frame of its goal, with its origin on the table top below the goal, x
pointing away from the robot and z up; it is then turned a little about the middle of its opening
and moved to its place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.scene import Obstacle

__all__ = ["FURNITURE", "Passage", "draw_furniture"]

_PANEL = (0.010, 0.016)
"""Thickness of panels and boards."""

_SETBACK = (0.02, 0.06)
"""How far a piece stands off the goal's body and the open hand, on each side."""

_STILE_DEPTH = 0.02
_UPPER_COMPARTMENT = (0.14, 0.22)
"""Of a shelf: depth of the stiles beside its opening, height of the compartment over the goal's."""

_LID = (0.01, 0.03)
_FLAP = (0.85, 1.0)
_LEAST_RIM = 0.03
"""Of a box: how high its lid lies above the fingers that open, how high
the flaps on it reach, as a share of how high hand and object rise out of them, and the lowest front
wall that is worth its while."""

_POST_RADIUS = (0.010, 0.016)
_BAR_HEIGHT = (0.14, 0.28)
"""Of a cage: radius of its posts and half width of its bars, and how high the bars on its sides lie
above the goal."""

_PEDESTAL_DEPTH = (0.03, 0.05)
_LEG_RADIUS = 0.012
_OBJECTS = 3
_OBJECT_HALF_WIDTH = (0.02, 0.04)
_OBJECT_HALF_HEIGHT = (0.04, 0.10)
"""Of a desk: its pedestals and legs, number and size of the objects on it."""

_LARGEST_TURN = 0.15
"""Largest turn of a piece about the vertical, from facing the robot, rad."""


@dataclass(frozen=True, eq=False)
class Passage:
    """The last part of a movement to a goal, to which a piece of furniture is fitted.

    Attributes:
        goal: the surface on which the object shall end, base frame.
        half: half width of the goal's body along the axes of the goal's frame.
        centers: (K, 3), spheres that arm, hand and object sweep, in the goal's frame.
        radius: (K,) of these.
        bottom: height of the lowest point of hand and object at the release.
        reach: x of their farthest point there.
        spread: half width of the hand once it has opened.
        inside: height of the highest point of its fingers then.
        rise: how much higher that is at the begin of the movement.
        middle: y of the middle of the hand at the release.
        opening: free width of the opening.
        headroom: what the piece leaves above and below the spheres.
        slack: by how much the opening may be used up by a turn, on each side.
        side: 1 if the movement comes from where y is positive, else -1.
    """

    goal: tuple[float, float, float]
    half: float
    centers: FloatArray
    radius: FloatArray
    bottom: float
    reach: float
    spread: float
    inside: float
    rise: float
    middle: float
    opening: float
    headroom: float
    slack: float
    side: int

    def _between(self, front: float, back: float) -> BoolArray:
        x = self.centers[:, 0]
        return np.asarray((x + self.radius > front) & (x - self.radius < back))

    def ceiling(self, front: float, back: float) -> float:
        """Return the lowest height of something above the spheres between two x."""
        here = self._between(front, back)
        return float((self.centers[here, 2] + self.radius[here]).max()) + self.headroom

    def sill(self, front: float, back: float) -> float:
        """Return the greatest height of something below the spheres between two x."""
        here = self._between(front, back)
        return float((self.centers[here, 2] - self.radius[here]).min()) - self.headroom


Range = tuple[float, float]


@dataclass(frozen=True)
class _Piece:
    """A piece of furniture in the frame of its goal.

    Attributes:
        parts: of it.
        front, back: x of the begin and the end of its opening.
    """

    parts: list[Obstacle]
    front: float
    back: float


def _box(x: Range, y: Range, z: Range) -> Obstacle:
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


def _bar(begin: Range, end: Range, height: float, half: float) -> Obstacle:
    """Return a level bar from one point (x, y) to another."""
    x, y = end[0] - begin[0], end[1] - begin[1]
    turn = float(np.arctan2(y, x)) / 2
    return Obstacle(
        shape="box",
        position=((begin[0] + end[0]) / 2, (begin[1] + end[1]) / 2, height),
        quaternion=(0.0, 0.0, float(np.sin(turn)), float(np.cos(turn))),
        size=(float(np.hypot(x, y)) / 2, half, half),
    )


def _mirrored(passage: Passage, low: float, high: float) -> tuple[Range, Range]:
    """Return the ranges of y at these distances from the opening's middle, right and left of it."""
    return (passage.middle - high, passage.middle - low), (
        passage.middle + low,
        passage.middle + high,
    )


def _extent(passage: Passage, rng: np.random.Generator) -> tuple[float, float, float]:
    """Return front, back and half width of a piece around the goal's body."""
    least = np.array([passage.half, passage.half, max(passage.half, passage.spread)])
    front, back, half = (least + rng.uniform(*_SETBACK, size=3)).tolist()
    return -front, back, half


def _shelf(passage: Passage, rng: np.random.Generator) -> _Piece:
    """Return stiles, side panels, back, two boards and a can on the lower of these."""
    front, back, half = _extent(passage, rng)
    thick = rng.uniform(*_PANEL)
    board = passage.ceiling(front - _STILE_DEPTH, back)
    top = board + thick + rng.uniform(*_UPPER_COMPARTMENT)
    radius, height = rng.uniform(0.02, 0.04), rng.uniform(0.08, 0.12)
    x, y = rng.uniform(front + radius, back - radius), rng.uniform(radius - half, half - radius)
    right, left = _mirrored(passage, half, half + thick)
    inner = right[1], left[0]
    parts = [
        *(
            _box((front - _STILE_DEPTH, front), y, (0.0, board))
            for y in _mirrored(passage, passage.opening / 2, half + thick)
        ),
        _box((front, back), right, (0.0, top)),
        _box((front, back), left, (0.0, top)),
        _box((back, back + thick), (right[0], left[1]), (0.0, top)),
        _box((front - _STILE_DEPTH, back), inner, (board, board + thick)),
        _box((front, back), inner, (top - thick, top)),
        _standing_cylinder(x, y + passage.middle, radius, board + thick, board + thick + height),
    ]
    return _Piece(parts, front - _STILE_DEPTH, front)


def _open_box(passage: Passage, rng: np.random.Generator) -> _Piece:
    """Return side walls, back, a lower front wall, a lid with a slot, and flaps beside the slot."""
    front, back, half = _extent(passage, rng)
    thick = rng.uniform(*_PANEL)
    lid = passage.inside + rng.uniform(*_LID)
    rim = min(passage.sill(front - thick, front), lid)
    right, left = _mirrored(passage, half, half + thick)
    flaps = _mirrored(passage, passage.opening / 2, passage.opening / 2 + thick)
    flap = max(passage.bottom + passage.rise * rng.uniform(*_FLAP), lid + 2 * thick)
    parts = [
        _box((front, back), right, (0.0, lid)),
        _box((front, back), left, (0.0, lid)),
        _box((back, back + thick), (right[0], left[1]), (0.0, lid)),
        *(
            _box((front, back + thick), y, (lid, lid + thick))
            for y in _mirrored(passage, passage.opening / 2, half + thick)
        ),
        *(_box((front, back + thick), y, (lid + thick, flap)) for y in flaps),
    ]
    if rim > _LEAST_RIM:
        parts.append(_box((front - thick, front), (right[0], left[1]), (0.0, rim)))
    # Hand and object reach a little beyond the goal's middle.
    return _Piece(parts, front, passage.reach)


def _cage(passage: Passage, rng: np.random.Generator) -> _Piece:
    """Return four posts, bars on both sides (two of them towards the start), one over the front."""
    front, back, half = _extent(passage, rng)
    radius = rng.uniform(*_POST_RADIUS)
    narrow = passage.opening / 2 + radius
    lintel = passage.ceiling(front - radius, front + radius) + radius
    near, far = passage.goal[2] + rng.uniform(*_BAR_HEIGHT, size=2)
    corners = {
        side: ((front, passage.middle + side * narrow), (back, passage.middle + side * half))
        for side in (-1, 1)
    }
    top = lintel + radius
    posts = [_standing_cylinder(*at, radius, 0.0, top) for ends in corners.values() for at in ends]
    parts = [
        *posts,
        _bar(*corners[passage.side], near, radius),
        _bar(*corners[passage.side], lintel, radius),
        _bar(*corners[-passage.side], far, radius),
        _bar(corners[-1][0], corners[1][0], lintel, radius),
    ]
    return _Piece(parts, front - radius, front + radius)


def _desk(passage: Passage, rng: np.random.Generator) -> _Piece:
    """Return a board on two pedestals in front and two legs behind, with objects on it."""
    front, back, half = _extent(passage, rng)
    depth, thick = rng.uniform(*_PEDESTAL_DEPTH), rng.uniform(*_PANEL)
    bottom = passage.ceiling(front - depth, back)
    top = bottom + thick
    (right, left), y = _mirrored(passage, passage.opening / 2, half), passage.middle
    parts = [
        _box((front - depth, back), (right[0], left[1]), (bottom, top)),
        _box((front - depth, front), right, (0.0, bottom)),
        _box((front - depth, front), left, (0.0, bottom)),
        *(
            _standing_cylinder(back - _LEG_RADIUS, at, _LEG_RADIUS, 0.0, bottom)
            for at in (right[0] + _LEG_RADIUS, left[1] - _LEG_RADIUS)
        ),
    ]
    # Side by side: each has its share of the width to stand on.
    share = 2 * half / _OBJECTS
    for number in range(_OBJECTS):
        width = min(rng.uniform(*_OBJECT_HALF_WIDTH), share / 2)
        high = top + 2 * rng.uniform(*_OBJECT_HALF_HEIGHT)
        first = y - half + number * share
        u = rng.uniform(front - depth + width, back - width)
        v = rng.uniform(first + width, first + share - width)
        if rng.uniform() < 0.5:
            parts.append(_standing_cylinder(u, v, width, top, high))
        else:
            parts.append(_box((u - width, u + width), (v - width, v + width), (top, high)))
    return _Piece(parts, front - depth, front)


_BUILDERS: dict[str, Callable[[Passage, np.random.Generator], _Piece]] = {
    "shelf": _shelf,
    "box": _open_box,
    "cage": _cage,
    "table": _desk,
}

FURNITURE = tuple(_BUILDERS)
"""Kinds of furniture."""


def draw_furniture(kind: str, passage: Passage, rng: np.random.Generator) -> tuple[Obstacle, ...]:
    """Return a piece of furniture of random size, at a random turn, around a goal.

    It is fitted to the middle of what moves: collisions that its turn brings are for the caller to
    find.

    Args:
        kind: one of `FURNITURE`.
        passage: what it is built for.
        rng: source of all randomness.
    """
    piece = _BUILDERS[kind](passage, rng)
    # The longer the opening, the less of a turn does it bear.
    pivot = (piece.front + piece.back) / 2
    limit = min(_LARGEST_TURN, 2 * passage.slack / (piece.back - piece.front))
    turn = rng.uniform(-limit, limit)
    x, y, _ = passage.goal
    bearing = float(np.arctan2(y, x))
    c, s = float(np.cos(bearing)), float(np.sin(bearing))
    a, b = float(np.cos(turn)), float(np.sin(turn))
    placed = []
    for part in piece.parts:
        u, v = part.position[0] - pivot, part.position[1] - passage.middle
        u, v = pivot + a * u - b * v, passage.middle + b * u + a * v
        _, _, sine, cosine = part.quaternion
        half = float(np.arctan2(sine, cosine)) + (bearing + turn) / 2
        placed.append(
            part.model_copy(
                update={
                    "position": (x + c * u - s * v, y + s * u + c * v, part.position[2]),
                    "quaternion": (0.0, 0.0, float(np.sin(half)), float(np.cos(half))),
                }
            )
        )
    return tuple(placed)
