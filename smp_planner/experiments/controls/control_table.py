"""The table of controls: every control on unselected scenes of a task, a family, a difficulty."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smp_gym.atomic_files import write_text
from smp_gym.sampling import sample_scene
from smp_gym.scene import Scene
from smp_planner.agents.posed_scenes import posed
from smp_planner.benchmark.results_folder import ResultsError, write_json
from smp_planner.benchmark.row_table import checked
from smp_planner.benchmark.statistics import rate_interval
from smp_planner.experiments.controls.detour import Detour, SearchSettings, learn_detour
from smp_planner.experiments.controls.measuring import (
    Outcome,
    detour_outcomes,
    random_outcomes,
    search_iterations,
    unadapted_outcomes,
)

__all__ = ["CONTROLS", "ControlCell", "Request", "markdown", "measure", "write_table"]

CONTROLS = ("detour", "unadapted", "search", "random")
"""Controls by name, in the order in which they are measured."""

TRAINING_SEED = 80_000
"""Tuning seed of the first scene that a detour is learned on; the scenes measured are others."""


@dataclass(frozen=True)
class ControlCell:
    """A cell of the table: a task, a family of scenes and a difficulty."""

    task: str
    family: str
    difficulty: str

    @property
    def name(self) -> str:
        """Name of its file, without ending."""
        return f"{self.task}_{self.family}_{self.difficulty}"

    def scenes(self, first: int, count: int) -> list[Scene]:
        """Return the scenes of so many seeds from one on."""
        seeds = range(first, first + count)
        return [sample_scene(self.task, self.difficulty, k, self.family) for k in seeds]


@dataclass(frozen=True)
class Request:
    """What is measured in a cell.

    Attributes:
        cell: where.
        folder: of the files.
        controls: of `CONTROLS`.
        episodes: scenes.
        seed: of the first of them.
        training: scenes that the detour is learned on.
        generations: of each restart of its search.
        restarts: of its search.
        physics: whether detours and draws are executed, too.
    """

    cell: ControlCell
    folder: Path
    controls: tuple[str, ...] = CONTROLS
    episodes: int = 100
    seed: int = 0
    training: int = 160
    generations: int = SearchSettings.generations
    restarts: int = SearchSettings.restarts
    physics: bool = False

    @property
    def path(self) -> Path:
        """File of the cell's results."""
        return self.folder / f"{self.cell.name}.json"

    def _terms(self) -> dict[str, Any]:
        """Return what results must agree in to be continued, as JSON holds it."""
        names = ("episodes", "seed", "training", "generations", "restarts", "physics")
        return {"cell": asdict(self.cell), **{name: getattr(self, name) for name in names}}

    def content(self) -> dict[str, Any]:
        """Return what the cell's file holds already, or the beginning of a new one.

        Raises:
            ResultsError: the file is damaged, or of another request.
        """
        if not self.path.exists():
            return {**self._terms(), "outcomes": {}}
        found = _read(self.path)
        terms = {name: found.get(name) for name in self._terms()}
        if terms != self._terms():
            raise ResultsError(
                f"{self.path} holds results of other settings and is left as it is; choose "
                f"another folder: {terms} there, {self._terms()} now"
            )
        return found


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        ControlCell(**content["cell"])
        outcomes = checked(dict[str, list[Outcome]], json.dumps(content["outcomes"]))
        episodes = content["episodes"]
        if not outcomes.keys() <= set(CONTROLS):
            raise ValueError(
                f"outcomes must be of {', '.join(CONTROLS)}, got {', '.join(outcomes)}"
            )
        if any(len(of_control) != episodes for of_control in outcomes.values()):
            raise ValueError(f"outcomes must be of {episodes} episodes each")
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise ResultsError(f"{path} is not a file of controls: {error}") from error
    return content


def measure(request: Request) -> Path:
    """Measure what a cell's file does not hold yet, control by control, and return the file.

    Raises:
        ResultsError: the file is damaged, or of another request.
    """
    content = request.content()
    missing = [name for name in request.controls if name not in content["outcomes"]]
    if not missing:
        return request.path
    request.folder.mkdir(parents=True, exist_ok=True)
    scenes = request.cell.scenes(request.seed, request.episodes)
    measuring: Mapping[str, Callable[[], list[Outcome]]] = {
        "detour": lambda: detour_outcomes(
            scenes, _learned(request, content), physics=request.physics
        ),
        "unadapted": lambda: unadapted_outcomes(scenes, physics=request.physics),
        "search": lambda: search_iterations(scenes),
        "random": lambda: random_outcomes(scenes),
    }
    for name in missing:
        content["outcomes"][name] = [asdict(outcome) for outcome in measuring[name]()]
        write_json(request.path, content)
    return request.path


def _learned(request: Request, content: dict[str, Any]) -> Detour:
    """Return the detour of a cell, and keep numbers and curve in the content of its file."""
    cell = request.cell
    settings = SearchSettings(generations=request.generations, restarts=request.restarts)
    detour = learn_detour(cell.task, posed(cell.scenes(TRAINING_SEED, request.training)), settings)
    content["detour"] = {
        "numbers": detour.numbers.tolist(),
        "component": detour.component,
        "curve": detour.curve.tolist(),
        "validated": detour.validated,
    }
    return detour


def _rate(outcomes: Sequence[Mapping[str, Any]], field: str) -> str:
    values = [outcome[field] for outcome in outcomes if outcome[field] is not None]
    if not values:
        return "–"
    rate = rate_interval(sum(values), len(values))
    return f"{rate['value']:.0%} ({rate['low']:.0%}–{rate['high']:.0%})"


def _iterations(outcomes: Sequence[Mapping[str, Any]]) -> str:
    if not outcomes:
        return "–"
    taken = np.array([outcome["iterations"] for outcome in outcomes])
    return f"{np.median(taken):.0f}, {np.percentile(taken, 95):.0f}"


def markdown(folder: Path) -> str:
    """Return the table of all cells in a folder, as Markdown; rates with Wilson intervals.

    Raises:
        ResultsError: the folder holds no results, or a damaged file.
    """
    contents = [_read(path) for path in sorted(folder.glob("*_*_*.json"))]
    if not contents:
        raise ResultsError(f"{str(folder)!r} holds no results of controls")
    order = {name: index for index, name in enumerate(("none", "easy", "medium", "hard"))}
    contents.sort(
        key=lambda content: (
            content["cell"]["task"],
            content["cell"]["family"],
            order.get(content["cell"]["difficulty"], len(order)),
        )
    )
    titles = (
        "Task",
        "Family",
        "Difficulty",
        "n",
        "Fixed detour",
        "in the physics",
        "Unadapted",
        "in the physics",
        "RRT-Connect finds a path",
        "Iterations: median, 95 %",
        "Random actions",
    )
    lines = [" | ".join(titles), "|".join(["---"] * 3 + ["--:"] * (len(titles) - 3))]
    for content in contents:
        of = {name: content["outcomes"].get(name, []) for name in CONTROLS}
        cells = (
            *(content["cell"][name] for name in ("task", "family", "difficulty")),
            str(content["episodes"]),
            _rate(of["detour"], "solved"),
            _rate(of["detour"], "executed"),
            _rate(of["unadapted"], "solved"),
            _rate(of["unadapted"], "executed"),
            _rate(of["search"], "solved"),
            _iterations(of["search"]),
            _rate(of["random"], "executed"),
        )
        lines.append(" | ".join(cells))
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def write_table(folder: Path) -> Path:
    """Write the table of a folder into it, and return its file; see `markdown`."""
    path = folder / "controls.md"
    write_text(path, markdown(folder))
    return path
