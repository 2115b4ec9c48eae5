"""Scene sampling of DrawS: strokes with obstacles on them, and a way round that solves the scene.

The witness is drawn first: it follows the episode's stroke but for bumps, short stretches on which
the pen is led aside. Each bump then gets an obstacle, which stands on the stroke, leaves the
witness its clearance, and covers those checkpoints that the witness misses there; any further
obstacle stands where it blocks most other ways with bumps. The task's own rule has the last word.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym import kinematics
from smp_gym.demonstrations import Demonstrations
from smp_gym.kinematics import PEN_TIP
from smp_gym.sampling import kernels
from smp_gym.sampling.body import Body
from smp_gym.sampling.choice import REPEATED, apart
from smp_gym.sampling.conversion import to_configuration, to_obstacle, to_row
from smp_gym.sampling.detours import resample, smoothstep
from smp_gym.sampling.family import BLOCKING_DEPTH
from smp_gym.sampling.grid import near, rasterise
from smp_gym.sampling.obstacles import (
    BASE_DISTANCE,
    HALF_EXTENTS,
    SHAPE_SHARES,
    START_CLEARANCE,
)
from smp_gym.sampling.specification import DifficultySpecification
from smp_gym.sampling.witness import is_witness, within_limits
from smp_gym.scene import SHAPES, TABLE, Goal, Obstacle, Scene
from smp_gym.strokes import follow, moved, pen_path
from smp_gym.tasks import draw_s

__all__ = ["END_SHIFT", "SCALE", "START_SHIFT", "YAW", "sample"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

END_SHIFT = (0.05, 0.06, 0.03)
"""Metres, largest shift of the stroke's end from where it was demonstrated, along x, y and z."""

SCALE = (0.85, 1.15)
"""Size of the S, the demonstrated being 1."""

YAW = 0.3
"""Rad, largest turn of the S about the vertical through its end, either way."""

START_SHIFT = 0.02
"""Metres, how far from the beginning of the stroke the pen may start, at most."""

_START_BLEND = 0.15
"""Share of the phase in which a movement joins the stroke."""

_SAMPLES = 32
_WITNESS_SAMPLES = 200
_FAMILY = 64
"""Samples of the ways that obstacles are compared by, and of the witness; number of these ways."""

_BUMPS = {"easy": 2, "medium": 3, "hard": 3}
"""Bumps of a witness by difficulty."""

_BUMP_REGION = (0.2, 0.8)
_BUMP_HALF_WIDTH = (0.10, 0.15)
_BUMP_SPACING = 0.2
_BUMP_HEIGHT = (0.13, 0.22)
_BUMP_TURN = 0.08
"""Phases between which bumps lie, their half widths and least distance (phase); how far the pen is
led aside (m), and the standard deviation of what the joints do besides (rad)."""

_FORWARD = 0.2
"""Largest share of a bump's direction that may point forwards: the hand follows the pen."""

_CANDIDATES = 240
_ON_STROKE = 0.6
_BESIDE = (0.015, 0.08)
_DEPTH = 0.015
"""Obstacles to choose from, the share of them that stand on the stroke, the standard deviation of
how far these and the others stand off it (m), and how deep at least the stroke enters these (m)."""

_END_DISTANCE = 0.085
"""Metres that obstacles keep from both ends of the stroke: neither is ever covered."""

_PASSED_DISTANCE = 0.9 * draw_s.CHECKPOINT_TOLERANCE
"""Metres: a checkpoint from which the witness stays farther must be covered."""

_LEAST_DEMANDED = 13
"""Checkpoints that must stay free at least."""

_MAX_ERROR = 1e-4
_MAX_WITNESSES = 40
_MAX_DRAWS = 100


@functools.lru_cache(maxsize=1)
def _body() -> Body:
    demonstrations = Demonstrations.load("DrawS")
    parts = (
        kinematics.arm_spheres(),
        kinematics.finger_spheres(demonstrations.metadata["finger_angles"]),
        kinematics.pen_spheres(),
    )
    spheres = kinematics.concatenate(*parts)
    moving = np.flatnonzero(spheres.link >= 2)
    fingers = np.arange(len(parts[0]), len(parts[0]) + len(parts[1]))
    return Body(
        demonstrations=demonstrations.configurations,
        spheres=spheres,
        moving=moving,
        swept=np.setdiff1d(moving, fingers),
        pairs=kinematics.self_collision_pairs(spheres),
    )


@functools.lru_cache(maxsize=1)
def _template() -> tuple[FloatArray, FloatArray]:
    """Return the mean stroke (200, 3) m and configurations (200, 6) rad that draw it."""
    q = _body().demonstrations
    points = pen_path(q).mean(axis=0)
    return points, q.mean(axis=0)


def _clipped_step(phase: FloatArray) -> FloatArray:
    return smoothstep(np.clip(phase, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class _Stroke:
    """One episode's stroke, and the way of the arm along it.

    Attributes:
        checkpoints: (32, 3) m.
        line: (200, 3) m.
        way: (200, 6) rad, from the episode's start.
        jacobian: (200, 3, 6) m/rad, of the pen's tip on the way.
        pointing: (200, 3) unit vectors along the pen.
    """

    checkpoints: FloatArray
    line: FloatArray
    way: FloatArray
    jacobian: FloatArray
    pointing: FloatArray


def _draw_stroke(rng: np.random.Generator) -> _Stroke | None:
    """Draw a stroke and the way of the arm along it; None if it is out of reach."""
    points, posture = _template()
    end = points[-1] + rng.uniform(-1.0, 1.0, 3) * END_SHIFT
    yaw = float(rng.uniform(-YAW, YAW))
    line = moved(points, end.tolist(), float(rng.uniform(*SCALE)), yaw)
    near = posture.copy()
    # The first joint turns clockwise.
    near[:, 0] -= np.arctan2(line[:, 1], line[:, 0]) - np.arctan2(points[:, 1], points[:, 0])
    way, error = follow(line, near)
    demonstrations = _body().demonstrations
    shift = rng.standard_normal(3)
    shift *= rng.uniform(0.0, START_SHIFT) / np.linalg.norm(shift)
    first = demonstrations[rng.integers(len(demonstrations)), 0] + (near - posture)[0]
    start, off = follow((line[0] + shift)[None], first[None])
    if max(error, off) > _MAX_ERROR:
        return None
    join = 1.0 - _clipped_step(np.linspace(0.0, 1.0, len(way)) / _START_BLEND)
    way = way + join[:, None] * (start[0] - way[0])
    links = kinematics.link_transforms(way)
    pose = links[:, -1] @ kinematics.END_EFFECTOR
    tip = pose[:, :3, :3] @ PEN_TIP + pose[:, :3, 3]
    arms = tip[:, None] - links[:, 1:, :3, 3]
    jacobian = np.swapaxes(np.cross(links[:, 1:, :3, 2], arms), 1, 2)
    return _Stroke(draw_s.equal_arc(line), line, way, jacobian, pose[:, :3, 0])


def _bumpy(stroke: _Stroke, count: int, bumps: int, rng: np.random.Generator) -> _Bumps:
    """Draw the bumps of `count` ways."""
    shape = (count, bumps)
    first, last = _BUMP_REGION
    center = np.sort(rng.uniform(0.0, last - first - (bumps - 1) * _BUMP_SPACING, shape), axis=1)
    center += first + _BUMP_SPACING * np.arange(bumps)
    half_width = rng.uniform(*_BUMP_HALF_WIDTH, shape)
    at = np.rint(center * (len(stroke.way) - 1)).astype(np.int64)
    forward = stroke.pointing[at]
    aside = rng.standard_normal((*shape, 3))
    aside /= np.linalg.norm(aside, axis=-1, keepdims=True)
    along = (aside * forward).sum(axis=-1, keepdims=True)
    aside -= np.maximum(along - _FORWARD, 0.0) * forward
    height = rng.uniform(*_BUMP_HEIGHT, (*shape, 1))
    jacobian = stroke.jacobian[at]
    gram = jacobian @ np.swapaxes(jacobian, -1, -2) + 1e-3 * np.eye(3)
    solved = np.linalg.solve(gram, (height * aside)[..., None])
    top = np.einsum("nbij,nbi->nbj", jacobian, solved[..., 0])
    top += rng.normal(0.0, _BUMP_TURN, top.shape)
    return _Bumps(center, half_width, aside, top)


@dataclass(frozen=True, eq=False)
class _Bumps:
    """Bumps of N ways: (N, B) centre and half width in phase, (N, B, 3) direction, (N, B, 6) top.

    The top is what the joints add in the middle of a bump, rad.
    """

    center: FloatArray
    half_width: FloatArray
    aside: FloatArray
    top: FloatArray

    def along(self, phase: FloatArray) -> FloatArray:
        """Return (N, T, 6) rad, what the bumps add at phases (T,)."""
        part = (phase - self.center[..., None]) / self.half_width[..., None]
        shape = np.maximum(1.0 - part**2, 0.0) ** 3
        return np.einsum("nbt,nbj->ntj", shape, self.top)


def _draw_candidates(
    body: Body, stroke: _Stroke, bumps: _Bumps, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return rows of obstacles, and under which of a witness's bumps each is on the stroke, or -1.

    They are clear of start and end and of the table.
    """
    count = _CANDIDATES
    bump = rng.integers(bumps.center.shape[1], size=count)
    phase = bumps.center[0, bump] + 0.4 * bumps.half_width[0, bump] * rng.uniform(-1, 1, count)
    at = np.rint(phase * (len(stroke.line) - 1)).astype(np.int64)
    shape = rng.choice(len(SHAPES), size=count, p=SHAPE_SHARES)
    size = rng.uniform(*HALF_EXTENTS, size=(count, 3))
    box, ball = SHAPES.index("box"), SHAPES.index("sphere")
    size[shape != box, 1] = size[shape != box, 0]
    size[shape == ball, 2] = size[shape == ball, 0]
    yaw = rng.uniform(-np.pi, np.pi, size=count)
    away = -bumps.aside[0, bump] * (rng.uniform(size=count) * size.min(axis=1))[:, None]
    beside = rng.uniform(size=count) >= _ON_STROKE
    spread = np.where(beside, _BESIDE[1], _BESIDE[0])[:, None]
    position = stroke.line[at] + away + spread * rng.standard_normal((count, 3))
    rows = np.column_stack([shape, position, np.cos(yaw), np.sin(yaw), size])
    kept = np.hypot(position[:, 0], position[:, 1]) >= BASE_DISTANCE
    kept &= position[:, 2] >= size[:, 2]
    ends = stroke.checkpoints[[0, -1]][None]
    kept &= kernels.path_clearances(ends, np.zeros(2), rows, 1.0) >= _END_DISTANCE
    start = body.paths(stroke.way[:1])
    clear = kernels.path_clearances(start, body.spheres.radius, rows, 1.0)
    kept &= clear >= START_CLEARANCE
    rows, bump, beside = rows[kept], bump[kept], beside[kept]
    line, thin = stroke.line[::2, None], np.full(1, kinematics.PEN_RADIUS)
    crossed = kernels.path_clearances(line, thin, rows, 1.0) <= -_DEPTH
    bump[beside] = -1
    return rows[crossed | beside], bump[crossed | beside]


@dataclass(frozen=True, eq=False)
class _Draw:
    """One draw: stroke, which checkpoints are demanded, (M, 9) obstacles, (200, 6) witness."""

    stroke: _Stroke
    demanded: BoolArray
    rows: FloatArray
    witness: FloatArray


def _draw(
    specification: DifficultySpecification, difficulty: str, rng: np.random.Generator
) -> _Draw | None:
    """Draw a stroke, a witness and obstacles; None if they do not fit together."""
    body = _body()
    stroke = _draw_stroke(rng)
    if stroke is None or not within_limits(stroke.way):
        return None
    bodies = np.array([to_row(TABLE)])
    if specification.obstacles == 0:
        none = np.empty((0, kernels.OBSTACLE_COLUMNS))
        if not is_witness(body, stroke.way, bodies, none, 0.0):
            return None
        return _Draw(stroke, np.ones(len(stroke.checkpoints), np.bool_), none, stroke.way)
    number = _BUMPS[difficulty]
    phase = np.linspace(0.0, 1.0, _SAMPLES)
    ways = resample(stroke.way[None], _SAMPLES) + np.concatenate(
        [np.zeros((1, _SAMPLES, 6)), _bumpy(stroke, _FAMILY - 1, number, rng).along(phase)]
    )
    paths = body.paths(ways, body.swept)
    radius = body.spheres.radius[body.swept]
    grid = rasterise(paths, radius)
    for _ in range(_MAX_WITNESSES):
        bumps = _bumpy(stroke, 1, number, rng)
        witness = stroke.way + bumps.along(np.linspace(0.0, 1.0, _WITNESS_SAMPLES))[0]
        if not within_limits(witness):
            continue
        rows, bump = _draw_candidates(body, stroke, bumps, rng)
        way = body.paths(witness[::2])
        enough = specification.clearance + 0.005
        # A glance at few samples spares the close look at most.
        for part in (way[::10], way):
            clear = kernels.path_clearances(part, body.spheres.radius, rows, enough)
            rows, bump = rows[clear >= enough], bump[clear >= enough]
        blocks = near(grid, rows, -BLOCKING_DEPTH, _FAMILY)
        chosen = _choose(stroke, witness, rows, bump, blocks, number, specification.obstacles)
        if chosen is None:
            continue
        obstacles = [to_obstacle(row) for row in rows[chosen]]
        hidden = draw_s.covered(stroke.checkpoints, obstacles)
        trace = draw_s.equal_arc(pen_path(witness))
        passed = draw_s.passed_in_order(trace, stroke.checkpoints, 1.0 - hidden)
        enough_left = hidden.sum() <= len(hidden) - _LEAST_DEMANDED
        if (
            enough_left
            and passed == len(hidden)
            and is_witness(body, witness, bodies, rows[chosen], specification.clearance)
        ):
            return _Draw(stroke, ~hidden, rows[chosen], witness)
    return None


def _covered(stroke: _Stroke, rows: FloatArray) -> BoolArray:
    """Return (M, 32), which checkpoints each obstacle covers."""
    point = np.zeros(1)
    distances = [
        kernels.path_clearances(checkpoint[None, None], point, rows, 1.0)
        for checkpoint in stroke.checkpoints
    ]
    covers: BoolArray = np.stack(distances, axis=1) < draw_s.COVERED_DISTANCE
    return covers


def _choose(
    stroke: _Stroke,
    witness: FloatArray,
    rows: FloatArray,
    bump: NDArray[np.int64],
    blocks: BoolArray,
    bumps: int,
    count: int,
) -> list[int] | None:
    """Return which obstacles to take: under each bump one that covers what is missed, then more."""
    trace = pen_path(witness)
    offset = np.linalg.norm(trace[:, None] - stroke.checkpoints, axis=-1).min(axis=0)
    missed = offset > _PASSED_DISTANCE
    covers = _covered(stroke, rows)
    # Coverage of what is missed counts most, then how many ways are blocked.
    chosen: list[int] = []
    beside = apart(rows, rows)
    while len(chosen) < count:
        allowed = beside[:, chosen].all(axis=1)
        if len(chosen) < bumps:
            allowed &= bump == len(chosen)
        left = missed & ~covers[chosen].any(axis=0)
        weight = REPEATED ** blocks[chosen].sum(axis=0)
        worth = _FAMILY * (covers & left).sum(axis=1) + (blocks * weight).sum(axis=1)
        worth[~allowed] = -1.0
        if not len(worth) or worth.max() < 0.0:
            return None
        chosen.append(int(np.argmax(worth)))
    if (missed & ~covers[chosen].any(axis=0)).any():
        return None
    return chosen


def sample(
    specification: DifficultySpecification,
    rng: np.random.Generator,
    difficulty: str,
    seed: int,
    version: int,
) -> tuple[Scene, FloatArray]:
    """Return a scene of DrawS and its witness; see `scenes.sample_with_witness`."""
    for _ in range(_MAX_DRAWS):
        drawn = _draw(specification, difficulty, rng)
        if drawn is not None:
            break
    else:
        raise RuntimeError(f"no solvable scene found for DrawS, {difficulty}, seed {seed}")
    points = tuple((x, y, z) for x, y, z in drawn.stroke.checkpoints.tolist())
    obstacles: tuple[Obstacle, ...] = tuple(to_obstacle(row) for row in drawn.rows)
    scene = Scene(
        task="DrawS",
        version=version,
        difficulty=difficulty,  # type: ignore[arg-type]
        seed=seed,
        start=to_configuration(drawn.stroke.way[0]),
        goals=(
            Goal(
                kind="stroke",
                position=points[-1],
                checkpoints=points,
                demanded=tuple(drawn.demanded.tolist()),
            ),
        ),
        obstacles=obstacles,
    )
    return scene, drawn.witness
