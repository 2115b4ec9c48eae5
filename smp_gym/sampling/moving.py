"""Bodies that move across the demonstrated movement, and a witness in time that gets by.

A body follows a smooth closed curve at constant speed for the whole episode. Curves are drawn
through points that the hand passes, so that the body is there when the hand is. Of many, one or two
are taken that together block the mean and most of what a primitive would propose, executed from the
first moment on, and still leave a member of the family clear, executed at once or after a wait.
That member, checked densely in time with the wait before it, is the witness.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.control import execution_time, execution_times
from smp_gym.observation import CONTROL_PERIOD, MAX_EPISODE_STEPS
from smp_gym.sampling import kernels
from smp_gym.sampling.bodies import draw_bodies, hanging, standing
from smp_gym.sampling.choice import widths
from smp_gym.sampling.conversion import fixture_rows, to_solid_row
from smp_gym.sampling.detours import resample
from smp_gym.sampling.draws import Draw
from smp_gym.sampling.family import BLOCKING_DEPTH, draw_family, members
from smp_gym.sampling.in_time import (
    TICKS,
    Timing,
    clears_in_time,
    delayed,
    held_on,
    ticks_of,
)
from smp_gym.sampling.moving_body import MovingBody
from smp_gym.sampling.obstacles import BASE_DISTANCE, START_CLEARANCE
from smp_gym.sampling.transfer import Query
from smp_gym.sampling.witness import WITNESS_SAMPLES, is_witness, within_limits
from smp_gym.scene import Goal, Motion, goal_boxes

__all__ = [
    "SPEEDS",
    "Movement",
    "among_moving",
    "cross",
    "stay_apart",
    "stays_off",
    "transfer_movement",
    "witness_in_time",
]

SPEEDS = {"easy": 0.05, "medium": 0.10, "hard": 0.20}
"""m/s of moving obstacles, by difficulty."""

CLEARANCE = 0.04
"""m, what moving obstacles leave between themselves and the witness's spheres: the arm follows its
reference a little late."""

_KNOT_SPACING = 0.05
"""m, of the knots along a path."""

_SPEED_TOLERANCE = 0.08
"""Largest relative deviation of the speed along a path: what turns more sharply is thrown away."""

_RADIUS = (0.10, 0.22)
_HEIGHT = 0.4
_SECOND = 0.4
"""Of curves: radius (m) of the first harmonic, the vertical share of it, and the share of the
second harmonic in the first."""

_CANDIDATES = 300
_BEST = 48
_CHOICES = 6
"""Numbers of bodies drawn with their paths, of those that are compared in pairs, and of choices for
which a witness is looked for."""

_FREE_SHARE = 0.2
"""Share of the proposals that may get by if executed at once."""

_DELAYS = tuple(0.5 * step for step in range(17))
"""s, waits before the witness."""

_MEMBERS = 12
"""Members that are checked densely after each wait."""

_GOAL_CLEARANCE = 0.02
_TABLE_CLEARANCE = 0.01
_HIGHEST = 1.0
"""m: what bodies leave between themselves and goals' bodies and table, and how high they move."""

_MEMBER_SAMPLES = 40

_NO_ROWS = np.empty((0, kernels.OBSTACLE_COLUMNS))
_NO_TRAJECTORIES = np.empty((0, WITNESS_SAMPLES, 6))


@dataclass(frozen=True, eq=False)
class Movement:
    """Trajectories from one start to one goal, and when they pass where.

    Attributes:
        body: what moves.
        goals: whose bodies obstacles keep off.
        paths: (N, T, S, 3) m, centres of spheres of the trajectories, the first being the mean's.
        radius: (S,) m.
        hand: index of the spheres that obstacles are drawn against.
        times: (N, T) s, from the beginning of the movement.
        proposed: (N,) which of them a primitive would propose and nothing else blocks.
        able: (N,) which may serve as witness.
        trajectory: returns member n, (W, 6) rad.
        timing: returns when the samples of a trajectory are passed.
        holds: returns whether a trajectory (W, 6) solves the scene as far as nothing moves in it.
    """

    body: MovingBody
    goals: tuple[Goal, ...]
    paths: FloatArray
    radius: FloatArray
    hand: NDArray[np.int64]
    times: FloatArray
    proposed: BoolArray
    able: BoolArray
    trajectory: Callable[[int], FloatArray]
    timing: Callable[[FloatArray], Timing]
    holds: Callable[[FloatArray], bool]

    @functools.cached_property
    def start(self) -> FloatArray:
        """(1, 6) rad, where all trajectories begin."""
        return self.trajectory(0)[:1]


def _at_ticks(knots: FloatArray, interval: float) -> FloatArray:
    """Return (C, TICKS, 3) m, where motions with knots (C, K, 3) m so many seconds apart are."""
    basis = _hermite(knots.shape[1], interval)
    # Each position depends on the four knots around it alone.
    first = np.minimum(np.argmax(basis != 0.0, axis=1), knots.shape[1] - 4)
    near = first[:, None] + np.arange(4)
    weights = np.take_along_axis(basis, near, axis=1)
    tracks = sum(weights[:, k, None] * knots[:, near[:, k]] for k in range(4))
    return np.asarray(tracks)


def _hermite(knots: int, interval: float) -> FloatArray:
    """Return (TICKS, knots): positions at each tick are this times the knots of a `Motion`.

    The knots must be in motion throughout.
    """
    slope = np.diff(np.eye(knots), axis=0) / interval
    velocity = np.zeros((knots, knots))
    velocity[1:-1] = (slope[:-1] + slope[1:]) / 2.0
    velocity[0] = 2.0 * slope[0] - velocity[1]
    at = np.arange(TICKS) * CONTROL_PERIOD / interval
    k = np.minimum(at.astype(np.int64), knots - 2)
    s = np.minimum(at - k, 1.0)[:, None]
    basis: FloatArray = (
        np.eye(knots)[k] + s * s * (3.0 - 2.0 * s) * np.diff(np.eye(knots), axis=0)[k]
    )
    basis += interval * s * (1.0 - s) * ((1.0 - s) * velocity[k] - s * velocity[k + 1])
    return basis


def _draw_knots(
    points: FloatArray,
    times: FloatArray,
    level: BoolArray,
    speed: float,
    rng: np.random.Generator,
) -> tuple[FloatArray, float]:
    """Draw closed curves, and return the knots of motions along them at constant speed.

    Args:
        points: (C, 3) m, that the curves pass.
        times: (C,) s, when they do.
        level: (C,) which stay at their height.
        speed: m/s.
        rng: source of all randomness.

    Returns:
        (C, K, 3) m, and the interval between knots, s. The last brings the body to rest, after the
        episode's horizon.
    """
    count = len(points)
    u = np.linspace(0.0, 2.0 * np.pi, 257)
    amplitude = rng.standard_normal((count, 2, 2, 3))
    amplitude[..., 2] *= np.where(level, 0.0, _HEIGHT)[:, None, None]
    amplitude[:, 1] *= _SECOND / 2.0
    scale = np.sqrt((amplitude[:, 0] ** 2).sum(axis=(1, 2)) / 2.0)
    amplitude *= (rng.uniform(*_RADIUS, size=count) / scale)[:, None, None, None]
    waves = np.stack([[np.cos(k * u), np.sin(k * u)] for k in (1, 2)])
    curves = np.einsum("ckwd,kwu->cud", amplitude, waves)
    interval = _KNOT_SPACING / speed
    steps = int(np.ceil(MAX_EPISODE_STEPS * CONTROL_PERIOD / interval)) + 1
    # On the last interval, beyond the horizon, it goes half as far as on the others: it brakes.
    at = np.append(np.arange(steps + 1), steps + 0.5) * interval
    knots = np.empty((count, steps + 2, 3))
    for c, curve in enumerate(curves):
        arc = np.append(0.0, np.cumsum(np.sqrt((np.diff(curve, axis=0) ** 2).sum(axis=1))))
        passed = rng.uniform(0.0, arc[-1])
        lengths = np.append(passed, passed + speed * (at - times[c])) % arc[-1]
        along = np.stack([np.interp(lengths, arc, column) for column in curve.T], axis=-1)
        knots[c] = points[c] + along[1:] - along[0]
    return np.round(knots, 4), interval


def _even(tracks: FloatArray, speed: float) -> BoolArray:
    """Return a mask (C,) of tracks (C, K, 3) m on which the speed (m/s) is kept."""
    rates = np.sqrt((np.diff(tracks, axis=1) ** 2).sum(axis=2)) / CONTROL_PERIOD
    return np.asarray((np.abs(rates / speed - 1.0) < _SPEED_TOLERANCE).all(axis=1))


def stays_off(movement: Movement, rows: FloatArray, tracks: FloatArray) -> BoolArray:
    """Return a mask (C,) of bodies that stay off base, table, goals and the resting arm."""
    width = widths(rows)
    half = rows[:, 8, None]
    kept = np.asarray((np.hypot(tracks[..., 0], tracks[..., 1]) >= BASE_DISTANCE).all(axis=1))
    low, high = tracks[..., 2] - half, tracks[..., 2] + half
    stands, hangs = standing(rows), hanging(rows)
    kept &= stands | (low >= _TABLE_CLEARANCE).all(axis=1)
    kept &= hangs | (high <= _HIGHEST).all(axis=1)
    for goal in (goal for goal in movement.goals if goal_boxes(goal)):
        _, x, y, z, _, _, reach, _, tall = to_solid_row(goal)
        aside = np.maximum(np.abs(tracks[..., 0] - x), np.abs(tracks[..., 1] - y))
        off = aside >= reach + _GOAL_CLEARANCE + width[:, None]
        off |= low >= z + tall + _GOAL_CLEARANCE
        kept &= off.all(axis=1)
    path = movement.body.paths(movement.start)[None]
    ticks = np.arange(TICKS, dtype=np.int64)
    still = np.broadcast_to(path[:, 0], (TICKS, *path.shape[2:]))[None]
    radius = movement.body.spheres.radius
    index = np.flatnonzero(kept)
    clear = clears_in_time(
        np.ascontiguousarray(still),
        radius,
        ticks[None],
        0,
        rows[index],
        tracks[index],
        START_CLEARANCE,
    )
    kept[index] = clear[:, 0]
    return kept


def stay_apart(rows: FloatArray, tracks: FloatArray, a: int, b: int) -> bool:
    """Return whether two bodies never come near each other."""
    distance = np.hypot(*(tracks[a] - tracks[b])[:, :2].T)
    height = np.abs(tracks[a, :, 2] - tracks[b, :, 2])
    width = widths(rows[[a, b]]).sum()
    return bool(((distance >= width) | (height >= rows[a, 8] + rows[b, 8])).all())


def _choices(movement: Movement, rows: FloatArray, tracks: FloatArray) -> Iterator[tuple[int, ...]]:
    """Yield one or two bodies that block the mean and most proposals, the most blocking first."""
    ticks = ticks_of(movement.times)
    proposed = np.flatnonzero(movement.proposed)
    if not len(proposed) or proposed[0] != 0:
        return
    blocks = ~clears_in_time(
        held_on(movement.paths[proposed]),
        movement.radius,
        ticks[proposed],
        0,
        rows,
        tracks,
        -BLOCKING_DEPTH,
    )
    most = _FREE_SHARE * len(proposed)
    order = np.argsort(-blocks.sum(axis=1), kind="stable")[:_BEST]
    found: list[tuple[int, tuple[int, ...]]] = []
    for i, a in enumerate(order):
        if blocks[a, 0] and (~blocks[a]).sum() <= most:
            found.append((int((~blocks[a]).sum()), (int(a),)))
        for b in order[i + 1 :]:
            free = ~(blocks[a] | blocks[b])
            if not free[0] and free.sum() <= most:
                found.append((int(free.sum()), (int(a), int(b))))
    found.sort(key=lambda choice: choice[0])
    yielded = 0
    for _, choice in found:
        if len(choice) == 1 or stay_apart(rows, tracks, *choice):
            yield choice
            yielded += 1
            if yielded == _CHOICES:
                return


def witness_in_time(
    movement: Movement,
    rows: FloatArray,
    tracks: FloatArray,
    clearance: float,
    delays: Sequence[float] = _DELAYS,
) -> FloatArray | None:
    """Return a trajectory (200, 6) rad that gets by in time, the wait before it included.

    Args:
        movement: whose members are tried.
        rows: (M, 9) rows of moving obstacles.
        tracks: (M, K, 3) m.
        clearance: m.
        delays: s, waits before the trajectory, tried one after the other.
    """
    body, radius = movement.body, movement.body.spheres.radius
    able = np.flatnonzero(movement.able)
    paths, ticks = held_on(movement.paths[able]), ticks_of(movement.times[able])
    for delay in delays:
        offset = round(delay / CONTROL_PERIOD)
        clear = clears_in_time(paths, movement.radius, ticks, offset, rows, tracks, clearance)
        for index in able[clear.all(axis=0)][:_MEMBERS]:
            found = delayed(movement.trajectory(int(index)), delay)
            if not (within_limits(found) and movement.holds(found)):
                continue
            times = movement.timing(found).times(len(found))
            path = held_on(body.paths(found))[None]
            if clears_in_time(
                path, radius, ticks_of(times)[None], 0, rows, tracks, clearance
            ).all():
                return found
    return None


def cross(
    movement: Movement, difficulty: str, rng: np.random.Generator, others: FloatArray
) -> tuple[FloatArray, tuple[Motion, ...], FloatArray] | None:
    """Draw one or two bodies that move across, and a witness; None if they do not fit together.

    Args:
        movement: what they cross.
        difficulty: says how fast they are, see `SPEEDS`.
        rng: source of all randomness.
        others: (K, 9) rows of standing obstacles, which they stay apart from.

    Returns:
        (M, 9) rows, the motions of these, and the witness, (200, 6) rad.
    """
    speed = SPEEDS[difficulty]
    proposed = np.flatnonzero(movement.proposed)
    which = proposed[rng.integers(len(proposed), size=_CANDIDATES)]
    samples = movement.paths.shape[1]
    sample = rng.integers(samples // 6, samples, size=_CANDIDATES)
    sphere = movement.hand[rng.integers(len(movement.hand), size=_CANDIDATES)]
    rows = draw_bodies(movement.paths[which, sample, sphere], movement.radius[sphere], rng)
    level = standing(rows) | hanging(rows)
    times = movement.times[which, sample]
    knots, interval = _draw_knots(rows[:, 1:4], times, level, speed, rng)
    knots[level, :, 2] = rows[level, 3, None]
    tracks = _at_ticks(knots, interval)
    even = _even(tracks, speed)
    kept = even.copy()
    kept[even] = stays_off(movement, rows[even], tracks[even])
    for other in others:
        both = np.concatenate([rows, other[None]])
        still = np.repeat(other[None, None, 1:4], TICKS, axis=1)
        at = np.concatenate([tracks, still])
        kept[kept] = [stay_apart(both, at, int(c), len(rows)) for c in np.flatnonzero(kept)]
    rows, knots, tracks = rows[kept], knots[kept], np.ascontiguousarray(tracks[kept])
    for choice in _choices(movement, rows, tracks):
        chosen = list(choice)
        witness = witness_in_time(movement, rows[chosen], tracks[chosen], CLEARANCE)
        if witness is not None:
            moments = tuple((interval * np.arange(knots.shape[1])).round(6).tolist())
            motions = tuple(
                Motion(times=moments, points=tuple(map(tuple, knots[c].tolist()))) for c in chosen
            )
            return rows[chosen], motions, witness
    return None


def transfer_movement(
    query: Query,
    rng: np.random.Generator,
    others: FloatArray = _NO_TRAJECTORIES,
    obstacles: FloatArray = _NO_ROWS,
) -> Movement:
    """Return the movement of a query: a family of trajectories of the transfer, executed evenly.

    Args:
        query: which transfer to which goal.
        rng: source of all randomness.
        others: (K, W, 6) rad, further trajectories that may serve as witness; they come last.
        obstacles: (K, 9) rows that every witness keeps clear of.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    transfer = replace(query.transfer, samples=_MEMBER_SAMPLES)
    query = replace(query, transfer=transfer)
    family = draw_family(query, transfer.proposals, transfer.wide, rng)
    swept = transfer.spheres.link[transfer.swept]
    proposed = family.free.copy()
    proposed[family.proposals :] = False
    bodies, clearance = fixture_rows(query.goals), CLEARANCE if len(obstacles) else 0.0

    def timing(trajectory: FloatArray) -> Timing:
        return Timing(execution_time(trajectory))

    trajectories = np.concatenate([members(transfer, family), others])
    paths = transfer.paths(resample(others, _MEMBER_SAMPLES), transfer.swept)
    more = np.ones(len(others), np.bool_)
    durations = execution_times(trajectories)
    return Movement(
        body=transfer,
        goals=query.goals,
        paths=np.concatenate([family.paths, paths]),
        radius=family.radius,
        hand=np.flatnonzero(swept >= 5),
        times=durations[:, None] * np.linspace(0.0, 1.0, _MEMBER_SAMPLES),
        proposed=np.concatenate([proposed, ~more]),
        able=np.concatenate([family.able, more]),
        trajectory=lambda index: trajectories[index],
        timing=timing,
        holds=lambda trajectory: is_witness(transfer, trajectory, bodies, obstacles, clearance),
    )


def among_moving(
    query: Query, difficulty: str, rng: np.random.Generator, others: FloatArray = _NO_ROWS
) -> Draw | None:
    """Draw bodies that move across a transfer, and a witness; None if they do not fit together.

    Args:
        query: which transfer to which goal.
        difficulty: says how fast they are.
        rng: source of all randomness.
        others: (K, 9) rows of obstacles that stand in the scene besides; they are its first.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    found = cross(transfer_movement(query, rng, obstacles=others), difficulty, rng, others)
    if found is None:
        return None
    rows, motions, witness = found
    return Draw(
        query.transfer.start,
        query.goals,
        np.concatenate([others, rows]),
        witness,
        motions=(*(None,) * len(others), *motions),
    )
