"""Places and orientations that a robot's tool has at a phase, one of several.

It enters a plan twice, as every constraint: the primitive is conditioned on the postures that are
sought for it, linearised where they are, and a cost, Eq. (14) with the angle beside the three
coordinates, keeps the particles within what is allowed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike

from smp_gym.arrays import FloatArray, IntArray
from smp_planner.collision.costs import Cost, ValueAndGradient, check_trajectories
from smp_planner.collision.robot_model import RobotModel
from smp_planner.movement_primitives import ProMP
from smp_planner.movement_primitives.box_prior import box_offset
from smp_planner.planning.constraints import at_phases, mixture_cost, spread_to_steps
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.tool_goals import GoalRegion, ToolViaPoint
from smp_planner.planning.tool_orientations import inner_angle
from smp_planner.planning.tool_postures import posture_information, postures_at

__all__ = ["ToolPassing"]


@dataclass(frozen=True, eq=False)
class ToolPassing:
    """Alternative places of the tool, in one of which it is at a phase, with an orientation.

    Attributes:
        name: what the user calls it.
        phase: in [0, 1].
        places: at least one; the phase of a via-point is that of the constraint.
        robot: whose tool it is.
        shares: π_h, positive, of the places.
    """

    name: str
    phase: float
    places: tuple[GoalRegion | ToolViaPoint, ...]
    robot: RobotModel
    shares: tuple[float, ...]

    @property
    def phases(self) -> tuple[float, ...]:
        """The phase at which a place is passed."""
        return (self.phase,)

    @property
    def oriented(self) -> bool:
        """Whether a place asks for an orientation."""
        return any(place.orientation is not None for place in self.places)

    def distances(self, trajectories: FloatArray) -> FloatArray:
        """Return the distances (H, P) m of the tool to each place, of (P, T, n) rad."""
        return self._violations(trajectories)[0]

    def missed(self, trajectories: FloatArray) -> FloatArray:
        """Return the distance (P,) m of the tool to the place that it misses least.

        That is the one of the least sum of distance, m, and `turned`, rad.
        """
        distances, angles = self._violations(trajectories)
        return np.asarray(np.take_along_axis(distances, _least(distances, angles), axis=0)[0])

    def turned(self, trajectories: FloatArray) -> FloatArray:
        """Return by what angle (P,) rad the tool misses the orientation at that place."""
        distances, angles = self._violations(trajectories)
        return np.asarray(np.take_along_axis(angles, _least(distances, angles), axis=0)[0])

    def _violations(self, trajectories: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return distances (H, P) m to places, and angles (H, P) rad beyond what they allow."""
        due = np.ascontiguousarray(at_phases(trajectories, self.phase)[:, 0])
        rotations = self.robot.tool_rotations(due)[0]
        distances, angles = [], []
        for place in self.places:
            distances.append(place.distance(self.robot.carried_points(due, place.point)[0]))
            angles.append(np.zeros(len(due)))
            if place.orientation is not None:
                angle = place.orientation.turned(rotations)[0]
                angles[-1] = np.maximum(angle - place.orientation.allowed, 0.0)
        return np.array(distances), np.array(angles)

    def cost(self, settings: PlanSettings) -> Cost:
        """Return `mixture_cost` of the places, for the tool when they are due.

        Of a via-point's tolerance the share `PlanSettings.via_share` costs nothing, and of the
        angle of an orientation what `inner_angle` leaves of it. The angle has the tails of
        a length, in rad for m; where an orientation is free, π rad cost nothing.
        """
        lower, upper = (
            np.stack(corners)
            for corners in zip(*[_corners(p, settings.via_share) for p in self.places], strict=True)
        )
        free = np.array(
            [
                math.pi if p.orientation is None else inner_angle(p.orientation, settings.via_share)
                for p in self.places
            ]
        )
        widths = np.column_stack([upper - lower, 2.0 * free])
        if not self.oriented:
            widths = widths[:, :3]
        variance = np.full(widths.shape, settings.sigma**2)

        def cost(trajectories: ArrayLike) -> ValueAndGradient:
            paths = check_trajectories(trajectories, self.robot.joints)
            due = np.ascontiguousarray(at_phases(paths, self.phase)[:, 0])
            offsets = np.zeros((len(widths), len(due), widths.shape[1]))
            jacobians = np.zeros((*offsets.shape, self.robot.joints))
            for h, place in enumerate(self.places):
                points, jacobians[h, :, :3] = self.robot.carried_points(due, place.point)
                offsets[h, :, :3] = box_offset(points, lower[h], upper[h])
            if self.oriented:
                rotations, axes = self.robot.tool_rotations(due)
                for h, place in enumerate(self.places):
                    if place.orientation is not None:
                        angle, about = place.orientation.turned(rotations)
                        offsets[h, :, 3] = np.maximum(angle - free[h], 0.0)
                        jacobians[h, :, 3] = (about[:, None] @ axes)[:, 0]
            value, slopes = mixture_cost(offsets, variance, widths, self.shares)
            pull = np.einsum("hpd,hpdn->pn", slopes, jacobians)
            return value, spread_to_steps(pull[:, None], self.phase, paths.shape[1])

        return cost

    def condition(self, primitive: ProMP, settings: PlanSettings) -> list[tuple[ProMP, float]]:
        """Return the posterior for each posture that is sought for it, with its log-evidence.

        The tool's place and orientation are taken to be linear in the joints about each posture
        (Laplace's approximation).

        Raises:
            UnreachableError: no posture has any of the places; the message says what binds.
        """
        mean, covariance = primitive.marginal(self.phase)
        found = postures_at(self.name, mean.numpy(), covariance.numpy(), self.places, self.robot)
        conditioned = []
        for place, posture in found:
            information = posture_information(self.places[place], posture, self.robot)
            noise = torch.from_numpy(np.linalg.inv(information))
            noise = (noise + noise.mT) / 2
            value = torch.from_numpy(posture)
            density = torch.distributions.MultivariateNormal(mean, covariance + noise)
            evidence = math.log(self.shares[place]) + float(density.log_prob(value))
            conditioned.append((primitive.condition(self.phase, value, noise), evidence))
        return conditioned

    def slack(self, settings: PlanSettings) -> float:
        """Return the settings' `sigma`, m and rad."""
        return settings.sigma


def _least(distances: FloatArray, angles: FloatArray) -> IntArray:
    """Return which of H places P tools miss least, (1, P)."""
    return np.asarray((distances + angles).argmin(axis=0)[None])


def _corners(place: GoalRegion | ToolViaPoint, share: float) -> tuple[FloatArray, FloatArray]:
    """Return the corners (3,) m of the box in which a place costs nothing."""
    if isinstance(place, GoalRegion):
        return place.lower, place.upper
    half = share * place.tolerance
    return place.position - half, place.position + half
