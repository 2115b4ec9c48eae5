"""Furniture around a goal with one tight opening, and a witness that passes through it.

Furniture cannot be put together around a witness as single obstacles are, and no random detour
passes an opening hardly wider than the hand. So the last part of the witness is drawn first: the
*insertion*, a straight movement of the hand to the release. A piece of furniture is fitted to it;
the rest of the witness is a member of the family of trajectories to where the insertion begins.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.robot.chain import END_EFFECTOR, link_transforms
from smp_gym.robot.inverse import damped_step, pose_errors, pose_jacobians
from smp_gym.robot.spheres import concatenate, finger_spheres, sphere_centers
from smp_gym.sampling import kernels
from smp_gym.sampling.conversion import fixture_rows, to_row, to_solid_row
from smp_gym.sampling.detours import smoothstep
from smp_gym.sampling.draws import Draw
from smp_gym.sampling.family import BLOCKING_DEPTH, Family, draw_family, member
from smp_gym.sampling.furniture import Passage, draw_furniture
from smp_gym.sampling.obstacles import START_CLEARANCE
from smp_gym.sampling.swept_path import SweptPath
from smp_gym.sampling.transfer import Query, Transfer
from smp_gym.sampling.witness import WITNESS_SAMPLES, is_witness, within_limits
from smp_gym.scene import Goal

__all__ = ["TIGHTNESS", "Tightness", "furnish", "hand_width"]


@dataclass(frozen=True)
class Tightness:
    """The settings of a difficulty of furniture.

    Attributes:
        gap: m, by which the opening is wider than the hand (`hand_width`).
        clearance: m, what furniture leaves between itself and the witness's spheres.
    """

    gap: float
    clearance: float


TIGHTNESS = {
    "easy": Tightness(gap=0.060, clearance=0.015),
    "medium": Tightness(gap=0.040, clearance=0.010),
    "hard": Tightness(gap=0.025, clearance=0.006),
}

_HAND_LINK = 5
"""The hand: spheres from this link on, fingers and held object included."""

_STEEP = {"box": (0.9, 1.3)}
_ALONG = (0.0, 0.15)
_LENGTHS = (0.14, 0.26)
_STEP = 0.02
_LARGEST_JOINT_STEP = 0.25
_CORRECTIONS = 3
_POSITION_ERROR = 1e-3
"""Of an insertion: its angle below the horizontal, rad, of some kinds; of the others by how much it
is steeper than the hand; its length, its steps, m, and the largest of a joint, rad; the Newton
steps at each, and the error that they may leave, m."""

_OPENING_ANGLES = (0.0, 0.3, 0.6)
"""Angles of the fingers that let go, rad: they need more room than the hand that comes in."""

_INSERTION_SHARE = 0.3
"""Of the witness's samples."""

_GOAL_BODY_CLEARANCE = 0.012
"""m, between furniture and points on the body of a goal."""

_FREE_SHARE = 0.05
_FREE_SHARE_OF_BOX = 0.2
"""Share of the proposals that furniture may leave free; what comes from above, as most of them do,
often finds into a box."""

_MEMBER_SAMPLES = 40
_PROPOSALS = 60
_WIDE_DETOURS = 96
"""Samples of each member of a family, more than for single obstacles since furniture is thin; how
many detours of ordinary width are to be blocked, and how many wide ones lead to an insertion."""

_INSERTIONS = 3
_PIECES = 6
_MEMBERS = 12
"""Numbers of insertions tried with a goal, of pieces tried with an insertion, and of members of the
family tried as the witness of each."""

_POINTS_PER_AXIS = (9, 9, 7)
"""Points on a goal's body along x, y and z that furniture is kept away from."""


@dataclass(frozen=True, eq=False)
class _Approach(Query):
    """The query of a movement that ends where an insertion begins."""

    begin: FloatArray = field(default_factory=lambda: np.zeros(6))

    @property
    def release(self) -> FloatArray:
        """(6,) rad, where the insertion begins."""
        return self.begin


def _goal_frame(goal: Goal) -> tuple[FloatArray, FloatArray]:
    """Return axes (3, 3) and origin (3,) m of a goal's frame, on the table, x away from the robot.

    The rows of the first are the axes.
    """
    x, y, _ = goal.position
    c, s = np.cos(np.arctan2(y, x)), np.sin(np.arctan2(y, x))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([x, y, 0.0])


def _hand_range(query: Query) -> tuple[float, float]:
    """Return least and greatest y, in the goal's frame, of hand and object at the release, m."""
    spheres = query.transfer.spheres
    hand = np.flatnonzero(spheres.link >= _HAND_LINK)
    axes, origin = _goal_frame(query.goal)
    y = (query.transfer.paths(query.release[None], hand)[0] - origin) @ axes[1]
    return float((y - spheres.radius[hand]).min()), float((y + spheres.radius[hand]).max())


def hand_width(query: Query) -> float:
    """Return the width of the hand, m: of all its spheres at the release, across the goal's frame.

    Wrist, palm, fingers and held object count; their height is greater, so this is what an opening
    has to have at least.

    Args:
        query: whose release posture is looked at.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    low, high = _hand_range(query)
    return high - low


def _opened(query: Query) -> tuple[FloatArray, FloatArray]:
    """Return centres (K, 3) m and radii (K,) m of the fingers' spheres, opening at the release."""
    opening = [finger_spheres((angle, angle, 0.0, 0.0)) for angle in _OPENING_ANGLES]
    spheres = concatenate(*opening)
    return sphere_centers(query.release, spheres), spheres.radius


def _retreat(transfer: Transfer, release: FloatArray, step: FloatArray, count: int) -> FloatArray:
    """Return (K, 6) rad, K <= 1 + count: the hand moved from its release in steps (3,) m.

    It keeps its orientation. The movement ends early where the arm cannot go on.
    """
    reached = [release]
    tool = link_transforms(release)[-1] @ END_EFFECTOR
    rotation = tool[:3, :3]
    for number in range(1, count + 1):
        target = tool[:3, 3] + number * step
        # The last step carried on is a good guess of the next.
        q = reached[-1] if number == 1 else 2 * reached[-1] - reached[-2]
        for _ in range(_CORRECTIONS):
            links = link_transforms(q)
            pose = links[-1] @ END_EFFECTOR
            error = pose_errors(pose, target, rotation)
            if np.linalg.norm(error) < 0.1 * _POSITION_ERROR:
                break
            q = q + damped_step(pose_jacobians(links, pose, True), error, 1e-6)
        pose = link_transforms(q)[-1] @ END_EFFECTOR
        if (
            np.linalg.norm(pose_errors(pose, target, rotation)) > _POSITION_ERROR
            or np.abs(q - reached[-1]).max() > _LARGEST_JOINT_STEP
        ):
            break
        reached.append(q)
    return np.array(reached)


def _draw_insertion(kind: str, query: Query, rng: np.random.Generator) -> FloatArray | None:
    """Return (K, 6) rad of an insertion, from its begin to the release; None if it is too short."""
    transfer = query.transfer
    heading = (link_transforms(query.release)[-1] @ END_EFFECTOR)[:3, 0]
    level = np.hypot(heading[0], heading[1])
    tilt = float(np.arctan2(-heading[2], level))
    angle = rng.uniform(*_STEEP[kind]) if kind in _STEEP else tilt + rng.uniform(*_ALONG)
    out = -np.cos(angle) * heading[:2] / level
    step = _STEP * np.array([out[0], out[1], np.sin(angle)])
    count = int(rng.uniform(*_LENGTHS) / _STEP) + 1
    back = _retreat(transfer, query.release, step, count)
    if len(back) <= _LENGTHS[0] / _STEP or not within_limits(back, 1.0):
        return None
    path = transfer.paths(back)
    if not kernels.clear_of_itself(path, transfer.spheres.radius, transfer.pairs, 0.005):
        return None
    return back[::-1]


def _passage(query: Query, insertion: FloatArray, tightness: Tightness) -> Passage:
    """Return what a piece of furniture has to leave free for an insertion."""
    transfer = query.transfer
    axes, origin = _goal_frame(query.goal)
    moving = transfer.moving
    centers = (transfer.paths(insertion, moving) - origin) @ axes.T
    radius = transfer.spheres.radius[moving]
    hand = transfer.spheres.link[moving] >= _HAND_LINK
    low, high = _hand_range(query)
    start = (link_transforms(transfer.start)[-1] @ END_EFFECTOR @ transfer.held)[:3, 3] - origin
    body = to_solid_row(query.goal)[6]
    opened, finger_radius = _opened(query)
    fingers = (opened - origin) @ axes.T
    return Passage(
        goal=query.goal.position,
        half=float(body * (np.abs(axes[0, 0]) + np.abs(axes[0, 1]))),
        centers=centers.reshape(-1, 3),
        radius=np.tile(radius, len(centers)),
        bottom=float((centers[-1, hand, 2] - radius[hand]).min()),
        reach=float((centers[-1, hand, 0] + radius[hand]).max()),
        spread=float((np.abs(fingers[:, 1] - (low + high) / 2) + finger_radius).max()),
        inside=float((fingers[:, 2] + finger_radius).max()),
        rise=float(centers[0, -1, 2] - centers[-1, -1, 2]),
        middle=(low + high) / 2,
        opening=high - low + tightness.gap,
        headroom=tightness.gap / 2,
        slack=tightness.gap / 2 - tightness.clearance,
        side=1 if start @ axes[1] > 0.0 else -1,
    )


def _joined(approach: FloatArray, insertion: FloatArray) -> FloatArray:
    """Return the witness (W, 6) rad of an approach (W, 6) and an insertion (K, 6)."""
    last = round(_INSERTION_SHARE * WITNESS_SAMPLES)
    first = np.linspace(0.0, len(approach) - 1.0, WITNESS_SAMPLES - last)
    then = (len(insertion) - 1.0) * smoothstep(np.arange(1, last + 1) / last)

    def sampled(trajectory: FloatArray, at: FloatArray) -> FloatArray:
        knots = np.arange(len(trajectory))
        return np.column_stack([np.interp(at, knots, joint) for joint in trajectory.T])

    return np.concatenate([sampled(approach, first), sampled(insertion, then)])


def _points_of(goals: tuple[Goal, ...]) -> FloatArray:
    """Return (1, N, 3) m, points all over the bodies of goals."""
    points = []
    for goal in goals:
        row = np.array(to_solid_row(goal))
        steps = (np.linspace(-1.0, 1.0, count) for count in _POINTS_PER_AXIS)
        grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
        points.append(row[1:4] + grid * row[6:9])
    return np.concatenate(points)[None]


def _blocks_enough(family: Family, rows: FloatArray, share: float) -> bool:
    """Return whether furniture blocks the mean and leaves at most a share of the proposals free."""
    blocked = kernels.blocked_paths(family.paths, family.radius, rows, BLOCKING_DEPTH)
    free: BoolArray = family.free & ~blocked.any(axis=0)
    return bool(not free[0] and free.sum() <= share * family.free.sum())


def furnish(
    kind: str,
    difficulty: str,
    query: Query,
    rng: np.random.Generator,
    before: Draw | None = None,
) -> Draw | None:
    """Draw furniture around a goal, and a witness; None if they do not fit together.

    Args:
        kind: of the furniture.
        difficulty: one of `TIGHTNESS`.
        query: which transfer to which goal.
        rng: source of all randomness.
        before: what was drawn for another goal: its witness stays one, and its furniture is in the
            result, too.

    Raises:
        UnreachableError: the goal is out of reach.
    """
    tightness = TIGHTNESS[difficulty]
    transfer = replace(query.transfer, samples=_MEMBER_SAMPLES)
    query = replace(query, transfer=transfer)
    points = _points_of(query.goals)
    goals = SweptPath.of(points, np.zeros(points.shape[1]))
    fingers, finger_radius = _opened(query)
    hand = SweptPath.of(fingers[None], finger_radius)
    others = np.empty((0, kernels.OBSTACLE_COLUMNS)) if before is None else before.rows
    first = None if before is None else before.witness
    other = None if first is None else transfer.swept_path(first)

    def fits(rows: FloatArray, insertion: FloatArray) -> bool:
        at_goals = goals.clear(rows, _GOAL_BODY_CLEARANCE).all()
        opened = hand.clear(rows, tightness.clearance).all()
        kept = [(transfer.at_start, START_CLEARANCE)]
        kept.append((transfer.swept_path(insertion), tightness.clearance))
        if other is not None:
            kept.append((other, tightness.clearance))
        return bool(at_goals and opened) and all(
            path.clear(rows, least).all() for path, least in kept
        )

    share = _FREE_SHARE_OF_BOX if kind == "box" else _FREE_SHARE
    proposals: Family | None = None
    for _ in range(_INSERTIONS):
        insertion = _draw_insertion(kind, query, rng)
        if insertion is None:
            continue
        passage = _passage(query, insertion, tightness)
        pieces: list[FloatArray] = []
        for _ in range(_PIECES):
            rows = np.array([to_row(part) for part in draw_furniture(kind, passage, rng)])
            if fits(rows, insertion):
                pieces.append(rows)
                break
        if not pieces:
            continue
        rows = pieces[0]
        if proposals is None:
            proposals = draw_family(query, _PROPOSALS, 0, rng)
        if not _blocks_enough(proposals, rows, share):
            continue
        found = _lead_to(insertion, query, np.concatenate([others, rows]), tightness, rng)
        if found is not None:
            together = np.concatenate([others, rows])
            return Draw(transfer.start, query.goals, together, found if first is None else first)
    return None


def _lead_to(
    insertion: FloatArray,
    query: Query,
    rows: FloatArray,
    tightness: Tightness,
    rng: np.random.Generator,
) -> FloatArray | None:
    """Return a witness (W, 6) rad that ends with an insertion; None if none is found."""
    transfer = query.transfer
    approach = _Approach(transfer, query.goals, query.number, begin=insertion[0])
    family = draw_family(approach, 0, _WIDE_DETOURS, rng)
    bodies = fixture_rows(query.goals)
    alive = family.able & ~family.near(rows, tightness.clearance).any(axis=0)
    for index in np.flatnonzero(alive)[:_MEMBERS]:
        witness = _joined(member(transfer, family, int(index)), insertion)
        if is_witness(transfer, witness, bodies, rows, tightness.clearance):
            return witness
    return None
