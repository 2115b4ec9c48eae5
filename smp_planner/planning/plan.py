"""The result of a planner, `Plan`: a set of particles with their costs and the checks of each."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray, IntArray
from smp_gym.optional_packages import require
from smp_planner.planning.modes import Modes, best_of_each, group

__all__ = ["Checks", "Plan"]

_OPEN = ("collision_free", "standing_free", "clearance", "ranks", "signatures")
"""Fields of a `Plan` that may be left open until they are asked for."""


class Checks(Protocol):
    """Checks of a set of particles, done for as many as the choice of the best one needed."""

    @property
    def chosen(self) -> int:
        """Index of the best particle."""
        ...

    @property
    def solved(self) -> bool:
        """Whether the best particle is good."""
        ...

    def complete(self) -> Mapping[str, Any]:
        """Return the fields of `Plan` that were left open, with all particles checked."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """A set of P particles, each a whole trajectory, with their costs and checks.

    Lengths are m and coordinates rad for a robot; for the user's own paths both are in the unit of
    the demonstrations.

    A planner checks the candidates in the order of preference until the best one is certain. The
    rest is checked when it is first asked for: `collision_free`, `standing_free`, `clearance`,
    `ranks`, `signatures` and what follows from them. That takes longer than to read a number, and
    counts in no timing.

    Attributes:
        trajectories: (P, T, D), at equal steps of phase.
        costs: unweighted cost of each particle by name, each (P,); `prior` is -log p(w) but for a
            constant, given what was conditioned on.
        collision_free: (P,) whether an exact check of the whole trajectory finds no collision; of
            a point cloud as far as the map that was learned of it knows, and whether the
            trajectory stays where it does.
        clearance: (P,) least distance to an obstacle, negative inside; infinity without any. What
            is farther from a point cloud than 0.15 (m, or extents) counts as that far. Of obstacles
            that move it is that to where they are expected when the arm is there, less the margin
            of that (`smp_planner.collision.forecast.Forecast`).
        missed: by how much (P,) each constraint is missed by its name ("start", "goal",
            "via_points"); 0 within a box or tolerance. Where the orientation of a robot's tool is
            constrained, too, that by which it is missed has the name with " orientation" added, rad
            (`planning.tool_orientations`).
        passing: (P,) whether all constraints are met.
        duration: (P,) s, shortest execution within the joint velocity limits, of what is not done
            yet; NaN without a robot.
        executable: (P,) whether joint limits hold and `duration` is within the planner's limit.
        ranks: (P,) place of each in the order in which the planner prefers them, 0 the best.
        signatures: (P, 1 + S) homotopy class of each: the index of the goal region that it ends
            nearest to (0 where there is none), then how it passes each of `Problem.movable`: its
            winding in the plane, winding and level in space (`planning.modes`).
        weights: (P, K, D) weights of the primitive; None of a planner that has none.
        components: (P,) index of the component of the prior that each particle belongs to; None
            where there is but one.
        timings: seconds of each stage of planning by name, in order.
        message: empty, or why no particle is good.
        display: what `plot` and `watch` show beside the trajectories, by name.
        tool_paths: (P, T, 3) m, the paths of a robot's tool, where they were asked for.
        standing_free: (P,) as `collision_free`, but for obstacles that move.
        apart: (P,) m, as `clearance`, of obstacles that move alone; None where none does.
        signals: what demonstrations recorded beside coordinates, as functions of phase, by name.
        history: the particles on their way, as plans, by the number of iterations of inference that
            were behind them; 0 are those that inference began with. Empty unless it was asked for.
        state: from which the planner can go on (`smp_planner.planning.replanning`); None if it
            cannot.
    """

    trajectories: FloatArray
    costs: Mapping[str, FloatArray]
    collision_free: BoolArray
    clearance: FloatArray
    missed: Mapping[str, FloatArray]
    passing: BoolArray
    duration: FloatArray
    executable: BoolArray
    ranks: IntArray
    signatures: IntArray
    weights: FloatArray | None = None
    components: IntArray | None = None
    timings: Mapping[str, float] = field(default_factory=dict)
    message: str = ""
    display: Mapping[str, Any] = field(default_factory=dict)
    tool_paths: FloatArray | None = None
    standing_free: BoolArray | None = None
    apart: FloatArray | None = None
    signals: Mapping[str, Callable[[FloatArray], FloatArray]] = field(default_factory=dict)
    history: Mapping[int, Plan] = field(default_factory=dict)
    state: Any = None

    @classmethod
    def pending(cls, checks: Checks, **known: Any) -> Plan:
        """Return a plan whose open fields come from checks when they are asked for.

        Args:
            checks: of the particles.
            known: the other fields.
        """
        plan = cls(**dict.fromkeys(_OPEN), **known)  # type: ignore[arg-type]
        for name in _OPEN:
            del plan.__dict__[name]
        plan.__dict__["_checks"] = checks
        return plan

    def __getattr__(self, name: str) -> Any:
        """Complete the checks when an open field is first asked for."""
        checks = self.__dict__.get("_checks")
        if name not in _OPEN or checks is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        self.__dict__.update(checks.complete())
        return self.__dict__[name]

    def changed(self, **fields: Any) -> Plan:
        """Return the plan with other values of fields, open where this one is."""
        plan = copy.copy(self)
        plan.__dict__.update(fields)
        return plan

    def __repr__(self) -> str:
        """Return a line without the arrays."""
        count, steps, dimension = self.trajectories.shape
        good = "unknown" if "ranks" not in self.__dict__ else int(self.good.sum())
        return (
            f"Plan({count} particles of {steps} x {dimension}, {good} good, "
            f"chosen {self.chosen}, {self.planning_time:.2f} s)"
        )

    @property
    def chosen(self) -> int:
        """Index of the particle to execute, the best."""
        checks: Checks | None = self.__dict__.get("_checks")
        return int(self.ranks.argmin()) if checks is None else checks.chosen

    @property
    def solved(self) -> bool:
        """Whether the chosen particle is good, that is, whether any is."""
        checks: Checks | None = self.__dict__.get("_checks")
        return bool(self.good[self.chosen]) if checks is None else checks.solved

    @property
    def best(self) -> FloatArray:
        """(T, D) trajectory of the chosen particle."""
        return np.asarray(self.trajectories[self.chosen])

    @property
    def good(self) -> BoolArray:
        """(P,) whether a particle is collision-free, executable and meets all constraints."""
        return self.collision_free & self.executable & self.passing

    @property
    def goal_error(self) -> FloatArray:
        """(P,) distance of the end to the nearest goal region; 0 inside, or without a goal."""
        return np.asarray(self.missed.get("goal", np.zeros(len(self.trajectories))))

    @property
    def modes(self) -> Modes:
        """Homotopy classes of the good particles, labels in their order; none if none is good."""
        good = self.signatures[self.good]
        if len(good) == 0:
            return Modes(good, np.empty(0, np.int64), np.empty(0))
        return group(good)

    @property
    def best_of_modes(self) -> IntArray:
        """(C,) index of the best good particle of each of `modes`."""
        good = np.flatnonzero(self.good)
        return good[best_of_each(self.modes, self.ranks[good])]

    @property
    def planning_time(self) -> float:
        """Seconds of all stages together."""
        return float(sum(self.timings.values()))

    def plot(self, axes: Any = None) -> Any:
        """Draw the particles by homotopy class into matplotlib axes, and return these.

        Paths in the plane and in space are drawn as they are, of a robot the paths of its tool,
        with the demonstrations and the obstacles.

        Args:
            axes: to draw into; None makes a figure of its own, ``axes.figure`` of the result.

        Raises:
            ValueError: coordinates of another number, that are not a robot's.
            ModuleNotFoundError: matplotlib is not installed.
        """
        require("bench", "drawing a plan", "matplotlib")
        from smp_planner.planning.plotting import draw_plan

        return draw_plan(self, axes)

    def plot_joints(self) -> Any:
        """Return a matplotlib figure of each coordinate over the phase, with the joint limits.

        Raises:
            ModuleNotFoundError: matplotlib is not installed.
        """
        require("bench", "drawing a plan", "matplotlib")
        from smp_planner.planning.plotting import draw_joints

        return draw_joints(self)

    def watch(self, *, executed: Any = None, host: str = "127.0.0.1", port: int = 8080) -> Any:
        """Show paths in space, or a robot's, in the browser; returns the `viewer.Page`.

        Where the plan has a `history`, a slider shows the particles on their way.

        Args:
            executed: (T, D) trajectory that was executed, shown beside the planned ones; None for
                none.
            host: address that is listened on; "0.0.0.0" lets other machines see the page.
            port: if it is taken, the next free one is.

        Raises:
            ValueError: the paths are neither in space nor of a robot, or `executed` is of another
                dimension than the plan.
            ModuleNotFoundError: viser is not installed.
        """
        from smp_planner.planning.viewer import exhibit_of, show

        return show(exhibit_of(self, executed), host=host, port=port)

    def _repr_png_(self) -> bytes | None:
        """Return the plan as a notebook shows it, a picture; None where matplotlib is missing."""
        try:
            require("bench", "drawing a plan", "matplotlib")
        except ModuleNotFoundError:
            return None
        from smp_planner.planning.plotting import picture

        return picture(self)
