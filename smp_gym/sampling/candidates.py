"""Candidate obstacles with the trajectories that they block: first by the grid, then exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.sampling import kernels
from smp_gym.sampling.family import BLOCKING_DEPTH, Family

__all__ = ["Candidates"]

_GRID_DEPTH = BLOCKING_DEPTH + 0.01
"""Metres: how deep an obstacle has to reach on the grid, whose guesses are the least of many and so
rather too near."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Candidate obstacles.

    Attributes:
        rows: (C, 9).
        blocks: (C, N), which free members each blocks, on the grid or exactly.
        exact: (C,), where `blocks` is exact.
    """

    rows: FloatArray
    blocks: BoolArray
    exact: BoolArray

    @classmethod
    def none(cls, family: Family) -> Candidates:
        """Return no candidates, for a family."""
        return cls(
            np.empty((0, kernels.OBSTACLE_COLUMNS)),
            np.empty((0, len(family.paths)), np.bool_),
            np.empty(0, np.bool_),
        )

    @classmethod
    def guessed(cls, family: Family, rows: FloatArray) -> Candidates:
        """Return (C, 9) obstacles with the members that they block by the grid."""
        blocks = family.near(rows, -_GRID_DEPTH) & family.free
        return cls(rows, blocks, np.zeros(len(rows), np.bool_))

    def joined(self, other: Candidates) -> Candidates:
        """Return the union of two sets of candidates."""
        return Candidates(
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.blocks, other.blocks]),
            np.concatenate([self.exact, other.exact]),
        )

    def most_blocking(self, count: int) -> FloatArray:
        """Return the rows of those that block most."""
        return self.rows[np.argsort(-self.blocks.sum(axis=1), kind="stable")[:count]]

    def check(self, family: Family, chosen: list[int]) -> bool:
        """Make `blocks` of the chosen exact, and return whether it was."""
        guessed = [index for index in chosen if not self.exact[index]]
        self.blocks[guessed] = family.blocked(self.rows[guessed]) & family.free
        self.exact[guessed] = True
        return not guessed
