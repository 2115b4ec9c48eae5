"""Scenes of DoubleSidedPlacement: a pad on either side, and obstacles or furniture before both."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot import kinematics
from smp_gym.sampling.blocking import block, block_around_witness
from smp_gym.sampling.clutter import CLUTTER, clutter
from smp_gym.sampling.conversion import to_row
from smp_gym.sampling.displaced import NARROW, displaced
from smp_gym.sampling.draws import Draw, SceneSampler
from smp_gym.sampling.furnished import furnish
from smp_gym.sampling.furniture import FURNITURE
from smp_gym.sampling.moving import among_moving
from smp_gym.sampling.obstacles import START_CLEARANCE
from smp_gym.sampling.specification import SPECIFICATIONS, DifficultySpecification
from smp_gym.sampling.transfer import Query, Transfer, make_transfer
from smp_gym.scene import Goal, Obstacle
from smp_gym.tasks.double_sided_placement.rules import (
    HELD_OBJECT_POSE,
    NOMINAL_PADS,
    PAD_LOWEST,
    PAD_SHIFT,
    PAD_TOP,
    START_CONFIGURATION,
)

__all__ = ["SAMPLER", "demonstrated_transfers"]

_GOAL_CLEARANCE = 0.01
"""m, of obstacles from the pads, sideways."""

_CLOSED_SHARE = {"none": 0.0, "easy": 0.25, "medium": 0.5, "hard": 1.0}
"""Share of the scenes in which the other side is closed off: its only obstacle stands on the pad
and leaves no room there."""

_TRIES = 30
"""How often pads and obstacles are drawn once it is settled whether the other side is closed off:
draws fail more often where it is open, and a draw anew each time would close it in more scenes."""

_STOPPER_HALF_EXTENTS = (0.05, 0.06)
"""m, of what stands on a pad that is closed off: between it and the pad's edge no object fits with
its centre over the pad."""

_PROPOSALS = 168
"""To each pad: two goals are two chances to get through, so each has to be blocked more surely."""

_CLUTTER_FREE_SHARES = {"easy": 0.5, "medium": 0.3, "hard": 0.15}
"""Share of the proposals for each pad that half of the clutter may leave free."""

_SIDE_DRAWS = 3
"""How often the second of two furnished or cluttered sides is tried."""


@functools.lru_cache(maxsize=1)
def demonstrated_transfers() -> tuple[Transfer, Transfer]:
    """Return the movements to the left and to the right that the demonstrations show."""
    shown = Demonstrations.load("DoubleSidedPlacement")
    left = kinematics.end_effector_pose(shown.configurations[:, -1])[:, 1, 3] > 0.0
    one, other = (
        make_transfer(
            shown,
            which,
            side,
            START_CONFIGURATION,
            HELD_OBJECT_POSE,
            _GOAL_CLEARANCE,
            proposals=_PROPOSALS,
            blind_side=("DoubleSidedPlacement", side),
        )
        for side, which in enumerate((left, ~left))
    )
    return one, other


def _draw_queries(rng: np.random.Generator) -> tuple[Query, Query]:
    """Draw a pad on either side, and which of them comes first."""
    pads = []
    for x, y, _ in NOMINAL_PADS:
        radius = PAD_SHIFT * np.sqrt(rng.uniform())
        angle = rng.uniform(-np.pi, np.pi)
        z = rng.uniform(PAD_LOWEST, PAD_TOP)
        position = (x + float(radius * np.cos(angle)), y + float(radius * np.sin(angle)), float(z))
        pads.append(Goal(kind="pad", position=position))
    one, other = demonstrated_transfers()
    queries = Query(one, tuple(pads), 0), Query(other, tuple(pads), 1)
    return queries if rng.integers(2) == 0 else queries[::-1]


def _draw_closed(difficulty: str, rng: np.random.Generator) -> bool:
    """Draw whether the other side is closed off."""
    return bool(rng.uniform() < _CLOSED_SHARE[difficulty])


def _specification(difficulty: str, closed: bool) -> DifficultySpecification:
    """Return a difficulty's settings for each side that is open."""
    one = SPECIFICATIONS[difficulty]
    if closed:
        return one
    # Two open sides are two chances to get through.
    return replace(one, free_share=one.free_share / 2.0, blind_share=one.blind_share / 2.0)


def _draw(difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw two pads, obstacles on both sides and a witness; None if they do not fit together.

    The first side is sure to be open, and the witness goes there. The other one either
    has a witness, too, or is closed off.
    """
    closed = _draw_closed(difficulty, rng)
    one = _specification(difficulty, closed)
    for _ in range(_TRIES):
        first, second = _draw_queries(rng)
        drawn = block_around_witness((first,) if closed else (first, second), one, rng)
        if drawn is not None and closed:
            drawn = _closed_off(drawn, first, second, one.clearance, rng)
        if drawn is not None:
            return drawn
    return None


def _closed_off(
    drawn: Draw, first: Query, second: Query, clearance: float, rng: np.random.Generator
) -> Draw | None:
    """Close off the second pad of what was drawn for the first; None if the witness comes near."""
    assert drawn.witness is not None
    rows = _stopper(second.goal, rng)
    enough = max(clearance, START_CLEARANCE)
    if not first.transfer.swept_path(drawn.witness).clear(rows, enough).all():
        return None
    return replace(drawn, rows=np.concatenate([drawn.rows, rows]))


def _stopper(goal: Goal, rng: np.random.Generator) -> FloatArray:
    """Return the (1, 9) row of a box that leaves no room on a pad."""
    half = rng.uniform(*_STOPPER_HALF_EXTENTS, size=3)
    x, y, z = goal.position
    size = (float(half[0]), float(half[1]), float(half[2]))
    box = Obstacle(shape="box", position=(x, y, z + size[2]), size=size)
    return np.array([to_row(box)])


def _place(difficulty: str, rng: np.random.Generator) -> Draw | None:
    first, second = _draw_queries(rng)
    closed = _draw_closed(difficulty, rng)
    one = _specification(difficulty, closed)
    rows = block(first, one, rng)
    if rows is None:
        return None
    if closed:
        rows = np.concatenate([rows, _stopper(second.goal, rng)])
    else:
        rows = block(second, one, rng, rows)
    return None if rows is None else Draw(first.transfer.start, first.goals, rows)


def _furnish(kind: str, difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw furniture on both sides, both with a witness; the scene's is that of the first."""
    first, second = _draw_queries(rng)
    drawn = furnish(kind, difficulty, first, rng)
    if drawn is None:
        return None
    for _ in range(_SIDE_DRAWS):
        both = furnish(kind, difficulty, second, rng, drawn)
        if both is not None:
            return both
    return None


def _clutter(difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw half of the clutter on each side, both with a witness; the scene's is the first's."""
    first, second = _draw_queries(rng)
    half = replace(
        CLUTTER[difficulty],
        solids=CLUTTER[difficulty].solids // 2,
        free_share=_CLUTTER_FREE_SHARES[difficulty],
    )
    drawn = clutter(first, half, rng)
    if drawn is None:
        return None
    for _ in range(_SIDE_DRAWS):
        both = clutter(second, half, rng, drawn)
        if both is not None:
            return both
    return None


def _move(difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw bodies that move across the movement to one side; the other is closed off."""
    first, second = _draw_queries(rng)
    return among_moving(first, difficulty, rng, _stopper(second.goal, rng))


def _displace(difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw obstacles on one side that are shifted in mid-episode; the other is closed off."""
    first, second = _draw_queries(rng)
    one = _specification(NARROW, closed=True)
    drawn = block_around_witness((first,), one, rng)
    if drawn is None or drawn.witness is None:
        return None
    closed = _closed_off(drawn, first, second, one.clearance, rng)
    return displaced(first, closed, difficulty, rng)


SAMPLER = SceneSampler(
    _draw,
    _place,
    families={kind: functools.partial(_furnish, kind) for kind in FURNITURE}
    | {"clutter": _clutter, "moving": _move, "displaced": _displace},
)
