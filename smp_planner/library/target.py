"""The likelihood of a scene of one's own, Eq. (7): obstacles, limits, and what is to be passed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smp_planner.library.mover import Mover, ValueAndGradient
from smp_planner.library.settings import AdaptSettings
from smp_planner.library.site import Site

__all__ = ["SceneTarget", "at_phase"]

FloatArray = NDArray[np.float64]


def at_phase(trajectories: FloatArray, phase: float) -> FloatArray:
    """Return the points (P, D) of paths (P, T, D) at a phase, straight between samples."""
    first, share = _segment(trajectories.shape[1], phase)
    return np.asarray(
        (1.0 - share) * trajectories[:, first] + share * trajectories[:, first + 1], np.float64
    )


def _segment(count: int, phase: float) -> tuple[int, float]:
    """Return the segment of `count` equal steps that a phase lies on, and where on it."""
    at = phase * (count - 1)
    first = min(int(at), count - 2)
    return first, at - first


@dataclass(frozen=True)
class SceneTarget:
    """Weighted costs of paths; a `smp_planner.adaptation.Target`.

    Attributes:
        mover: what moves, among which obstacles.
        sites: what is to be passed, ascending in phase.
        settings: weights and widths.
    """

    mover: Mover
    sites: tuple[Site, ...]
    settings: AdaptSettings

    @property
    def steps(self) -> int:
        """Equal steps of phase at which it is evaluated."""
        return self.settings.planning_steps

    @property
    def pins(self) -> FloatArray:
        """Phases at which paths are held: both ends and what is to be passed; ascending."""
        return np.unique(np.round([0.0, 1.0, *(site.phase for site in self.sites)], 9))

    def gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the weighted sum of costs; see `Target.gradient`."""
        total = self.settings.obstacle_weight * self.obstacle_gradient(trajectories, progress)
        for weight, (_, gradient) in self._terms(trajectories).values():
            total += weight * gradient
        return total

    def obstacle_gradient(self, trajectories: FloatArray, progress: float) -> FloatArray:
        """Return the gradient (P, T, D) of the collision cost alone, unweighted."""
        first, last = self.settings.edge_width
        width = first * (last / first) ** progress
        return self.mover.collision(trajectories, width, self.settings.margin)[1]

    def weighted_sum(self, trajectories: FloatArray) -> FloatArray:
        """Return the weighted sum (P,) of costs, with the map's edge at its last width."""
        width, margin = self.settings.edge_width[1], self.settings.margin
        total = self.settings.obstacle_weight * self.mover.collision(trajectories, width, margin)[0]
        for weight, (value, _) in self._terms(trajectories).values():
            total = total + weight * value
        return total

    def costs(self, trajectories: FloatArray) -> dict[str, FloatArray]:
        """Return the unweighted costs (P,) by name, with the map's edge at its last width."""
        width = self.settings.edge_width[1]
        found = {"obstacles": self.mover.collision(trajectories, width, 0.0)[0]}
        return found | {name: value for name, (_, (value, _)) in self._terms(trajectories).items()}

    def _terms(self, trajectories: FloatArray) -> dict[str, tuple[float, ValueAndGradient]]:
        terms = self.mover.limits(trajectories)
        for site in self.sites:
            value, slope = site.cost(at_phase(trajectories, site.phase))
            first, share = _segment(trajectories.shape[1], site.phase)
            gradient = np.zeros(trajectories.shape)
            gradient[:, first] = (1.0 - share) * slope
            gradient[:, first + 1] = share * slope
            terms[site.name] = 1.0, (value, gradient)
        return terms
