"""Scenes of DrawS: strokes with obstacles on them.

With a witness: it follows the episode's stroke but for bumps, short stretches on which the pen is
led aside. Bump after bump is drawn, until obstacles are found that stand on the stroke there, leave
the witness its clearance, and cover the checkpoints that it misses there. Of these, and of others
beside the stroke, those are taken that block most other trajectories with bumps. The task's own
rule has the last word.

Without one, obstacles on and beside the stroke are taken that block most trajectories with bumps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray, IntArray
from smp_gym.robot import kinematics
from smp_gym.sampling import kernels
from smp_gym.sampling.choice import REPEATED, apart
from smp_gym.sampling.conversion import to_obstacle, to_row
from smp_gym.sampling.detours import resample
from smp_gym.sampling.draws import Draw, SceneSampler
from smp_gym.sampling.family import BLOCKING_DEPTH
from smp_gym.sampling.grid import Grid, near, rasterise
from smp_gym.sampling.moving_body import MovingBody
from smp_gym.sampling.specification import DifficultySpecification
from smp_gym.sampling.swept_path import SweptPath
from smp_gym.sampling.witness import is_witness, within_limits
from smp_gym.scene import SHAPES, TABLE, Goal
from smp_gym.tasks.draw_s import rules as draw_s
from smp_gym.tasks.draw_s.stroke_trajectories import (
    BUMP_HALF_WIDTH,
    PHASES,
    Stroke,
    drawing_body,
    lead_aside,
    sample_centers,
    sample_stroke,
    tip_path,
)

__all__ = ["SAMPLER", "SPECIFICATIONS"]

SPECIFICATIONS = {
    "none": DifficultySpecification(obstacles=0, on_table=0, clearance=0.0, free_share=1.0),
    "easy": DifficultySpecification(obstacles=4, on_table=0, clearance=0.030, free_share=1.0),
    "medium": DifficultySpecification(obstacles=8, on_table=0, clearance=0.015, free_share=1.0),
    "hard": DifficultySpecification(obstacles=12, on_table=0, clearance=0.010, free_share=1.0),
}
"""Number of obstacles on and beside a stroke, and the clearance of a witness, by difficulty."""

_HALF_EXTENTS = (0.03, 0.06)
_SHAPE_SHARES = (0.5, 0.3, 0.2)
"""Range of the half-extents of obstacles, m, and shares of `SHAPES`."""

_BASE_DISTANCE = 0.35
_START_CLEARANCE = 0.05
"""m, least distance of obstacles to the axis of the base, and to the robot at the start."""

_BUMPS = {"easy": 3, "medium": 4, "hard": 4}
"""Bumps of a witness, by difficulty: how often a trajectory has to leave the stroke."""

_COMPARED_SAMPLES = 32
_COMPARED_TRAJECTORIES = 64
"""Samples of the trajectories that obstacles are compared by, and number of these trajectories."""

_ON_STROKE = 48
_BESIDE = 96
_OFF_STROKE = (0.015, 0.08)
_LEAST_ENTRY = 0.025
"""Obstacles to choose from, at each bump on the stroke and beside it; the standard deviation of how
far the ones and the others stand off it (m), and how deep at least it enters the ones (m)."""

_END_DISTANCE = 0.085
"""Metres that obstacles keep from both ends of the stroke: neither is ever covered."""

_PASSED_DISTANCE = 0.9 * draw_s.CHECKPOINT_TOLERANCE
"""Metres: a checkpoint from which the witness stays farther must be covered."""

_LEAST_DEMANDED = 13
"""Checkpoints that must stay free at least."""

_SLACK = 0.005
"""Metres added to the clearance where only every other sample of a witness is looked at."""

_GLANCE = 10
"""Every so-many-th of these samples is looked at first."""

_MAX_BUMPS = 16
_MAX_WITNESSES = 12
"""Most attempts at a bump, and at a witness for a stroke."""


def _draw_rows(
    body: MovingBody,
    stroke: Stroke,
    phase: FloatArray,
    aside: FloatArray,
    spread: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Draw obstacles that are clear of start and end and of the table.

    Args:
        body: what moves.
        stroke: near which they stand.
        phase: (C,) where on the stroke.
        aside: (C, 3) unit vectors against which they are shifted, by up to their own size.
        spread: m, standard deviation of a shift besides.
        rng: source of all randomness.

    Returns:
        (M, 9) rows, M <= C.
    """
    count = len(phase)
    at = np.rint(phase * (len(stroke.line) - 1)).astype(np.int64)
    shape = rng.choice(len(_SHAPE_SHARES), size=count, p=_SHAPE_SHARES)
    size = rng.uniform(*_HALF_EXTENTS, size=(count, 3))
    box, ball = SHAPES.index("box"), SHAPES.index("sphere")
    size[shape != box, 1] = size[shape != box, 0]
    size[shape == ball, 2] = size[shape == ball, 0]
    yaw = rng.uniform(-np.pi, np.pi, size=count)
    away = aside * (rng.uniform(size=count) * size.min(axis=1))[:, None]
    position = stroke.line[at] - away + spread * rng.standard_normal((count, 3))
    rows = np.column_stack([shape, position, np.cos(yaw), np.sin(yaw), size])
    kept = np.hypot(position[:, 0], position[:, 1]) >= _BASE_DISTANCE
    kept &= position[:, 2] >= size[:, 2]
    rows = rows[kept]
    ends = kernels.point_distances(stroke.checkpoints[[0, -1]], rows)
    rows = rows[ends.min(axis=1) >= _END_DISTANCE]
    return rows[body.swept_path(stroke.trajectory[:1]).clear(rows, _START_CLEARANCE)]


def _draw_on_stroke(
    body: MovingBody, stroke: Stroke, center: float, aside: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Draw obstacles that a stroke enters near a phase; (C, 3) `aside` as in `_draw_rows`."""
    reach = 0.4 * BUMP_HALF_WIDTH[0]
    phase = center + rng.uniform(-reach, reach, len(aside))
    rows = _draw_rows(body, stroke, phase, aside, _OFF_STROKE[0], rng)
    line = SweptPath.of(stroke.line[::2, None], np.full(1, kinematics.PEN_RADIUS))
    return rows[line.clearances(rows, 1.0) <= -_LEAST_ENTRY]


def _draw_beside(
    body: MovingBody, stroke: Stroke, centers: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Draw obstacles anywhere near a stroke's places (B,) of bumps."""
    phase = rng.choice(centers, _BESIDE) + rng.uniform(-0.05, 0.05, _BESIDE)
    return _draw_rows(body, stroke, phase, np.zeros((_BESIDE, 3)), _OFF_STROKE[1], rng)


def _missed(stroke: Stroke, trajectory: FloatArray) -> BoolArray:
    """Return a mask (32,) of checkpoints that the pen misses on a trajectory (T, 6) rad."""
    points = np.zeros((len(stroke.checkpoints), kernels.OBSTACLE_COLUMNS))
    points[:, 0] = SHAPES.index("sphere")
    points[:, 1:4] = stroke.checkpoints
    tip = SweptPath.of(tip_path(trajectory), np.zeros(1))
    return np.asarray(tip.clearances(points, 1.0) > _PASSED_DISTANCE)


def _covered(stroke: Stroke, rows: FloatArray) -> BoolArray:
    """Return a mask (M, 32) of the checkpoints that obstacles cover."""
    distance = kernels.point_distances(stroke.checkpoints, rows)
    return np.asarray(distance < draw_s.COVERED_DISTANCE)


def _keeps_clear(
    body: MovingBody, trajectory: FloatArray, rows: FloatArray, enough: float
) -> BoolArray:
    """Return a mask (M,) of obstacles that every other sample of a trajectory clears."""
    return body.looks(trajectory[::2], _GLANCE).clear(rows, enough)


@dataclass(frozen=True, eq=False)
class _Bumpy:
    """A trajectory with bumps, (200, 6) rad, and (M, 9) obstacles that it avoids, (M,) whose bump.

    Obstacles beside the stroke belong to no bump, -1.
    """

    trajectory: FloatArray
    rows: FloatArray
    bump: IntArray


def _draw_bumpy(
    body: MovingBody, stroke: Stroke, bumps: int, enough: float, rng: np.random.Generator
) -> _Bumpy | None:
    """Draw a trajectory with bumps and obstacles at least `enough` metres off it; None if it fails.

    Each of its bumps has obstacles on the stroke that cover all checkpoints missed there.
    """
    centers = sample_centers(1, bumps, rng)[0]
    trajectory = stroke.trajectory
    rows = np.empty((0, kernels.OBSTACLE_COLUMNS))
    bump = np.empty(0, np.int64)
    for k, center in enumerate(centers):
        # Where later bumps will be, nothing is known yet.
        known = (np.abs(PHASES - centers[k + 1 :, None]) > BUMP_HALF_WIDTH[1]).all(axis=0)
        drawn = lead_aside(stroke, np.full((_MAX_BUMPS, 1), center), rng)
        trajectories = drawn.along(PHASES)
        for n in np.flatnonzero(within_limits(trajectory + trajectories)):
            added = trajectories[n]
            aside = np.tile(drawn.aside[n], (_ON_STROKE, 1))
            fresh = _draw_on_stroke(body, stroke, center, aside, rng)
            missed = _missed(stroke, stroke.trajectory + added)
            fresh = fresh[~(missed & ~_covered(stroke, fresh)).any(axis=1)]
            if not len(fresh):
                continue
            found = np.concatenate([rows, fresh])
            whose = np.concatenate([bump, np.full(len(fresh), k)])
            kept = _keeps_clear(body, (trajectory + added)[known], found, enough)
            found, whose = found[kept], whose[kept]
            if len(np.unique(whose)) == k + 1:
                trajectory, rows, bump = trajectory + added, found, whose
                break
        else:
            return None
    beside = _draw_beside(body, stroke, centers, rng)
    rows = np.concatenate([rows, beside])
    bump = np.concatenate([bump, np.full(len(beside), -1)])
    kept = _keeps_clear(body, trajectory, rows, enough)
    return _Bumpy(trajectory, rows[kept], bump[kept])


def _grid(body: MovingBody, stroke: Stroke, bumps: int, rng: np.random.Generator) -> Grid:
    """Return the grid of trajectories along a stroke, the first without bumps."""
    aside = lead_aside(stroke, sample_centers(_COMPARED_TRAJECTORIES - 1, bumps, rng), rng)
    trajectories = np.repeat(
        resample(stroke.trajectory[None], _COMPARED_SAMPLES), _COMPARED_TRAJECTORIES, axis=0
    )
    trajectories[1:] += aside.along(np.linspace(0.0, 1.0, _COMPARED_SAMPLES))
    return rasterise(body.paths(trajectories, body.swept), body.spheres.radius[body.swept])


def _choose(
    rows: FloatArray,
    bump: IntArray,
    blocks: BoolArray,
    covers: BoolArray,
    missed: BoolArray,
    bumps: int,
    count: int,
) -> list[int] | None:
    """Choose obstacles: one at each bump, then any; they shall cover what is missed and block most.

    Args:
        rows: (M, 9) to choose from.
        bump: (M,) at which bump each is on the stroke, or -1.
        blocks: (M, N), which trajectories each blocks.
        covers: (M, 32), which checkpoints each covers.
        missed: (32,), which checkpoints the chosen must cover.
        bumps: how many there are.
        count: how many to choose.

    Returns:
        Indices of the chosen; None if they cannot be found, or leave too few checkpoints.
    """
    chosen: list[int] = []
    together = apart(rows, rows)
    while len(chosen) < count:
        allowed = together[:, chosen].all(axis=1)
        if len(chosen) < bumps:
            allowed &= bump == len(chosen)
        hidden = covers[chosen].any(axis=0)
        allowed &= (covers | hidden).sum(axis=1) <= covers.shape[1] - _LEAST_DEMANDED
        weight = REPEATED ** blocks[chosen].sum(axis=0)
        # Coverage of what is missed counts most, then how many trajectories are blocked.
        worth = blocks.shape[1] * (covers & missed & ~hidden).sum(axis=1)
        worth = np.where(allowed, worth + (blocks * weight).sum(axis=1), -1.0)
        if not len(worth) or worth.max() < 0.0:
            return None
        chosen.append(int(np.argmax(worth)))
    return None if (missed & ~covers[chosen].any(axis=0)).any() else chosen


def _draw(difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw a stroke, a witness and obstacles; None if they do not fit together."""
    specification = SPECIFICATIONS[difficulty]
    body, stroke = drawing_body(), sample_stroke(rng)
    if stroke is None:
        return None
    bodies = np.array([to_row(TABLE)])
    if specification.obstacles == 0:
        none = np.empty((0, kernels.OBSTACLE_COLUMNS))
        if not is_witness(body, stroke.trajectory, bodies, none, 0.0):
            return None
        return _drawn(stroke, np.ones(len(stroke.checkpoints), np.bool_), none, stroke.trajectory)
    bumps = _BUMPS[difficulty]
    grid = None
    for _ in range(_MAX_WITNESSES):
        found = _draw_bumpy(body, stroke, bumps, specification.clearance + _SLACK, rng)
        if found is None:
            continue
        grid = _grid(body, stroke, bumps, rng) if grid is None else grid
        chosen = _choose(
            found.rows,
            found.bump,
            near(grid, found.rows, -BLOCKING_DEPTH, _COMPARED_TRAJECTORIES),
            _covered(stroke, found.rows),
            _missed(stroke, found.trajectory),
            bumps,
            specification.obstacles,
        )
        if chosen is None:
            continue
        rows = found.rows[chosen]
        hidden = draw_s.covered(stroke.checkpoints, [to_obstacle(row) for row in rows])
        trace = draw_s.equal_arc(tip_path(found.trajectory)[:, 0])
        passed = draw_s.passed_in_order(trace, stroke.checkpoints, 1.0 - hidden)
        if passed == len(hidden) and is_witness(
            body, found.trajectory, bodies, rows, specification.clearance
        ):
            return _drawn(stroke, ~hidden, rows, found.trajectory)
    return None


def _drawn(
    stroke: Stroke, demanded: BoolArray, rows: FloatArray, witness: FloatArray | None = None
) -> Draw:
    points = tuple((x, y, z) for x, y, z in stroke.checkpoints.tolist())
    goal = Goal(
        kind="stroke",
        position=points[-1],
        checkpoints=points,
        demanded=tuple(demanded.tolist()),
    )
    return Draw(stroke.trajectory[0], (goal,), rows, witness, manipulated=None)


def _place(difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw a stroke and obstacles that block most; None if too few of them do."""
    body, bumps, stroke = drawing_body(), _BUMPS[difficulty], sample_stroke(rng)
    if stroke is None:
        return None
    centers = sample_centers(1, bumps, rng)[0]
    nowhere = np.zeros((_ON_STROKE, 3))
    parts = [_draw_on_stroke(body, stroke, center, nowhere, rng) for center in centers]
    beside = _draw_beside(body, stroke, centers, rng)
    rows = np.concatenate([*parts, beside])
    numbers = [*range(bumps), -1]
    bump = np.repeat(numbers, [len(part) for part in (*parts, beside)])
    # Every trajectory ends where this one does.
    clear = body.swept_path(stroke.trajectory[-1:]).clear(rows, _START_CLEARANCE)
    rows, bump = rows[clear], bump[clear]
    blocks = near(_grid(body, stroke, bumps, rng), rows, -BLOCKING_DEPTH, _COMPARED_TRAJECTORIES)
    covers = _covered(stroke, rows)
    nothing = np.zeros(covers.shape[1], np.bool_)
    count = SPECIFICATIONS[difficulty].obstacles
    chosen = _choose(rows, bump, blocks, covers, nothing, bumps, count)
    if chosen is None:
        return None
    hidden = draw_s.covered(stroke.checkpoints, [to_obstacle(row) for row in rows[chosen]])
    return _drawn(stroke, ~hidden, rows[chosen])


SAMPLER = SceneSampler(_draw, _place)
