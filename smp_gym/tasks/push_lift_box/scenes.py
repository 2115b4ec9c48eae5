"""Scenes of PushLiftBox.

Every trajectory leads the hand behind the box, along the push, and with the box to the target. The
push is given with the box; the *approach* before it and the *lift* after it are legs, whose members
combine. Obstacles keep clear of the push and leave few of the trajectories free, but one as
witness; where they are placed without a witness, they keep clear of the lift's end besides, and
nobody looks for one.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot import kinematics
from smp_gym.robot.inverse_kernels import reach_points, reach_pose
from smp_gym.sampling import kernels
from smp_gym.sampling.conversion import to_row
from smp_gym.sampling.detours import smoothstep
from smp_gym.sampling.draws import Draw, SceneSampler
from smp_gym.sampling.moving_body import MovingBody
from smp_gym.sampling.obstacles import START_CLEARANCE
from smp_gym.sampling.specification import SPECIFICATIONS
from smp_gym.sampling.swept_path import SweptPath
from smp_gym.sampling.witness import is_witness
from smp_gym.scene import TABLE, Goal, ManipulatedObject, Obstacle
from smp_gym.tasks.push_lift_box import rules as push_lift_box
from smp_gym.tasks.push_lift_box.leg_obstacles import (
    choose_on_legs,
    draw_on_legs,
    grown,
    grown_partly,
)
from smp_gym.tasks.push_lift_box.legs import (
    Leg,
    LegFamily,
    Members,
    draw_detours,
    free_paths,
    left_free,
    make_family,
)

__all__ = ["CROWDS", "PLACED", "SAMPLER"]

CROWDS = {"easy": (0.022, 9, 0.003), "medium": (0.016, 10, 0.002), "hard": (0.010, 11, 0.001)}
"""By difficulty: clearance of the reference (m), number of obstacles, and share of the trajectories
that may stay free of them."""

PLACED = {"easy": (4, 0.1), "medium": (5, 0.1), "hard": (6, 0.05)}
"""By difficulty, without a reference: number of obstacles, and share of the trajectories that may
stay free of them. As many as beside a reference would leave no way at all."""

_PROPOSALS = 48
_TRIALS = 48
_WIDE_MEMBERS = 64
_ALONE = 8
"""Members of a leg: that obstacles are chosen by, fresh ones that the choice is tried on, and wider
ones that may serve as witness; and members where there are no obstacles."""

_PROPOSED_WIDTHS = (0.02, 0.07)
_WIDE_WIDTHS = (0.05, 0.25)
_PROPOSED_SHIFT = 0.05
_WIDE_SHIFT = 0.15
"""rad, standard deviations of the detours at the middle of a leg, and of the posture at the target
about the demonstrated one: what a primitive leaves open, and what a witness may use."""

_CANDIDATE_SETS = 2
_REFERENCES = 6
"""Numbers of sets of candidates tried with a reference, and of members tried as one."""

_PUSH_KNOTS = 5
"""Configurations along a push for which inverse kinematics is solved; between them it is
interpolated."""

_PUSH_STRIDE = 6
_APPROACH_STRIDE = 6
_LIFT_STRIDE = 5
_OUTLINE_SPACING = 0.04
"""Samples of push and legs, and m between the spheres of a link, by which candidates are compared.
What is chosen is checked with all of them."""

_BOX_CLEARANCE = 0.03
_TARGET_CLEARANCE = 0.03
"""m, of obstacles from the box while it is pushed, and from the box held at the target."""

_SLACK = 0.003
_REFERENCE_STRIDE = 3
"""m, added to the clearance from the reference for what lies between the samples by which bodies
grow, and how many samples these are apart."""

_TABLE_ROWS = np.array([to_row(TABLE)])


Keeps = Callable[[FloatArray], BoolArray]


@dataclass(frozen=True, eq=False)
class _Movement:
    """The demonstrated movement in its three parts, built once per process.

    Attributes:
        approach: to behind the box.
        push: the body that pushes.
        push_samples: of a witness, at which the push begins and ends.
        near: (`_PUSH_KNOTS`, 6) rad, demonstrated at equal steps of the push's samples.
        bearing: rad, of the demonstrated boxes as seen from the base.
        lift: with the box in the hand.
        held: (3,) m, the box's centre in the end-effector frame.
    """

    approach: Leg
    push: MovingBody
    push_samples: tuple[int, int]
    near: FloatArray
    bearing: float
    lift: Leg
    held: FloatArray


def _outline(spheres: kinematics.SphereSet, which: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a subset of the given spheres: the greatest, with room between those of a link."""
    kept: list[int] = []
    for index in which[np.argsort(-spheres.radius[which], kind="stable")]:
        others = [k for k in kept if spheres.link[k] == spheres.link[index]]
        apart = spheres.center[others] - spheres.center[index]
        if (np.sqrt((apart**2).sum(axis=1)) >= _OUTLINE_SPACING).all():
            kept.append(int(index))
    return np.sort(np.array(kept))


@functools.lru_cache(maxsize=1)
def _movement() -> _Movement:
    demonstrations = Demonstrations.load("PushLiftBox")
    shown = demonstrations.configurations
    begin, end = (int(sample) for sample in demonstrations.metadata["push_samples"])
    held = np.array(demonstrations.metadata["object_in_hand"])
    arm = kinematics.arm_spheres()
    opened = kinematics.concatenate(arm, kinematics.finger_spheres(np.zeros(4)))
    box = kinematics.box_spheres(ManipulatedObject().size, held)
    fingers = kinematics.finger_spheres(demonstrations.metadata["finger_angles"])
    closed = kinematics.concatenate(arm, fingers, box)

    def body(spheres: kinematics.SphereSet, samples: slice, stride: int) -> Leg:
        swept = np.flatnonzero(spheres.link >= 2)
        return Leg(
            demonstrations=shown[:, samples],
            spheres=spheres,
            # The box touches the table when it is pushed and lifted: that is no collision.
            moving=swept[swept < len(opened)],
            swept=swept,
            pairs=kinematics.self_collision_pairs(spheres),
            steps=shown.shape[1] - 1,
            stride=stride,
            outline=_outline(spheres, swept),
        )

    knots = np.linspace(begin, end, _PUSH_KNOTS).round().astype(int)
    boxes = [scene.manipulated for scene in demonstrations.scenes]
    places = np.array([box.position for box in boxes if box is not None and box.position])
    return _Movement(
        approach=body(opened, slice(0, begin + 1), _APPROACH_STRIDE),
        push=body(opened, slice(begin, end + 1), _PUSH_STRIDE),
        push_samples=(begin, end),
        near=shown.mean(axis=0)[knots],
        bearing=float(np.arctan2(places[:, 1], places[:, 0]).mean()),
        lift=body(closed, slice(end, None), _LIFT_STRIDE),
        held=held[:3, 3],
    )


def _push(movement: _Movement, box: ManipulatedObject) -> FloatArray:
    """Return the configurations (T, 6) rad of the push of a box, from rest to rest.

    Raises:
        UnreachableError: the box is out of reach.
    """
    place = np.asarray(box.position)
    poses = push_lift_box.push_poses(place, box.yaw, np.linspace(0.0, 1.0, _PUSH_KNOTS))
    # The base's joint turns against the bearing.
    turn = movement.bearing - np.arctan2(place[1], place[0])
    knots = np.array(
        [
            reach_pose(pose, near + turn * np.eye(6)[0])
            for pose, near in zip(poses, movement.near, strict=True)
        ]
    )
    begin, end = movement.push_samples
    share = smoothstep(np.linspace(0.0, 1.0, end - begin + 1))
    at = np.linspace(0.0, 1.0, _PUSH_KNOTS)
    # The polynomial through all knots (Lagrange): the joints move smoothly.
    weights = [
        np.prod([(share - other) / (knot - other) for other in at if other != knot], axis=0)
        for knot in at
    ]
    return np.einsum("kt,kj->tj", np.array(weights), knots)


@dataclass(frozen=True, eq=False)
class _Episode:
    """The query of one episode: (6,) start, the box, (T, 6) its push, the goal."""

    start: FloatArray
    box: ManipulatedObject
    push: FloatArray
    goal: Goal

    def members(self, proposals: int, wide: int, rng: np.random.Generator) -> list[Members]:
        """Return random members of approach and lift, the means of both first."""
        movement = _movement()
        count = proposals + wide
        widths = np.empty((count, 1, 1))
        widths[:proposals, 0, 0] = rng.uniform(*_PROPOSED_WIDTHS, size=proposals)
        widths[proposals:, 0, 0] = rng.uniform(*_WIDE_WIDTHS, size=wide)
        shift = np.where(np.arange(count) < proposals, _PROPOSED_SHIFT, _WIDE_SHIFT)[:, None]
        ends = np.tile(self.push[0], (count, 1))
        members = []
        for leg, begin in ((movement.approach, self.start), (movement.lift, self.push[-1])):
            base = rng.integers(len(leg.demonstrations), size=count)
            detours = widths * draw_detours(count, rng)
            shifts = shift * rng.standard_normal((count, 6))
            base[0], detours[0], shifts[0] = -1, 0.0, 0.0
            if leg is movement.lift:
                shown = leg.demonstrations[:, -1].mean(axis=0)
                place = np.asarray(self.goal.position)
                ends = reach_points(place, movement.held, shown + shifts)
                ends = np.where(np.isnan(ends), ends[0], ends)
                if np.isnan(ends[0]).any():
                    raise kinematics.UnreachableError(f"no lift to {place} is near the shown ones")
            members.append(Members(begin, ends, base, detours))
        return members

    def families(
        self, proposals: int, wide: int, rng: np.random.Generator
    ) -> tuple[LegFamily, LegFamily]:
        """Draw families of approaches and lifts."""
        movement = _movement()
        approach, lift = self.members(proposals, wide, rng)
        return (
            make_family(movement.approach, approach, proposals + wide),
            make_family(movement.lift, lift, proposals + wide),
        )

    def keeps(self, legs: list[FloatArray] | None, clearance: float) -> Keeps:
        """Return the test of obstacles' rows (C, 9) for all distances that they must keep.

        Args:
            legs: (T, 6) rad, approach and lift of the reference; None if there is none.
            clearance: m, from it.
        """
        movement = _movement()
        place = np.array(self.box.position)
        ahead = np.array([np.cos(self.box.yaw), np.sin(self.box.yaw), 0.0])
        shift = np.linspace(0.0, push_lift_box.PUSH_LENGTH, 3)[:, None] * ahead
        radius = np.array([np.linalg.norm(self.box.size)])
        boxes = np.concatenate([place + shift, [self.goal.position]])[:, None]
        pushing = movement.push.paths(self.push[::_PUSH_STRIDE])
        start = movement.approach.paths(self.start[None])
        spheres = movement.push.spheres.radius
        shared = [(boxes, radius, _BOX_CLEARANCE), (start, spheres, START_CLEARANCE)]
        if legs is None:
            shown = movement.lift.demonstrations[:, -1].mean(axis=0)
            end = reach_points(np.asarray(self.goal.position), movement.held, shown[None])
            shared.append((pushing, spheres, START_CLEARANCE))
            if not np.isnan(end).any():
                raised = movement.lift.paths(end)
                shared.append((raised, movement.lift.spheres.radius, START_CLEARANCE))
        else:
            enough = clearance + _SLACK
            shared.append((pushing, spheres, enough))
            for leg, trajectory in zip((movement.approach, movement.lift), legs, strict=True):
                path = leg.paths(trajectory[::_REFERENCE_STRIDE], leg.swept)
                shared.append((path, leg.spheres.radius[leg.swept], enough))

        paths = [(SweptPath.of(centers, radius), enough) for centers, radius, enough in shared]

        def test(rows: FloatArray) -> BoolArray:
            kept = np.ones(len(rows), np.bool_)
            for path, enough in paths:
                kept[kept] = path.clear(rows[kept], enough)
            return kept

        return test

    def trials(self, rng: np.random.Generator) -> list[FloatArray]:
        """Return paths of fresh proposals on both legs, their means first."""
        movement = _movement()
        members = self.members(_TRIALS, 0, rng)
        legs = (movement.approach, movement.lift)
        return [free_paths(leg, of_leg) for leg, of_leg in zip(legs, members, strict=True)]

    def reference(
        self, families: tuple[LegFamily, LegFamily], rng: np.random.Generator
    ) -> list[FloatArray] | None:
        """Return approach and lift (T, 6) rad of a random feasible reference, checked densely."""
        movement = _movement()
        box = np.array([to_row(_standing(self.box))])
        none = np.empty((0, kernels.OBSTACLE_COLUMNS))
        if not is_witness(
            movement.push, self.push, _TABLE_ROWS, none, 0.0, movement.approach.steps
        ):
            return None
        parts = []
        for family, bodies in zip(
            families, (np.concatenate([_TABLE_ROWS, box]), _TABLE_ROWS), strict=True
        ):
            leg = family.leg
            for index in rng.permutation(np.flatnonzero(family.able))[:_REFERENCES]:
                trajectory = leg.trajectories(family.members[index : index + 1])[0]
                if is_witness(leg, trajectory, bodies, none, 0.0, leg.steps):
                    parts.append(trajectory)
                    break
            else:
                return None
        return parts

    def is_clear(self, legs: list[FloatArray], rows: FloatArray, clearance: float) -> bool:
        """Return whether obstacles (M, 9) leave a reference its clearance, checked densely."""
        movement = _movement()
        parts = zip(
            (movement.approach, movement.push, movement.lift),
            (legs[0], self.push, legs[1]),
            strict=True,
        )
        return all(bool(part.swept_path(path).clear(rows, clearance).all()) for part, path in parts)


def _standing(box: ManipulatedObject) -> Obstacle:
    """Return a box that stands on the table, as a body."""
    assert box.position is not None
    half = box.yaw / 2
    quaternion = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
    return Obstacle(shape="box", position=box.position, quaternion=quaternion, size=box.size)


def _around(
    radius: tuple[float, float], bearing: tuple[float, float], rng: np.random.Generator
) -> tuple[float, float, float]:
    """Draw a place about the base: x and y in m, and its bearing in rad."""
    far, turn = rng.uniform(*radius), rng.uniform(*bearing)
    return float(far * np.cos(turn)), float(far * np.sin(turn)), turn


def _draw_box(rng: np.random.Generator) -> ManipulatedObject:
    """Draw a box that stands on the table."""
    x, y, bearing = _around(push_lift_box.BOX_RADIUS, push_lift_box.BOX_BEARING, rng)
    yaw = bearing + rng.uniform(-push_lift_box.BOX_TURN, push_lift_box.BOX_TURN)
    return ManipulatedObject(position=(x, y, ManipulatedObject().size[2]), yaw=float(yaw))


def _draw_target(rng: np.random.Generator) -> Goal:
    """Draw a point in the air."""
    x, y, _ = _around(push_lift_box.TARGET_RADIUS, push_lift_box.TARGET_BEARING, rng)
    return Goal(kind="lift", position=(x, y, float(rng.uniform(*push_lift_box.TARGET_HEIGHT))))


def _draw(difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw a box, a target, a start, obstacles and a witness; None if they do not fit together."""
    return _draw_scene(difficulty, rng, witnessed=True)


def _place(difficulty: str, rng: np.random.Generator) -> Draw | None:
    """Draw a box, a target, a start and obstacles; None if too few trajectories are blocked."""
    return _draw_scene(difficulty, rng, witnessed=False)


def _draw_scene(difficulty: str, rng: np.random.Generator, *, witnessed: bool) -> Draw | None:
    box, goal = _draw_box(rng), _draw_target(rng)
    spread = np.asarray(push_lift_box.START_SPREAD)
    start = np.asarray(push_lift_box.START_CONFIGURATION) + rng.uniform(-spread, spread)
    specification = SPECIFICATIONS[difficulty]
    episode = _Episode(start, box, _push(_movement(), box), goal)
    crowd = specification.obstacles > 0
    families = episode.families(*((_PROPOSALS, _WIDE_MEMBERS) if crowd else (_ALONE, 0)), rng)
    if not (families[0].free[0] and families[1].free[0]):
        return None
    legs = episode.reference(families, rng)
    if legs is None:
        return None
    witness = np.concatenate([legs[0], episode.push[1:], legs[1][1:]]) if witnessed else None
    if not crowd:
        none = np.empty((0, kernels.OBSTACLE_COLUMNS))
        return Draw(start, (goal,), none, witness, box)
    clearance, count, free_share = CROWDS[difficulty]
    if not witnessed:
        count, free_share = PLACED[difficulty]
    keeps = episode.keeps(legs if witnessed else None, clearance)
    trials = episode.trials(rng)
    for _ in range(_CANDIDATE_SETS):
        bodies = draw_on_legs(families, rng)
        rows = grown(bodies, keeps) if witnessed else grown_partly(bodies, keeps, rng)
        choice = choose_on_legs(rows, families, count)
        if choice is None:
            continue
        chosen = rows[choice]
        left = [left_free(f.leg, t, chosen) for f, t in zip(families, trials, strict=True)]
        if (left[0][0] and left[1][0]) or left[0].mean() * left[1].mean() > free_share:
            continue
        if not witnessed or episode.is_clear(legs, chosen, clearance):
            return Draw(start, (goal,), chosen, witness, box)
    return None


SAMPLER = SceneSampler(_draw, _place)
