"""Standing obstacles of which one or two are shifted in mid-episode, and a witness in time.

Scene and witness are those of a family without displacements. Then shifts are drawn, of single
obstacles by a few centimetres within half a second, towards where trajectories that were clear of
everything will pass; those are taken that block most of these trajectories. One that stays clear,
executed at once, is the new witness.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray, IntArray
from smp_gym.control import execution_time
from smp_gym.observation import CONTROL_PERIOD
from smp_gym.sampling.bodies import hanging, standing
from smp_gym.sampling.choice import apart
from smp_gym.sampling.detours import detour_basis, detours
from smp_gym.sampling.draws import Draw
from smp_gym.sampling.family import BLOCKING_DEPTH
from smp_gym.sampling.in_time import TICKS, clears_in_time, held_on, ticks_of
from smp_gym.sampling.moving import (
    Movement,
    stays_off,
    transfer_movement,
    witness_in_time,
)
from smp_gym.sampling.specification import SPECIFICATIONS
from smp_gym.sampling.transfer import Query
from smp_gym.sampling.witness import WITNESS_SAMPLES
from smp_gym.scene import Motion

__all__ = ["NARROW", "SHIFTS", "SHIFT_TIME", "displace", "displaced"]

SHIFTS = {"easy": (0.03, 0.04), "medium": (0.04, 0.05), "hard": (0.05, 0.06)}
"""m, by how much obstacles are shifted, by difficulty."""

NARROW = "hard"
"""Difficulty of the scenes whose obstacles are shifted: what leaves more room than the obstacles
are shifted by is not blocked by them."""

SHIFT_TIME = 0.5
"""s, in which an obstacle is shifted."""

_MOMENTS = (0.2, 0.6)
"""When a shift begins, as a share of the first witness's duration."""

_CANDIDATES = 200
_CHOICES = 20
"""Numbers of shifts drawn, and of choices for which a witness is looked for."""

_LEAST_BLOCKED = {"easy": 0.2, "medium": 0.3, "hard": 0.4}
"""Share of the trajectories that kept the clearance, and that the shifts must block."""

_BESIDE = 160
_BESIDE_WIDTH = (0.1, 0.8)
"""Number of trajectories beside the first witness, itself included, and their distance from it in
units of a detour: few others are clear, where obstacles enclose it."""

_KEPT = 0.9
"""Share of the clearance of scenes without displacements that the new witness must have."""

_TOUCHING = 0.0
_DIRECTION_NOISE = 0.3
"""m, clearance of a trajectory that is blocked; standard deviation of each component of a unit
vector by which a shift misses what it is directed at."""


def _tracks(positions: FloatArray, shifts: FloatArray, begin: FloatArray) -> FloatArray:
    """Return (C, TICKS, 3) m: (C, 3) positions, shifted by (C, 3) from (C,) s on."""
    time = np.arange(TICKS) * CONTROL_PERIOD
    s = np.clip((time - begin[:, None]) / SHIFT_TIME, 0.0, 1.0)[..., None]
    tracks: FloatArray = positions[:, None] + s * s * (3.0 - 2.0 * s) * shifts[:, None]
    return tracks


def _draw_shifts(
    movement: Movement,
    rows: FloatArray,
    clear: IntArray,
    difficulty: str,
    duration: float,
    rng: np.random.Generator,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return which obstacles are shifted (C,), by what (C, 3) m, and from when on (C,) s."""
    which = rng.integers(len(rows), size=_CANDIDATES)
    begin = np.round(duration * rng.uniform(*_MOMENTS, size=_CANDIDATES), 2)
    shifts = rng.standard_normal((_CANDIDATES, 3)) * _DIRECTION_NOISE
    targets = clear[rng.integers(len(clear), size=_CANDIDATES)]
    for c, (obstacle, target) in enumerate(zip(which, targets, strict=True)):
        ahead = movement.times[target] > begin[c] + SHIFT_TIME
        centers = movement.paths[target][ahead][:, movement.hand].reshape(-1, 3)
        if len(centers):
            towards = centers - rows[obstacle, 1:4]
            distance = np.sqrt((towards**2).sum(axis=1))
            nearest = int(distance.argmin())
            shifts[c] += towards[nearest] / distance[nearest]
    shifts[(standing(rows) | hanging(rows))[which], 2] = 0.0
    length = rng.uniform(*SHIFTS[difficulty], size=_CANDIDATES)
    shifts *= (length / np.sqrt((shifts**2).sum(axis=1)))[:, None]
    return which, shifts, begin


def displace(
    movement: Movement, drawn: Draw, duration: float, difficulty: str, rng: np.random.Generator
) -> Draw | None:
    """Shift one or two obstacles of a draw in mid-episode; None if they do not fit together.

    Args:
        movement: of the draw's goals, its witness among the members.
        drawn: standing obstacles, and a witness.
        duration: s, of the witness.
        difficulty: says how far obstacles are shifted, see `SHIFTS`.
        rng: source of all randomness.
    """
    rows, clearance = drawn.rows, _KEPT * SPECIFICATIONS[NARROW].clearance
    still = np.repeat(rows[:, None, 1:4], TICKS, axis=1)
    paths, ticks = held_on(movement.paths), ticks_of(movement.times)

    def clears(rows: FloatArray, tracks: FloatArray, distance: float = _TOUCHING) -> BoolArray:
        kept: BoolArray = clears_in_time(
            paths[clear], movement.radius, ticks[clear], 0, rows, tracks, distance
        )
        return kept

    clear = np.flatnonzero(movement.able)
    clear = clear[clears(rows, still).all(axis=0)]
    if not len(clear):
        return None
    which, shifts, begin = _draw_shifts(movement, rows, clear, difficulty, duration, rng)
    tracks = _tracks(rows[which, 1:4], shifts, begin)
    kept = stays_off(movement, rows[which], tracks)
    shifted = rows[which]
    shifted[:, 1:4] += shifts
    beside = apart(shifted, rows)
    beside[np.arange(len(which)), which] = True
    kept &= beside.all(axis=1)
    which, shifted, begin, tracks = which[kept], shifted[kept], begin[kept], tracks[kept]
    pairs = apart(shifted, shifted) & (which[:, None] != which)
    tracks = np.ascontiguousarray(tracks)
    # Members too near to an obstacle where it is, and to one that is shifted.
    close, closed = ~clears(rows, still, clearance), ~clears(rows[which], tracks, clearance)
    counts, one = close.sum(axis=0), close[which].astype(np.int64)
    blocks = ~clears(rows[which], tracks, -BLOCKING_DEPTH)[:, counts == 0]
    share = blocks.mean(axis=1)
    a, b = np.nonzero(np.triu(pairs))
    left = (~closed & (counts == one)).any(axis=1)
    choices: list[tuple[float, tuple[int, ...]]] = [
        (share[c], (int(c),)) for c in np.flatnonzero(left)
    ]
    left = (~closed[a] & ~closed[b] & (counts == one[a] + one[b])).any(axis=1)
    a, b = a[left], b[left]
    choices += zip((blocks[a] | blocks[b]).mean(axis=1), zip(a, b, strict=True), strict=True)
    # What blocks all of them would hardly leave a witness: a wait helps little against a shift.
    least = _LEAST_BLOCKED[difficulty]
    choices = [choice for choice in choices if least <= choice[0] < 1.0]
    choices.sort(key=lambda choice: -choice[0])
    for _, choice in choices[:_CHOICES]:
        chosen = list(choice)
        stand = np.delete(rows, which[chosen], axis=0)
        witness = witness_in_time(
            _among(movement, clear, stand, clearance),
            rows[which[chosen]],
            tracks[chosen],
            clearance,
            delays=(0.0,),
        )
        if witness is not None:
            motions: list[Motion | None] = [None] * len(rows)
            for c in chosen:
                motions[which[c]] = _motion(rows[which[c], 1:4], shifted[c, 1:4], float(begin[c]))
            return replace(drawn, witness=witness, motions=tuple(motions))
    return None


def _among(movement: Movement, clear: IntArray, rows: FloatArray, clearance: float) -> Movement:
    """Return a movement of which only members (K,) may be witness, if they clear (M, 9) rows."""
    able = np.zeros(len(movement.able), np.bool_)
    able[clear] = True

    def holds(trajectory: FloatArray) -> bool:
        clear = movement.body.swept_path(trajectory).clear(rows, clearance).all()
        return bool(clear) and movement.holds(trajectory)

    return replace(movement, able=able, holds=holds)


def _motion(here: FloatArray, there: FloatArray, begin: float) -> Motion:
    """Return the motion of an obstacle that is shifted from a time (s) on."""
    points = [tuple(point.tolist()) for point in (here, here, there)]
    return Motion(times=(0.0, begin, begin + SHIFT_TIME), points=tuple(points))


def displaced(
    query: Query, drawn: Draw | None, difficulty: str, rng: np.random.Generator
) -> Draw | None:
    """Shift obstacles of what was drawn around a transfer; None if they do not fit together.

    Args:
        query: which transfer to which goal.
        drawn: obstacles and witness of the query; None if nothing was found.
        difficulty: says how far obstacles are shifted.
        rng: source of all randomness.
    """
    if drawn is None or drawn.witness is None:
        return None
    beside = rng.standard_normal((_BESIDE, *detour_basis(WITNESS_SAMPLES).shape[1:], 6))
    beside *= rng.uniform(*_BESIDE_WIDTH, size=(_BESIDE, 1, 1))
    beside[0] = 0.0
    movement = transfer_movement(query, rng, drawn.witness + detours(beside, WITNESS_SAMPLES))
    return displace(movement, drawn, execution_time(drawn.witness), difficulty, rng)
