"""The difficulties' settings, and the random generator of a scene."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

__all__ = ["CROWDED", "SPECIFICATIONS", "DifficultySpecification", "generator"]


@dataclass(frozen=True)
class DifficultySpecification:
    """The settings of a difficulty.

    Attributes:
        obstacles: how many.
        on_table: how many of them must stand on the table; the others stand, hang or lie across.
        clearance: m, what every obstacle leaves between itself and the witness's spheres.
        free_share: share of the proposals that may stay free; where more do, it is drawn anew.
        wide_share: likewise, of the wider detours from which the witness is drawn.
        blind_share: likewise, of the blind detours.
    """

    obstacles: int
    on_table: int
    clearance: float
    free_share: float
    wide_share: float = 1.0
    blind_share: float = 1.0

    @property
    def shares(self) -> tuple[float, float, float]:
        """Shares of proposals, wider and blind detours that may stay free."""
        return self.free_share, self.wide_share, self.blind_share


SPECIFICATIONS = {
    "none": DifficultySpecification(obstacles=0, on_table=0, clearance=0.0, free_share=1.0),
    "easy": DifficultySpecification(
        6, 0, clearance=0.027, free_share=0.007, wide_share=0.04, blind_share=0.5
    ),
    "medium": DifficultySpecification(
        7, 1, clearance=0.02, free_share=0.007, wide_share=0.03, blind_share=0.2
    ),
    "hard": DifficultySpecification(
        10, 1, clearance=0.01, free_share=0.007, wide_share=0.015, blind_share=0.05
    ),
}

CROWDED = tuple(name for name, chosen in SPECIFICATIONS.items() if chosen.obstacles)
"""Difficulties with obstacles, the only ones of families other than the first."""


def generator(task: str, difficulty: str, seed: int, version: int) -> np.random.Generator:
    """Return the source of all randomness of one scene."""
    name = zlib.crc32(f"{task}/{difficulty}".encode())
    return np.random.Generator(np.random.PCG64([name, version, seed]))
