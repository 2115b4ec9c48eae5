"""Bodies of a workplace that stand, hang or lie across: posts, ducts, beams, boards, panels, lamps.

Each is a row of `smp_gym.sampling.kernels`. A post stands on the table, a duct hangs from above, a
panel does one or the other and is thin, beams and boards lie level, a lamp is a ball in the air. So
what is in the way may be below, above, beside or across, and no one height gets past all of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.scene import SHAPES

__all__ = ["CEILING", "draw_bodies", "draw_wall", "hanging", "shrunk", "standing", "vary_bodies"]

CEILING = 1.0
"""m, where what hangs begins: above all that the arm reaches in front of it."""

_KINDS = ("post", "duct", "standing panel", "hanging panel", "beam", "board", "lamp")
_SHARES = (0.2, 0.2, 0.15, 0.15, 0.12, 0.14, 0.04)
_ROUND_SHARE = 0.4
"""Shares of the kinds, and of posts and ducts that are cylinders."""

_POST = (0.03, 0.07)
_PANEL_THICKNESS = (0.010, 0.015)
_PANEL_WIDTH = (0.07, 0.25)
_BEAM_SECTION = (0.012, 0.03)
_BEAM_LENGTH = (0.15, 0.40)
_BOARD_WIDTH = (0.08, 0.22)
_LAMP = (0.04, 0.07)
"""Half-extents and radii, m."""

_WALL_BEHIND = (0.18, 0.22)
_WALL_TURN = 0.2
_WALL_HEIGHT = (0.75, 0.95)
_WALL_WIDTH = (0.30, 0.45)
"""Of the wall behind the arm: distance from the base's axis and height, m, its turn, rad, and its
half width, m."""

_PAST = (-0.01, 0.14)
"""m, how far posts and ducts reach past the point that they are drawn to cover."""

_LEAST_HEIGHT = 0.03
_SHIFT = 0.02
_GROWTH = 0.8
_LARGEST = (0.10, 0.40)
"""Least half height of a post or duct, standard deviation of a child's shift (m), by how much
of its size at most it is wider, and the half-extents up to which the smaller and the larger of its
sides grow (m)."""

_SHRINKING = 0.7
_LOWERING = 0.03
_SLIMMEST = 0.02
"""Factor of a body's width when it is made smaller, decrease of its height, and the half width that
it does not fall below (m)."""

_BOX, _CYLINDER, _BALL = (SHAPES.index(name) for name in ("box", "cylinder", "sphere"))


def standing(rows: FloatArray) -> BoolArray:
    """Return which bodies (C, 9) stand on the table, (C,)."""
    return np.asarray(rows[:, 3] == rows[:, 8])


def hanging(rows: FloatArray) -> BoolArray:
    """Return which bodies (C, 9) hang from above, (C,)."""
    return np.asarray(np.abs(rows[:, 3] + rows[:, 8] - CEILING) < 1e-9)


def draw_bodies(points: FloatArray, radius: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return (C, 9) rows of random bodies, each near or over one of the given spheres.

    Args:
        points: (C, 3) m, centres of the spheres.
        radius: (C,) m.
        rng: source of all randomness.
    """
    count = len(points)
    kind = rng.choice(len(_KINDS), size=count, p=_SHARES)

    def of(*names: str) -> BoolArray:
        return np.asarray(np.isin(kind, [_KINDS.index(name) for name in names]))

    def sizes(bounds: tuple[float, float]) -> NDArray[np.float64]:
        return rng.uniform(*bounds, size=count)

    panel, beam, lamp = of("standing panel", "hanging panel"), of("beam"), of("lamp")
    cylinder = of("post", "duct") & (rng.uniform(size=count) < _ROUND_SHARE)
    shape = np.where(lamp, _BALL, np.where(cylinder, _CYLINDER, _BOX))
    size = np.stack([sizes(_POST), sizes(_POST), sizes(_POST)], axis=1)
    size[panel, 0], size[panel, 1] = sizes(_PANEL_THICKNESS)[panel], sizes(_PANEL_WIDTH)[panel]
    section = sizes(_BEAM_SECTION)
    size[beam] = np.stack([sizes(_BEAM_LENGTH), section, section], axis=1)[beam]
    board = of("board")
    flat = np.stack([sizes(_BOARD_WIDTH), sizes(_BOARD_WIDTH), sizes(_PANEL_THICKNESS)], axis=1)
    size[board] = flat[board]
    size[lamp] = sizes(_LAMP)[lamp, None]
    size[cylinder, 1] = size[cylinder, 0]
    yaw = rng.uniform(-np.pi, np.pi, size=count)
    offset = rng.standard_normal((count, 3))
    offset *= rng.uniform(size=(count, 1)) / np.sqrt((offset**2).sum(axis=1, keepdims=True))
    position = points + offset * (radius + size.min(axis=1))[:, None]
    # A beam is met anywhere along it.
    along = rng.uniform(-0.7, 0.7, size=count) * np.where(beam, size[:, 0], 0.0)
    position[:, 0] += along * np.cos(yaw)
    position[:, 1] += along * np.sin(yaw)
    past = sizes(_PAST)
    rows = np.column_stack([shape, position, np.cos(yaw), np.sin(yaw), size])
    _reach_up(rows, of("post", "standing panel"), points[:, 2] + past)
    _reach_down(rows, of("duct", "hanging panel"), points[:, 2] - past)
    return rows


def draw_wall(rng: np.random.Generator) -> FloatArray:
    """Return the (1, 9) row of a wall close behind the arm.

    Without one the arm can fold up over its base, its elbow to the back, and pass every obstacle
    before it by the same detour.
    """
    yaw = rng.uniform(-_WALL_TURN, _WALL_TURN)
    behind, half = rng.uniform(*_WALL_BEHIND), rng.uniform(*_WALL_HEIGHT) / 2.0
    thickness, width = rng.uniform(*_PANEL_THICKNESS), rng.uniform(*_WALL_WIDTH)
    place = (-behind * np.cos(yaw), -behind * np.sin(yaw))
    return np.array([[_BOX, *place, half, np.cos(yaw), np.sin(yaw), thickness, width, half]])


def vary_bodies(rows: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Return (count, 9) rows of bodies like the given (C, 9), but shifted, turned and wider."""
    children = rows[rng.integers(max(1, len(rows)), size=count if len(rows) else 0)]
    stands, hangs = standing(children), hanging(children)
    top, bottom = children[:, 3] + children[:, 8], children[:, 3] - children[:, 8]
    shift = rng.normal(0.0, _SHIFT, (len(children), 3))
    children[:, 1:4] += shift
    wider = 1.0 + _GROWTH * rng.uniform(size=(len(children), 2))
    box = children[:, 0] == _BOX
    children[:, 6:8] = _grown(children[:, 6:8], wider)
    children[:, 7] = np.where(box, children[:, 7], children[:, 6])
    children[:, 8] = np.where(children[:, 0] == _BALL, children[:, 6], children[:, 8])
    turn = rng.normal(0.0, 0.3, len(children))
    cosine, sine = children[:, 4].copy(), children[:, 5].copy()
    children[:, 4] = cosine * np.cos(turn) - sine * np.sin(turn)
    children[:, 5] = sine * np.cos(turn) + cosine * np.sin(turn)
    _reach_up(children, stands, top + shift[:, 2])
    _reach_down(children, hangs, bottom + shift[:, 2])
    return children


def shrunk(rows: FloatArray) -> FloatArray:
    """Return bodies (C, 9) like the given, but slimmer, and less high or less deep."""
    rows = rows.copy()
    stands, hangs = standing(rows), hanging(rows)
    top, bottom = rows[:, 3] + rows[:, 8], rows[:, 3] - rows[:, 8]
    rows[:, 6:8] = np.maximum(_SHRINKING * rows[:, 6:8], np.minimum(rows[:, 6:8], _SLIMMEST))
    rows[:, 8] = np.where(rows[:, 0] == _BALL, rows[:, 6], rows[:, 8])
    _reach_up(rows, stands, top - _LOWERING)
    _reach_down(rows, hangs, bottom + _LOWERING)
    return rows


def _grown(sides: FloatArray, factor: FloatArray) -> FloatArray:
    """Return half-extents (C, 2) m times factors (C, 2), thin sides thin and none too large."""
    thin = sides < 2.0 * _PANEL_THICKNESS[1]
    largest = np.where(sides > _LARGEST[0], _LARGEST[1], np.maximum(sides, _LARGEST[0]))
    return np.where(thin, sides, np.minimum(sides * factor, largest))


def _reach_up(rows: FloatArray, which: BoolArray, top: FloatArray) -> None:
    """Make bodies stand on the table and end at a height (C,) m."""
    half = np.clip(top / 2.0, _LEAST_HEIGHT, CEILING / 2.0)
    rows[which, 8] = half[which]
    rows[which, 3] = half[which]


def _reach_down(rows: FloatArray, which: BoolArray, bottom: FloatArray) -> None:
    """Make bodies hang from above and end at a height (C,) m."""
    half = np.clip((CEILING - bottom) / 2.0, _LEAST_HEIGHT, CEILING / 2.0 - 0.01)
    rows[which, 8] = half[which]
    rows[which, 3] = CEILING - half[which]
