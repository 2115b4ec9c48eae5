"""What an adaptation amounts to: a set of paths, and what is known of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from smp_gym.geometry.registry import REGISTRY
from smp_gym.scene import Obstacle
from smp_planner.library.drawing import draw
from smp_planner.library.shapes import Circle, PathObstacle, Rectangle
from smp_planner.planning.modes import Modes, group, signatures_2d, signatures_3d

__all__ = ["PathPlan"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class PathPlan:
    """P adapted paths, in the unit of the demonstrations.

    Attributes:
        trajectories: (P, T, D), at equal steps of phase.
        weights: (P, K, D) of the primitive, in its normalised coordinates.
        costs: unweighted cost of each particle by name, each (P,); `prior` is -log p(w) but for a
            constant, given what was conditioned on.
        collision_free: (P,) whether nothing is touched, between samples, too; of a `PointCloud` as
            far as the map that was learned of it knows, and whether the path stays where it does.
        clearance: (P,) least distance to an obstacle, negative inside; infinity without obstacles.
            What is farther from a `PointCloud` than 0.15 extents (m for a robot) is said to be
            that far.
        executable: (P,) whether limits of joints and velocities hold; True without a robot.
        duration: (P,) s, shortest execution; NaN without a robot.
        missed: by how much (P,) each particle misses what was asked for, by its name: "start",
            "goal", "via_points[0]" and so on; 0 within a box or tolerance.
        passing: (P,) whether nothing is missed by more than the settings' `sigma`.
        components: (P,) mode of the demonstrations that each particle belongs to.
        chosen: index of the likeliest particle under the posterior, of the good ones if there are.
        timings: seconds of each stage by name.
        message: empty, or why no particle is good.
        demonstrations: N arrays (T_j, D) that the primitive was learned from.
        obstacles: of the scene.
        tool_paths: (P, T, 3) m, the way of a robot's tool; None without a robot.
    """

    trajectories: FloatArray
    weights: FloatArray
    costs: Mapping[str, FloatArray]
    collision_free: BoolArray
    clearance: FloatArray
    executable: BoolArray
    duration: FloatArray
    missed: Mapping[str, FloatArray]
    passing: BoolArray
    components: NDArray[np.int64]
    chosen: int
    timings: Mapping[str, float]
    message: str
    demonstrations: tuple[FloatArray, ...]
    obstacles: Sequence[PathObstacle] = field(default=())
    tool_paths: FloatArray | None = None

    @property
    def good(self) -> BoolArray:
        """(P,) whether a particle is collision-free, executable and passes all it should."""
        return self.collision_free & self.executable & self.passing

    @property
    def best(self) -> FloatArray:
        """(T, D) the chosen path."""
        return np.asarray(self.trajectories[self.chosen])

    @property
    def planning_time(self) -> float:
        """Seconds of all stages together."""
        return float(sum(self.timings.values()))

    @property
    def planar_obstacles(self) -> tuple[Circle | Rectangle, ...]:
        """The obstacles in the plane."""
        return tuple(o for o in self.obstacles if isinstance(o, Circle | Rectangle))

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw paths in the plane; see `smp_planner.library.drawing.draw`."""
        return draw(self, axes)

    @cached_property
    def signatures(self) -> NDArray[np.int64]:
        """(P, M) in the plane or (P, M, 2) in space: how each path goes round each obstacle.

        See `smp_planner.planning.modes`; in space, over and under is along an obstacle's own z
        axis, and of a robot it is the tool's way that counts. M counts bodies: a `PointCloud` has
        no such.

        Raises:
            ValueError: the paths are neither in the plane nor in space.
        """
        paths = self.trajectories if self.tool_paths is None else self.tool_paths
        if paths.shape[-1] == 2:
            centers = np.array([o.center for o in self.planar_obstacles]).reshape(-1, 2)
            return signatures_2d(paths, centers)
        if paths.shape[-1] != 3:
            raise ValueError(f"signatures need paths in the plane or in space, got {paths.shape}")
        solid = [o for o in self.obstacles if isinstance(o, Obstacle)]
        if not solid:
            return np.empty((len(paths), 0, 2), np.int64)
        return signatures_3d(
            paths,
            np.array([o.position for o in solid]),
            np.array([o.size[2] for o in solid]),
            np.array([REGISTRY[o.shape].radius(np.array(o.size)) for o in solid]),
            Rotation.from_quat([o.quaternion for o in solid]).apply((0.0, 0.0, 1.0)),
        )

    @cached_property
    def modes(self) -> Modes:
        """The classes of all paths by the way that they go round the obstacles."""
        return group(self.signatures)
