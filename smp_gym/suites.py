"""Suites of the benchmark: cells, each a distribution of scenes and how its obstacles are sensed.

`SUITES` names four: ``standard`` (every task at every difficulty), ``tight`` (furniture and
clutter), ``perception`` (noisy rows of obstacles, or a depth camera in place of them) and
``dynamic`` (obstacles that move, or are displaced in mid-episode). A suite has the cells whose
family the task has.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType
from typing import Any

from smp_gym.observation import SENSINGS
from smp_gym.sampling import CROWDED, sample_scene
from smp_gym.scene import DIFFICULTIES, FAMILIES, Scene
from smp_gym.tasks.registry import task_families, task_names

__all__ = ["SUITES", "Cell", "home_suite", "suite_cells"]

_FURNITURE = ("shelf", "box", "cage", "table")
_NOISES = (0.01, 0.02, 0.03)


def _check(what: str, value: Any, allowed: Sequence[str], of: str = "") -> None:
    if value not in allowed:
        raise ValueError(f"unknown {what} {value!r}{of}; there are: {', '.join(allowed)}")


@dataclass(frozen=True, order=True)
class Cell:
    """A distribution of scenes of one task, and how its obstacles are sensed.

    Attributes:
        task: name of the task, one of `smp_gym.tasks.registry.task_names`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`; "none" in the family "obstacles" only.
        family: one of `smp_gym.tasks.registry.task_families`.
        sensing: one of `smp_gym.observation.SENSINGS`.
        noise: standard deviation of perceived positions, m; positive with the sensing "noise", 0
            with any other.

    Raises:
        ValueError: a field is not one of those allowed; the message names it and what there is.
    """

    task: str
    difficulty: str
    family: str = FAMILIES[0]
    sensing: str = SENSINGS[0]
    noise: float = 0.0

    def __post_init__(self) -> None:
        _check("task", self.task, task_names())
        _check("difficulty", self.difficulty, DIFFICULTIES)
        _check("family", self.family, task_families(self.task), f" of {self.task}")
        if self.family != FAMILIES[0]:
            _check("difficulty", self.difficulty, CROWDED, f" of {self.family}")
        _check("sensing", self.sensing, SENSINGS)
        noisy = self.sensing == "noise"
        if not math.isfinite(self.noise) or (self.noise > 0.0) != noisy or self.noise < 0.0:
            raise ValueError(
                f"noise must be {'positive' if noisy else '0'} with sensing {self.sensing!r}, "
                f"got {self.noise}"
            )

    @property
    def name(self) -> str:
        """Name of the cell in files and tables, such as ``Placement_shelf_hard``."""
        parts = [self.task]
        if self.family != FAMILIES[0]:
            parts.append(self.family)
        parts.append(self.difficulty)
        if self.sensing == "noise":
            parts.append(f"noise{1000.0 * self.noise:g}mm")
        elif self.sensing != SENSINGS[0]:
            parts.append(self.sensing)
        return "_".join(parts)

    @property
    def unsensed(self) -> Cell:
        """The cell of the same scenes with obstacles as they are."""
        return replace(self, sensing=SENSINGS[0], noise=0.0)

    def make_arguments(self) -> dict[str, Any]:
        """Return the keyword arguments of `gymnasium.make` beside the environment id."""
        arguments: dict[str, Any] = {
            "difficulty": self.difficulty,
            "family": self.family,
            "sensing": self.sensing,
        }
        if self.sensing == "noise":
            arguments["noise"] = self.noise
        return arguments

    def scene(self, seed: int) -> Scene:
        """Return the scene of a seed, a pure function of cell and seed.

        Args:
            seed: not negative; below `smp_gym.scene.EVALUATION_SEEDS_START` for tuning.
        """
        return sample_scene(self.task, self.difficulty, seed, self.family)


def _cells(families: Iterable[str]) -> tuple[Cell, ...]:
    """Return the cells of every task that has a family, by family and difficulty."""
    return tuple(
        Cell(task, difficulty, family)
        for task, family, difficulty in product(task_names(), families, CROWDED)
        if family in task_families(task)
    )


def _sensed() -> tuple[Cell, ...]:
    """Return the easy cells of every task, seen with noise and by the camera."""
    return tuple(
        cell
        for task in task_names()
        for cell in (
            *(Cell(task, CROWDED[0], sensing="noise", noise=noise) for noise in _NOISES),
            Cell(task, CROWDED[0], sensing="depth"),
        )
    )


SUITES: Mapping[str, tuple[Cell, ...]] = MappingProxyType(
    {
        "standard": _cells(FAMILIES[:1]),
        "tight": _cells((*_FURNITURE, "clutter")),
        "perception": _sensed(),
        "dynamic": _cells(("moving", "displaced")),
    }
)
"""The cells of each suite, by its name."""


def suite_cells(
    suite: str, tasks: Sequence[str] = (), cells: Sequence[str] = ()
) -> tuple[Cell, ...]:
    """Return the cells of a suite, or those of some tasks and names.

    Args:
        suite: one of `SUITES`.
        tasks: names of tasks; none for all.
        cells: names of cells; none for all.

    Raises:
        ValueError: no such suite, task or cell, or no cell left.
    """
    _check("suite", suite, tuple(SUITES))
    for task in tasks:
        _check("task", task, task_names())
    for name in cells:
        _check("cell", name, [cell.name for cell in SUITES[suite]], f" of suite {suite}")
    chosen = tuple(
        cell
        for cell in SUITES[suite]
        if (not tasks or cell.task in tasks) and (not cells or cell.name in cells)
    )
    if not chosen:
        among = f" of {', '.join(tasks)}" if tasks else ""
        names = f" among {', '.join(cells)}" if cells else ""
        raise ValueError(f"suite {suite} has no cells{among}{names}")
    return chosen


def home_suite(cell: Cell) -> str | None:
    """Return the suite that holds a cell's scenes, sensed exactly; None if no suite does.

    Cells that differ in their sensing alone share their scenes, so that what sensing costs is
    measured on equal scenes.
    """
    return next((name for name, cells in SUITES.items() if cell.unsensed in cells), None)
