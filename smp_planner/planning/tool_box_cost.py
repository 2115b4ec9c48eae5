"""The cost of where the tool is at phases: boxes that it must meet, or a choice of them."""

# Compiled functions carry no annotations: numba infers the types, the docstrings say them.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray
from smp_gym.compiling import FAST, kernel
from smp_gym.robot.forward_kernels import link_poses
from smp_planner.collision.costs import ValueAndGradient, check_trajectories, evaluated
from smp_planner.collision.robot_model import RobotModel
from smp_planner.planning.constraints import segments

__all__ = ["ToolBoxCost"]


@kernel(fastmath=FAST)
def _add(trajectories, first, share, chain, boxes, options, weight, value, gradient):
    """Add the weighted cost of boxes.

    Args:
        trajectories: (P,T,n) rad or m.
        first: (H,) step before the phase of each box.
        share: (H,) of the way from there to the next step.
        chain: (base, origins, prismatic), as in `link_poses`.
        boxes: (point, lower, upper, precision, log_weight): (H,3) m in the last link's frame, two
            (H,3) m, (H,3) 1/m^2, (H,).
        options: whether one of the boxes is enough.
        weight: factor.
        value: (P,), added to.
        gradient: (P,T,n), added to.
    """
    base, origins, prismatic = chain
    point, lower, upper, precision, log_weight = boxes
    count, _, joints = trajectories.shape
    several = len(first)
    columns = count * several
    configurations = np.empty((joints, columns))
    for p in range(count):
        for h in range(several):
            for k in range(joints):
                a, b = trajectories[p, first[h], k], trajectories[p, first[h] + 1, k]
                configurations[k, p * several + h] = (1.0 - share[h]) * a + share[h] * b
    sine, cosine = np.empty((joints, columns)), np.empty((joints, columns))
    rotation = np.empty((joints + 1, 3, 3, columns))
    position = np.empty((joints + 1, 3, columns))
    link_poses(configurations, prismatic, base, origins, sine, cosine, rotation, position)
    place, pull = np.empty((several, 3)), np.empty((several, 3))
    merit, part = np.empty(several), np.empty(several)
    for p in range(count):
        total = 0.0
        for h in range(several):
            column, excess = p * several + h, 0.0
            for i in range(3):
                x = position[joints, i, column]
                for j in range(3):
                    x += rotation[joints, i, j, column] * point[h, j]
                off = x - min(max(x, lower[h, i]), upper[h, i])
                place[h, i], pull[h, i] = x, off * precision[h, i]
                excess += 0.5 * off * off * precision[h, i]
            merit[h], part[h] = log_weight[h] - excess, 1.0
            total += excess
        if options:
            largest, mass = merit.max(), 0.0
            for h in range(several):
                part[h] = math.exp(merit[h] - largest)
                mass += part[h]
            for h in range(several):
                part[h] /= mass
            total = -(largest + math.log(mass))
        value[p] += weight * total
        for h in range(several):
            column = p * several + h
            scale = weight * part[h]
            fx, fy, fz = scale * pull[h, 0], scale * pull[h, 1], scale * pull[h, 2]
            if fx == 0.0 and fy == 0.0 and fz == 0.0:
                continue
            for k in range(1, joints + 1):
                ax, ay, az = (
                    rotation[k, 0, 2, column],
                    rotation[k, 1, 2, column],
                    rotation[k, 2, 2, column],
                )
                if prismatic[k - 1]:
                    slope = ax * fx + ay * fy + az * fz
                else:
                    dx = place[h, 0] - position[k, 0, column]
                    dy = place[h, 1] - position[k, 1, column]
                    dz = place[h, 2] - position[k, 2, column]
                    slope = (
                        ax * (dy * fz - dz * fy)
                        + ay * (dz * fx - dx * fz)
                        + az * (dx * fy - dy * fx)
                    )
                gradient[p, first[h], k - 1] += (1.0 - share[h]) * slope
                gradient[p, first[h] + 1, k - 1] += share[h] * slope


@dataclass(frozen=True, eq=False)
class ToolBoxCost:
    """Boxes in which points of the hand must be at phases, Eq. (14), a `CompiledCost`.

    Where each must be met it is Σ d² / (2 σ²); of options it is the logarithm of a mixture, as
    `smp_planner.planning.constraints.mixture_cost` has it.

    Attributes:
        robot: whose hand it is.
        points: (H, 3) m, fixed in the end-effector frame.
        phases: H phases at which the points are looked at.
        lower: (H, 3) m, corners of the boxes.
        upper: (H, 3) m.
        sigma: m, standard deviation of the tails.
        log_weight: (H,) as of `mixture_weights`, where the boxes are options; None where each
            must be met.
    """

    robot: RobotModel
    points: FloatArray
    phases: Sequence[float]
    lower: FloatArray
    upper: FloatArray
    sigma: float
    log_weight: FloatArray | None = None

    @cached_property
    def _arrays(self) -> tuple[Any, Any]:
        robot = self.robot
        chain = robot.base, robot.joint_origins, robot.prismatic
        boxes = (
            np.stack([robot.carried(point) for point in self.points]),
            np.ascontiguousarray(self.lower),
            np.ascontiguousarray(self.upper),
            np.full(self.lower.shape, self.sigma**-2),
            np.zeros(len(self.lower)) if self.log_weight is None else self.log_weight,
        )
        return chain, boxes

    def __call__(self, trajectories: ArrayLike) -> ValueAndGradient:
        """Return value (P,) and gradient (P,T,n) of trajectories (P,T,n) rad."""
        return evaluated(self, check_trajectories(trajectories, self.robot.joints))

    def add(
        self, trajectories: FloatArray, weight: float, value: FloatArray, gradient: FloatArray
    ) -> None:
        """Add the weighted cost; see `CompiledCost.add`."""
        first, share = segments(trajectories.shape[1], self.phases)
        _add(
            trajectories,
            first,
            share,
            *self._arrays,
            self.log_weight is not None,
            weight,
            value,
            gradient,
        )
