"""Stein Movement Primitives from the user's own demonstrations, without any environment.

    primitive = SMP.fit(demonstrations)
    plan = primitive.adapt([Circle((0.5, 0.2), 0.1)], goal=(1.0, 0.3), particles=42, seed=0)
    plan.trajectories, plan.collision_free, plan.best

Paths may be in the plane, in space or of a robot's joints, in any unit: lengths that are no
argument are shares of the demonstrations' extent, see `PriorSettings` and `AdaptSettings`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import (
    FloatArray,
    checked_array,
    checked_count,
    checked_number,
    checked_seed,
    shown,
)
from smp_planner.adaptation import ADAPTATIONS, Adaptation, adaptation
from smp_planner.collision.verification import minimum_duration
from smp_planner.library.adapt_settings import (
    JOINT_SMOOTH_STD,
    PATH_SMOOTH_STD,
    SLIDE_SMOOTH_SHARE,
    AdaptSettings,
)
from smp_planner.library.binding import what_binds
from smp_planner.library.cloud import PointCloud
from smp_planner.library.collision_pairs import with_collision_pairs
from smp_planner.library.frame import Frame
from smp_planner.library.joint_angles import JointAngles, refuse_orientations, unwrapped
from smp_planner.library.link_meshes import link_meshes
from smp_planner.library.modulation import AnyOf, Box, ViaPoint
from smp_planner.library.overdetermined import refuse_overdetermined
from smp_planner.library.reading import demonstrations_of, recordings_of
from smp_planner.library.requests import Request, constraints_of, several
from smp_planner.library.scene import Scene
from smp_planner.library.shapes import Circle, PathObstacle, Rectangle, outline
from smp_planner.library.signals import Recorded
from smp_planner.library.storing import read_primitive, write_primitive
from smp_planner.library.urdf import Robot
from smp_planner.movement_primitives import ProMP, ProMPMixture
from smp_planner.planners.rrt_connect.planner import RRTConnectSettings, rrt_connect_plan
from smp_planner.planning.constraints import Exactly
from smp_planner.planning.pipeline import checked_deadline, checked_history, plan_problems
from smp_planner.planning.plan import Plan
from smp_planner.planning.prior import learn_prior
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import MOST_PARTICLES, PlanSettings, PriorSettings
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint
from smp_planner.planning.tool_orientations import Cone, Orientation
from smp_planner.torch_threads import one_thread

__all__ = [
    "SMP",
    "AdaptSettings",
    "AnyOf",
    "Box",
    "Circle",
    "Cone",
    "GoalRegion",
    "Orientation",
    "Plan",
    "PointCloud",
    "PriorSettings",
    "Rectangle",
    "Robot",
    "ToolViaPoint",
    "ViaPoint",
]


_LOGGER = logging.getLogger(__name__)

_DURATION_SLACK = 2.0
"""Shortest durations of the slowest demonstration within which its plans must be feasible."""


class SMP:
    """A movement primitive learned from demonstrations, to be adapted to scenes.

    Made by `SMP.fit` or `SMP.load`.

    Args:
        demonstrations: N arrays (T_j, D), at least two, at equal steps of phase.
        settings: how to learn from them.
        robot: of whose joints they are; None for paths in the plane or in space.
        recorded: what was recorded beside their coordinates; None for nothing.

    Attributes:
        demonstrations: what it was learned from; angles of continuous joints are unwrapped.
        durations: (N,) of the demonstrations, in the unit of their times, s if those are; None if
            there were no times.
        signals: by name, what else the demonstrations recorded, as functions of phase.
        settings: how it was learned.
        robot: as above, with the pairs of spheres that must stay clear of each other.
        frame: the normalised coordinates that the primitives live in.
        prior: what it teaches, in these coordinates.
    """

    def __init__(
        self,
        demonstrations: Sequence[FloatArray],
        settings: PriorSettings,
        robot: Robot | None = None,
        recorded: Recorded | None = None,
    ) -> None:
        demonstrations = tuple(demonstrations)
        self._recorded = Recorded() if recorded is None else recorded
        self.durations = self._recorded.durations
        self.signals = self._recorded.signals()
        self.settings = settings
        dimension = demonstrations[0].shape[1]
        self._angles = None
        if robot is None:
            refuse_orientations(demonstrations)
        else:
            if robot.dimension != dimension:
                raise ValueError(
                    f"demonstrations of a robot with {robot.dimension} joints must have as many "
                    f"coordinates, got {dimension}"
                )
            JointAngles(robot, demonstrations).check_demonstrations(continuous=False)
            demonstrations = unwrapped(demonstrations, robot)
            robot = replace(robot, model=with_collision_pairs(robot, demonstrations))
            self._angles = JointAngles(robot, demonstrations)
            self._angles.check_demonstrations()
        self.demonstrations = demonstrations
        self.robot = robot
        self.frame = _frame(self.demonstrations, robot)
        self.prior = learn_prior([self.frame.inwards(d) for d in self.demonstrations], settings)

    @classmethod
    def fit(
        cls,
        demonstrations: Any,
        robot: Robot | None = None,
        *,
        signals: Any = (),
        durations: Any = None,
        **settings: Any,
    ) -> SMP:
        """Learn a primitive from demonstrations.

        A coordinate that is constant in all of them stays allowed: its variance is the one that is
        added (`PriorSettings.smooth_std`).

        Args:
            demonstrations: (N, T, D), or N arrays (T_j, D), N at least 2, in any one unit, samples
                at equal steps of phase; or a `.npz` or `.csv` file, or a list of such, see
                `smp_planner.library.reading`.
            robot: of whose joints, rad or m, they are; None for paths in the plane or in space.
            signals: names of columns of `.csv` files that are no coordinates, such as the opening
                of a gripper; or by name N arrays (T_j,). They are no part of what is learned, and
                go with its plans as functions of phase: what has two values in all demonstrations
                switches at the mean of the phases at which it does in them, all else is the mean.
            durations: (N,) s, of the demonstrations; by default those of the times in `.csv` files,
                if all have them.
            **settings: see `PriorSettings`; `smooth_std` is 0.1 extents by default, and 0.2 rad for
                a robot. Of a prismatic joint it is a tenth of the range, at most 0.2 m.

        Raises:
            FileNotFoundError: no such file.
            ValueError: a file of another kind, fewer than two demonstrations, not all of one
                dimension or not that of the robot, a number that is not finite, all of them one
                point, more modes than there are demonstrations for, or a signal that is missing or
                switches in one demonstration otherwise than in another.
        """
        if robot is not None and not isinstance(robot, Robot):
            raise ValueError(f"robot must be a Robot, got {shown(robot)}")
        learning = PriorSettings(**{"smooth_std": _smooth_std(robot), **settings})
        joints = None if robot is None else robot.joints
        given, recorded = recordings_of(
            demonstrations,
            joints,
            signals,
            durations,
            nan_is_missing=learning.nan_is_missing,
        )
        return cls(given, learning, robot, recorded)

    def save(self, path: str | Path) -> None:
        """Write an `.npz` file without pickled objects, which `load` reads."""
        write_primitive(path, self.demonstrations, self.settings, self.robot, self._recorded)

    @classmethod
    def load(cls, path: str | Path) -> SMP:
        """Read what `save` wrote; the primitive is learned again from the same demonstrations.

        Raises:
            FileNotFoundError: no such file.
            ValueError: it is damaged, is something else, or is of another version.
        """
        demonstrations, settings, robot, recorded = read_primitive(path)
        given = demonstrations_of(demonstrations, nan_is_missing=settings.nan_is_missing)
        return cls(given, settings, robot, recorded)

    def __repr__(self) -> str:
        """Return a short description, without the arrays."""
        of = f"of {self.robot!r}" if self.robot is not None else f"of D = {self.dimension}"
        modes = len(self.mixture.components)
        return f"SMP({len(self.demonstrations)} demonstrations {of}, {modes} modes)"

    @property
    def single(self) -> ProMP:
        """One Gaussian for all demonstrations."""
        return self.prior.single

    @property
    def mixture(self) -> ProMPMixture:
        """A component for each of the demonstrations' modes."""
        return self.prior.mixture

    @property
    def dimension(self) -> int:
        """D, the number of coordinates."""
        return self.frame.dimension

    @property
    def extent(self) -> float:
        """Length of which those in settings are shares, in the unit of the demonstrations."""
        return self.frame.scale

    def adapt(
        self,
        obstacles: Sequence[PathObstacle] | PathObstacle = (),
        *,
        start: Request | None = None,
        goal: Request | None = None,
        start_velocity: ArrayLike | None = None,
        via_points: Sequence[ViaPoint | ToolViaPoint | AnyOf]
        | ViaPoint
        | ToolViaPoint
        | AnyOf = (),
        radius: float = 0.0,
        particles: int = 42,
        seed: int = 0,
        method: str | Adaptation | RRTConnectSettings = "smp",
        per_component: bool = True,
        settings: AdaptSettings | None = None,
        deadline: float | None = None,
        history: int | None = None,
    ) -> Plan:
        """Return particles of the primitive, adapted to a scene.

        Each of the demonstrations' modes keeps its share of the particles. Positions and lengths
        are in the unit of the demonstrations; for a robot, obstacles are in metres in its base
        frame (`Robot.from_urdf`).

        Args:
            obstacles: `Circle`s and `Rectangle`s in the plane; in space and for a robot
                `smp_gym.scene.Obstacle`s and one `PointCloud`. One may be given alone.
            start: (D,) where to begin, a `Box`, or `AnyOf` such; None leaves it as demonstrated.
                Angles of continuous joints are turned to the branch nearest to demonstrations.
            goal: likewise, where to end; for a robot also a `GoalRegion` of its tool, with any
                orientation or a `Cone` or `Orientation`.
            start_velocity: (D,) in the unit of the demonstrations a second, with which to begin, if
                the motion takes as long as the demonstrations' mean; None leaves it as
                demonstrated. It needs demonstrations with `durations`; `Robot.timed` with the
                same `start_velocity`, and that duration as its `pace`, goes on from there.
            via_points: what to pass in between, of a robot also `ToolViaPoint`s; `AnyOf` several
                of one phase for a choice.
            radius: of the ball that moves; 0 is a point. A robot has none.
            particles: how many, P.
            seed: of all randomness; the same call gives the same plan.
            method: one of `smp_planner.adaptation.ADAPTATIONS`, by name or as such; "promp" only
                conditions the primitive. Of a robot also "rrt_connect" or its
                `RRTConnectSettings`: paths that are searched from `start` to `goal` through all
                via-points, whatever was demonstrated, with postures of the tool's places from
                random starts.
            per_component: whether each mode of the demonstrations is adapted on its own; if not,
                one Gaussian stands for all of them, as the paper's baselines have it.
            settings: map and costs. For a robot, a `duration_limit` that is not given is twice the
                shortest duration of the slowest demonstration, and 15 s at least.
            deadline: s from the call, until when to adapt; the plan then depends on the machine.
                The map is made whole, so much it may be late; see
                `smp_planner.planning.pipeline.plan_problems`. None by default.
            history: iterations after which particles are kept on their way, each time as a plan in
                `Plan.history`, which `Plan.watch` has a slider for; None keeps none. The plan is
                the same in any case. Needs the method "smp", and no deadline.

        Raises:
            ValueError: an argument out of range, of another dimension than the demonstrations, or
                contradicting another; more exact places than basis functions, or such that swing
                the path far out between them; a start, goal or via-point beyond a joint's limits
                by more than 1e-6 rad or m; a start, goal or via-point inside an obstacle; or a
                place of the tool that the robot does not reach, or not with its orientation.
        """
        begin = time.perf_counter()
        settings = AdaptSettings() if settings is None else settings
        if not isinstance(settings, PlanSettings):
            raise ValueError(f"settings must be AdaptSettings, got {shown(settings)}")
        search = _search(method)
        if search is not None:
            self._refuse_of_search(start_velocity, per_component, deadline, history)
        how = _adaptation("promp" if search is not None else method)
        deadline, history = checked_deadline(deadline, how), checked_history(history, how)
        particles = checked_count("particles", particles, most=MOST_PARTICLES)
        update = {"particles": particles, "duration_limit": self._duration_limit(settings)}
        settings = settings.model_copy(update=update)
        seed, radius = checked_seed(seed), checked_number("radius", radius, least=0.0)
        obstacles = several("obstacles", obstacles, get_args(PathObstacle))
        if not isinstance(per_component, bool | np.bool_):
            raise ValueError(f"per_component must be True or False, got {shown(per_component)}")
        via_points = several("via_points", via_points, (ViaPoint, ToolViaPoint, AnyOf))
        constraints = constraints_of(
            self.frame, start, via_points, goal, settings.sigma, self._angles
        )
        if start_velocity is not None:
            moving = self._moving_at_the_start(start_velocity, settings)
            constraints = tuple(sorted((*constraints, moving), key=lambda c: c.phases[0]))
        if search is None:
            with one_thread():
                shown_paths = [self.frame.inwards(d) for d in self.demonstrations]
                refuse_overdetermined(self.prior.single, constraints, shown_paths)
        reading = time.perf_counter()
        with one_thread():
            scene = Scene(self.frame, self.robot, obstacles, radius)
            scene.refuse_blocked(constraints, settings, self.demonstrations)
            problem = scene.problem(constraints, settings, seed, self.demonstrations)
        reading = time.perf_counter() - reading
        if search is not None:
            plan = rrt_connect_plan(problem, search, settings)
            _warn_of_duration(plan, settings.duration_limit)
            plan = self._explained(plan, problem, scene, settings)
            return self._outwards(plan, obstacles, reading)
        prior = self.prior
        if not per_component:
            single = prior.settings.model_copy(update={"per_component": False})
            prior = replace(prior, settings=single)
        if deadline is not None:
            # What is over already leaves the least time there is.
            deadline = max(deadline - (time.perf_counter() - begin), 1e-6)
        (plan,) = plan_problems([problem], prior, how, settings, deadline=deadline, history=history)
        if self.robot is not None:
            _warn_of_duration(plan, settings.duration_limit)
        plan = self._explained(plan, problem, scene, settings)
        return self._outwards(plan, obstacles, reading)

    def _explained(
        self, plan: Plan, problem: Problem, scene: Scene, settings: PlanSettings
    ) -> Plan:
        """Return a plan whose message says what binds, if no particle is good."""
        if not plan.message:
            return plan
        binding = what_binds(problem, plan.best, settings, self.frame, self.robot, scene.order)
        return plan.changed(message=f"{plan.message}: it {binding}") if binding else plan

    def _refuse_of_search(
        self,
        start_velocity: ArrayLike | None,
        per_component: bool,
        deadline: float | None,
        history: int | None,
    ) -> None:
        """Raise a ValueError for what a search for paths does not do."""
        if self.robot is None:
            raise ValueError("method 'rrt_connect' needs a primitive of a robot, got one of paths")
        for name, given, allowed in (
            ("start_velocity", start_velocity, None),
            ("per_component", per_component, True),
            ("deadline", deadline, None),
            ("history", history, None),
        ):
            if given is not allowed:
                raise ValueError(
                    f"{name} must be {allowed} for the method 'rrt_connect', got {shown(given)}"
                )

    def _moving_at_the_start(self, velocity: ArrayLike, settings: PlanSettings) -> Exactly:
        """Return the constraint that a path begins with a velocity."""
        given = checked_array("start_velocity", velocity, (self.dimension,))
        if self.durations is None:
            raise ValueError(
                "start_velocity needs the demonstrations' durations, by which phase runs in time: "
                "give durations= to SMP.fit, or recordings with times"
            )
        if settings.modulation != "exact":
            raise ValueError(
                f"start_velocity needs the modulation 'exact', got {settings.modulation!r}"
            )
        slope = self.frame.lengths_inwards(given) * float(np.mean(self.durations))
        return Exactly("start_velocity", 0.0, slope, derivative=True)

    def _duration_limit(self, settings: PlanSettings) -> float:
        """Return the limit of duration, s: as given, or no less than demonstrations allow."""
        if self.robot is None or "duration_limit" in settings.model_fields_set:
            return settings.duration_limit
        velocity = self.robot.model.velocity
        # A gap of NaN takes as long as its ends are apart.
        finite = [d[np.isfinite(d).all(axis=1)] for d in self.demonstrations]
        shortest = [float(minimum_duration(d[None], velocity)[0]) for d in finite if len(d) > 1]
        return max(settings.duration_limit, _DURATION_SLACK * max(shortest, default=0.0))

    def _outwards(self, plan: Plan, obstacles: Sequence[PathObstacle], reading: float) -> Plan:
        """Return a plan in the unit of the demonstrations, with what is drawn beside it."""
        scale = self.frame.scale
        planar = [o for o in obstacles if isinstance(o, Circle | Rectangle)]
        timings = dict(plan.timings)
        timings["map"] = timings.get("map", 0.0) + reading
        return replace(
            plan,
            trajectories=self.frame.outwards(plan.trajectories),
            clearance=scale * plan.clearance,
            signals=self.signals,
            missed={name: scale * value for name, value in plan.missed.items()},
            timings=timings,
            history={
                iteration: self._outwards(earlier, obstacles, 0.0)
                for iteration, earlier in plan.history.items()
            },
            display={
                "demonstrations": self.demonstrations,
                "obstacles": tuple(obstacles),
                "outlines": [outline(obstacle) for obstacle in planar],
                **_display_of(self.robot, self.demonstrations),
            },
            tool_paths=(
                None if self.robot is None else self.robot.tool_positions(plan.trajectories)
            ),
        )


def _warn_of_duration(plan: Plan, limit: float) -> None:
    """Log how many trajectories the limit of duration keeps from being executable."""
    late = int((plan.duration > limit).sum())
    if late:
        _LOGGER.warning(
            "%d of %d trajectories take longer than duration_limit=%g s within the limits of "
            "velocity, up to %.3g s, and do not count as executable: "
            "AdaptSettings(duration_limit=...) gives them more time",
            late,
            len(plan.duration),
            limit,
            float(plan.duration.max()),
        )


def _display_of(robot: Robot | None, demonstrations: Sequence[FloatArray]) -> dict[str, Any]:
    """Return what is drawn of a robot's demonstrations and joints, by name."""
    if robot is None:
        return {}
    return {
        "tool_demonstrations": [robot.tool_positions(path) for path in demonstrations],
        "joints": robot.joints,
        "model": robot.model,
        "meshes": partial(link_meshes, robot),
    }


def _smooth_std(robot: Robot | None) -> float | tuple[float, ...]:
    """Return the standard deviation that is added by default, of all coordinates or of each."""
    if robot is None:
        return PATH_SMOOTH_STD
    model = robot.model
    if not model.prismatic.any():
        return JOINT_SMOOTH_STD
    share = np.minimum(SLIDE_SMOOTH_SHARE * (model.upper - model.lower), JOINT_SMOOTH_STD)
    return tuple(np.where(model.prismatic, share, JOINT_SMOOTH_STD).tolist())


def _frame(demonstrations: Sequence[FloatArray], robot: Robot | None) -> Frame:
    """Return the coordinates in which the longest side of a box around all of them is 1."""
    lower = np.min([np.nanmin(d, axis=0) for d in demonstrations], axis=0)
    upper = np.max([np.nanmax(d, axis=0) for d in demonstrations], axis=0)
    scale = float((upper - lower).max())
    if scale == 0.0:
        raise ValueError(f"demonstrations must not all stand at one point, got {lower}")
    if robot is not None:
        return Frame(np.zeros(len(lower)), 1.0)
    return Frame((lower + upper) / 2, scale)


def _search(method: Any) -> RRTConnectSettings | None:
    """Return the settings of a search for paths; None for an adaptation of the primitive."""
    if isinstance(method, str) and method == "rrt_connect":
        return RRTConnectSettings()
    return method if isinstance(method, RRTConnectSettings) else None


def _adaptation(method: Any) -> Adaptation:
    if isinstance(method, Adaptation):
        return method
    if not isinstance(method, str):
        raise ValueError(f"method must be a name or an Adaptation, got {shown(method)}")
    if method not in ADAPTATIONS:
        names = ", ".join(ADAPTATIONS)
        raise ValueError(
            f"method must be one of {names} and, of a robot, rrt_connect; got {shown(method)}"
        )
    return adaptation(method)
