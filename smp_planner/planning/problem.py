"""What a planner is asked and what it answers: `Problem`, `Plan` and the `Planner` protocol."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from smp_gym.robot.kinematics import SphereSet
from smp_gym.scene import Obstacle
from smp_planner.planning.modes import Modes, best_of_each, group

__all__ = ["GoalRegion", "Plan", "Planner", "Problem", "Stage", "ViaPoint", "ViaPose"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def _checked(name: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(value, np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array}")
    return array


@dataclass(frozen=True)
class GoalRegion:
    """A box in which a point carried by the hand must be when the trajectory ends.

    Attributes:
        point: (3,) m, fixed in the end-effector frame (for Placement, the object's centre).
        lower: (3,) m, lower corner of the box in the base frame.
        upper: (3,) m, upper corner.
    """

    point: FloatArray
    lower: FloatArray
    upper: FloatArray

    def __post_init__(self) -> None:
        for name in ("point", "lower", "upper"):
            value = _checked(f"GoalRegion.{name}", getattr(self, name), (3,))
            object.__setattr__(self, name, value)
        if not (self.lower <= self.upper).all():
            raise ValueError(f"GoalRegion.lower {self.lower} must not exceed upper {self.upper}")

    @property
    def center(self) -> FloatArray:
        """(3,) m, middle of the box."""
        return (self.lower + self.upper) / 2


@dataclass(frozen=True)
class ViaPose:
    """A pose that the hand must take at a phase.

    Attributes:
        phase: in [0, 1].
        pose: (4, 4) of the end effector in the base frame.
        rest: whether the arm stands still there.
    """

    phase: float
    pose: FloatArray
    rest: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.phase <= 1.0:
            raise ValueError(f"ViaPose.phase must lie in [0, 1], got {self.phase}")
        object.__setattr__(self, "pose", _checked("ViaPose.pose", self.pose, (4, 4)))


@dataclass(frozen=True)
class Stage:
    """A stretch of the trajectory, and what must stay clear of what meanwhile.

    Attributes:
        first: phase at which it begins.
        last: phase at which it ends.
        spheres: all that move: of the arm, and what moves with the hand.
        obstacles: all that these must not touch.
    """

    first: float
    last: float
    spheres: SphereSet
    obstacles: tuple[Obstacle, ...]

    def __post_init__(self) -> None:
        if not 0.0 <= self.first < self.last <= 1.0:
            raise ValueError(f"a Stage must lie in [0, 1], got {self.first} to {self.last}")

    def steps(self, count: int) -> slice:
        """Return which of `count` equal steps of phase cover the stage, its ends included."""
        last = count - 1
        # The margin is for phases that rounding puts a hair beyond a step.
        begin = int(np.floor(self.first * last + 1e-9))
        return slice(begin, int(np.ceil(self.last * last - 1e-9)) + 1)


@dataclass(frozen=True)
class ViaPoint:
    """A place that a point carried by the hand must pass at about a phase.

    Attributes:
        phase: in [0, 1].
        point: (3,) m, fixed in the end-effector frame (for DrawS, the pen's tip).
        position: (3,) m, of the place in the base frame.
        tolerance: m, how near the point must come.
    """

    phase: float
    point: FloatArray
    position: FloatArray
    tolerance: float

    def __post_init__(self) -> None:
        for name in ("point", "position"):
            value = _checked(f"ViaPoint.{name}", getattr(self, name), (3,))
            object.__setattr__(self, name, value)
        if not 0.0 <= self.phase <= 1.0:
            raise ValueError(f"ViaPoint.phase must lie in [0, 1], got {self.phase}")
        if not self.tolerance > 0.0:
            raise ValueError(f"ViaPoint.tolerance must be positive, got {self.tolerance}")


@dataclass(frozen=True)
class Problem:
    """One scene to plan in.

    Attributes:
        start: (6,) rad, the configuration in which the trajectory begins.
        obstacles: all that must not be touched: obstacles and the task's fixtures.
        attached: spheres that move rigidly with the last link: fingers and held object.
        goals: at least one region; ending in any of them will do.
        seed: from which all randomness of the plan is drawn.
        via_points: to be passed on the way, in the order of their phases.
        via_poses: poses on the way, in the order of their phases.
        stages: what must stay clear of what at which phases, where that changes on the way; empty
            if the arm with all that is attached must stay clear of all obstacles throughout.
        movable: those of `obstacles` that are no fixtures of the task; on which side of them
            trajectories pass tells modes apart.
    """

    start: FloatArray
    obstacles: tuple[Obstacle, ...]
    attached: SphereSet
    goals: tuple[GoalRegion, ...]
    seed: int
    via_points: tuple[ViaPoint, ...] = ()
    via_poses: tuple[ViaPose, ...] = ()
    stages: tuple[Stage, ...] = ()
    movable: tuple[Obstacle, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", _checked("Problem.start", self.start, (6,)))
        if not self.goals:
            raise ValueError("Problem.goals must hold at least one GoalRegion, got none")


@dataclass(frozen=True)
class Plan:
    """A set of P particles, each a whole trajectory, and what is known of each.

    Attributes:
        weights: (P, K, D) weights of the primitive; T and D below as in `trajectories`.
        trajectories: (P, T, D) rad, at equal steps of phase.
        costs: unweighted cost of each particle by name, each (P,).
        collision_free: (P,) whether a dense check on the exact map finds no collision.
        clearance: (P,) m, least distance to anything in the exact map (negative inside).
        goal_error: (P,) m, distance of the end point to the nearest goal region (0 inside).
        duration: (P,) s, shortest execution within the joint velocity limits.
        executable: (P,) whether joint limits hold and `duration` is within the planner's limit.
        chosen: index of the particle to execute.
        timings: seconds of each stage by name, in order.
        message: empty, or why no particle is good.
        components: (P,) index of the component of the prior that each particle belongs to; None
            where there is but one.
        passing: (P,) whether all via-points are passed; where there are none, True.
        signatures: (P, 1 + 2 M) which way each goes: the index of the goal region that it ends
            nearest to, then winding and level at each of the M obstacles of `Problem.movable`, as
            in `modes.signatures_3d`; None where nobody has looked.
        ranks: (P,) place of each in the order in which the planner prefers them, 0 for `chosen`;
            None where nobody has looked.
    """

    weights: FloatArray
    trajectories: FloatArray
    costs: Mapping[str, FloatArray]
    collision_free: BoolArray
    clearance: FloatArray
    goal_error: FloatArray
    duration: FloatArray
    executable: BoolArray
    chosen: int
    timings: Mapping[str, float] = field(default_factory=dict)
    message: str = ""
    components: NDArray[np.int64] | None = None
    passing: BoolArray = field(default_factory=lambda: np.ones(1, np.bool_))
    signatures: IntArray | None = None
    ranks: IntArray | None = None

    @property
    def good(self) -> BoolArray:
        """(P,) whether a particle is collision-free, executable and passes all via-points."""
        return self.collision_free & self.executable & self.passing

    @property
    def modes(self) -> Modes:
        """Classes of the good particles by signature, labels in their order; none if none is good.

        Raises:
            ValueError: the plan has no signatures.
        """
        if self.signatures is None:
            raise ValueError("Plan.modes needs Plan.signatures, got None")
        good = self.signatures[self.good]
        if len(good) == 0:
            return Modes(good, np.empty(0, np.int64), np.empty(0))
        return group(good)

    @property
    def best_of_modes(self) -> IntArray:
        """(C,) index of the best good particle of each of `modes`.

        Raises:
            ValueError: the plan has no signatures or no ranks.
        """
        if self.ranks is None:
            raise ValueError("Plan.best_of_modes needs Plan.ranks, got None")
        good = np.flatnonzero(self.good)
        return good[best_of_each(self.modes, self.ranks[good])]

    @property
    def planning_time(self) -> float:
        """Seconds of all stages together."""
        return float(sum(self.timings.values()))


@runtime_checkable
class Planner(Protocol):
    """Anything that answers problems with plans; batched over problems."""

    def plan(self, problems: Sequence[Problem]) -> list[Plan]:
        """Return one plan for each problem; the same problem gives the same plan."""
        ...
