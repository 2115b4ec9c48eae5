"""The planning problem, `Problem`, and the protocol of planners, `Planner`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray, checked_array
from smp_gym.robot.kinematics import SphereSet
from smp_gym.scene import Obstacle
from smp_planner.collision.robot_model import RobotModel, jaco_model, jaco_of_spheres
from smp_planner.occupancy.point_cloud import CloudMap
from smp_planner.planning.bodies import Body
from smp_planner.planning.clock import Clock
from smp_planner.planning.constraints import Constraint, Exactly
from smp_planner.planning.maps import WORKSPACE
from smp_planner.planning.robot_body import RobotBody
from smp_planner.planning.tool_constraints import Poses, Reaching, ToolPath
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint, ViaPose

if TYPE_CHECKING:
    from smp_planner.planning.plan import Plan

__all__ = ["Planner", "Problem", "Stage", "arm_problem", "arm_stage", "difference_of_robots"]

_Kind = TypeVar("_Kind")


_KINEMATICS = (
    "base",
    "joint_origins",
    "prismatic",
    "end_effector",
    "lower",
    "upper",
    "velocity",
)
"""What tells robots apart; what they carry may differ."""


def difference_of_robots(first: RobotModel, second: RobotModel) -> str:
    """Return in which of its arrays one robot differs from another; empty if it is the same."""
    for name in _KINEMATICS:
        if not np.array_equal(getattr(first, name), getattr(second, name)):
            return name
    return ""


@dataclass(frozen=True, eq=False)
class Stage:
    """A stretch of the trajectory, with the body and obstacles that must stay clear meanwhile.

    Attributes:
        first: phase at which it begins.
        last: phase at which it ends.
        body: all that moves: the arm, and what moves with the hand.
        obstacles: all that it must not touch.
        cloud: map of a point cloud that it must not touch either.

    Raises:
        ValueError: the phases do not lie in [0, 1], or are not in order.
    """

    first: float
    last: float
    body: Body
    obstacles: tuple[Obstacle, ...]
    cloud: CloudMap | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.first < self.last <= 1.0:
            raise ValueError(f"a Stage must lie in [0, 1], got {self.first} to {self.last}")

    def steps(self, count: int) -> slice:
        """Return the slice of `count` equal steps of phase that covers the stage, ends included."""
        last = count - 1
        # The margin is for phases that rounding puts just beyond a step.
        begin = int(np.floor(self.first * last + 1e-9))
        return slice(begin, int(np.ceil(self.last * last - 1e-9)) + 1)


@dataclass(frozen=True, eq=False)
class Problem:
    """A planning problem: body, constraints, and obstacles by stages.

    Attributes:
        body: what moves, with all that it carries in the end.
        constraints: on the trajectory, in the order in which the prior is conditioned.
        stages: bodies and obstacles by stretches of the phase, at least one.
        seed: from which all randomness of the plan is drawn.
        movable: those obstacles that are no fixtures of the task; on which side of them
            trajectories pass tells homotopy classes apart.
        clock: when a robot executes the trajectory; what is before its phase is done, and neither
            costs anything nor is checked.
        turns: rad/s, at which the velocities of obstacles turn; those that are missing go straight.
        foresight: s after the observation, until when trajectories are checked against obstacles
            that move; later they are costs only, to be looked at again by then.
        done: (S, D) samples of what is done, at the steps of a plan; None if nothing is.
        doubt: m, standard deviation of where obstacles stand: costs keep by so much farther away.

    Raises:
        ValueError: no stage, or `doubt` is negative or not finite.
    """

    body: Body
    constraints: tuple[Constraint, ...]
    stages: tuple[Stage, ...]
    seed: int = 0
    movable: tuple[Obstacle, ...] = ()
    clock: Clock = Clock()  # noqa: RUF009
    turns: Mapping[Obstacle, tuple[float, ...]] = field(default_factory=dict)
    foresight: float = math.inf
    done: FloatArray | None = None
    doubt: float = 0.0

    def __post_init__(self) -> None:
        if not self.stages:
            raise ValueError("Problem.stages must hold at least one Stage, got none")
        if not (math.isfinite(self.doubt) and self.doubt >= 0.0):
            raise ValueError(
                f"Problem.doubt must be finite and not negative, m, got {self.doubt!r}"
            )

    @property
    def pins(self) -> FloatArray:
        """Phases at which trajectories are held: both ends and the constraints'; ascending."""
        held = [phase for constraint in self.constraints for phase in constraint.phases]
        return np.unique(np.round([0.0, 1.0, *held], 9))

    def ahead(self, stage: Stage, count: int) -> slice:
        """Return the slice of `count` equal steps of a stage that are not done; it may be empty."""
        steps = stage.steps(count)
        if self.clock.phase == 0.0:
            return steps
        begin = max(steps.start, self.clock.first(count))
        return slice(begin, steps.stop if steps.stop - begin > 1 else begin)

    def rest(self, count: int) -> slice:
        """Return the slice of `count` equal steps of the trajectory that are not done."""
        return slice(self.clock.first(count) if self.clock.phase > 0.0 else 0, None)

    @property
    def robot(self) -> RobotModel:
        """The robot that moves.

        Raises:
            ValueError: no robot moves here.
        """
        if not isinstance(self.body, RobotBody):
            raise ValueError(f"Problem.body must be a robot here, got {self.body!r}")
        return self.body.model

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """Obstacles of the last stage."""
        last = [stage.obstacles for stage in self.stages if stage.last == 1.0]
        return tuple(dict.fromkeys(obstacle for of_stage in last for obstacle in of_stage))

    @property
    def cloud(self) -> CloudMap | None:
        """Map of a point cloud; where there is one, it is the same in all stages."""
        return self.stages[-1].cloud

    @property
    def start(self) -> FloatArray:
        """(D,) where the trajectory begins for certain.

        Raises:
            ValueError: it is not certain.
        """
        for constraint in self._of(Exactly):
            if constraint.phase == 0.0 and not constraint.derivative:
                return constraint.value
        raise ValueError("Problem.constraints must hold an exact start here, got none")

    @property
    def goals(self) -> tuple[GoalRegion, ...]:
        """Regions for the tool at the end; none if there is no such constraint."""
        return tuple(goal for constraint in self._of(Reaching) for goal in constraint.goals)

    @property
    def via_points(self) -> tuple[ToolViaPoint, ...]:
        """Via-points of the tool, in their order."""
        return tuple(via for constraint in self._of(ToolPath) for via in constraint.via_points)

    @property
    def via_poses(self) -> tuple[ViaPose, ...]:
        """Via-poses of the hand, in their order."""
        return tuple(via for constraint in self._of(Poses) for via in constraint.via_poses)

    def _of(self, kind: type[_Kind]) -> list[_Kind]:
        return [constraint for constraint in self.constraints if isinstance(constraint, kind)]


def arm_stage(
    first: float,
    last: float,
    spheres: SphereSet,
    obstacles: tuple[Obstacle, ...],
    cloud: CloudMap | None = None,
) -> Stage:
    """Return a stage of the JACO.

    Args:
        first: phase at which it begins.
        last: phase at which it ends.
        spheres: all that move: of the arm, and what moves with the hand.
        obstacles: all that these must not touch.
        cloud: map of a point cloud that these must not touch either.
    """
    return Stage(first, last, RobotBody(jaco_of_spheres(spheres), WORKSPACE), obstacles, cloud)


def arm_problem(
    start: ArrayLike,
    obstacles: tuple[Obstacle, ...],
    attached: SphereSet,
    goals: tuple[GoalRegion, ...],
    seed: int,
    *,
    via_points: tuple[ToolViaPoint, ...] = (),
    via_poses: tuple[ViaPose, ...] = (),
    stages: tuple[Stage, ...] = (),
    movable: tuple[Obstacle, ...] = (),
    cloud: CloudMap | None = None,
    traced: int | None = None,
) -> Problem:
    """Return the problem of a JACO that moves from rest to rest.

    Args:
        start: (6,) rad, the configuration in which the trajectory begins.
        obstacles: all that must not be touched: obstacles and the task's fixtures.
        attached: spheres that move rigidly with the last link: fingers and held object.
        goals: at least one region; ending in any of them will do.
        seed: from which all randomness of the plan is drawn.
        via_points: to be passed, in the order of their phases.
        via_poses: to be taken, in the order of their phases.
        stages: where it changes on the trajectory what must stay clear of what; by default the arm
            with all that is attached must stay clear of all obstacles throughout.
        movable: see `Problem`.
        cloud: map of a point cloud that must not be touched either; stages have their own.
        traced: recorded points by which via-points are passed, see `ToolPath`.

    Raises:
        ValueError: `start` is not (6,) finite numbers, there is no goal, or `traced` is neither
            None nor a whole number from 2 on.
    """
    model = jaco_model(attached)
    body = RobotBody(model, WORKSPACE)
    rest = np.zeros(model.joints)
    constraints: list[Constraint] = [
        Exactly("start", 0.0, checked_array("start", start, (model.joints,))),
        Exactly("rest at the start", 0.0, rest, derivative=True),
        Exactly("rest at the end", 1.0, rest, derivative=True),
    ]
    if via_poses:
        constraints.append(Poses(via_poses, model))
    if via_points:
        constraints.append(ToolPath(via_points, model, traced=traced))
    constraints.append(Reaching(goals, model))
    return Problem(
        body,
        tuple(constraints),
        stages or (Stage(0.0, 1.0, body, obstacles, cloud),),
        seed,
        movable,
    )


@runtime_checkable
class Planner(Protocol):
    """Protocol of planners."""

    def plan(self, problems: Sequence[Problem]) -> list[Plan]:
        """Return one plan for each problem; the same problem gives the same plan."""
        ...
