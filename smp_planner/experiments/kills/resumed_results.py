"""Work that keeps results as they come: the rows of a run and of Table II, and kept results."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from smp_gym.sampling import sample_scene
from smp_gym.suites import Cell
from smp_planner.benchmark import runner
from smp_planner.benchmark.episodes import TIMES
from smp_planner.benchmark.manifest import make_manifest, read_results
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.experiments.kept_results import kept_results
from smp_planner.experiments.kills.killing import Work
from smp_planner.experiments.table_two import running
from smp_planner.experiments.table_two.repetitions import FLOOR, play_repetition

__all__ = ["kept_scenes", "run", "table"]

_TIMELESS: Mapping[str, Any] = dict.fromkeys(TIMES)

_TASK = "Placement"


def run(jobs: int, episodes: int = 16) -> Work:
    """Return a run of the benchmark: episodes without obstacles, planned by `promp`.

    Args:
        jobs: worker processes.
        episodes: of seeds from 0 on.
    """
    manifest = make_manifest([Cell(_TASK, "none")], ["promp"], 0, episodes)
    for key in manifest.first_keys():
        manifest.player(key)

    def rows(folder: Path) -> Mapping[Any, str]:
        # As text: what is no number is equal to itself.
        return {row.key: repr(replace(row, **_TIMELESS)) for row in read_results(folder)[1]}

    return Work(
        "run",
        lambda folder: _unused(runner.run(manifest, folder, jobs=jobs)),
        partial(_or_nothing, rows),
    )


def table(jobs: int, repetitions: int = 6) -> Work:
    """Return a part of Table II: its noise floor on two tasks, which no physics is needed for.

    Args:
        jobs: worker processes.
        repetitions: of each task.
    """
    keys = running.keys_of((_TASK, "DrawS"), (FLOOR,), repetitions)
    for key in keys[:2]:
        play_repetition(key)

    def rows(folder: Path) -> Mapping[Any, str]:
        return {row.key: repr(replace(row, planning_time=0.0)) for row in running.read(folder)}

    return Work(
        "table",
        lambda folder: running.run(keys, folder, jobs=jobs),
        partial(_or_nothing, rows),
    )


def kept_scenes(jobs: int, count: int = 120) -> Work:
    """Return the drawing of scenes, as `kept_results` holds them.

    Args:
        jobs: worker processes.
        count: of scenes.
    """
    items = {str(seed): seed for seed in range(count)}
    sample_scene(_TASK, "easy", 0)

    def draw(folder: Path) -> None:
        path, console = folder / "kept.json", Console(quiet=True)
        kept_results(path, {"task": _TASK}, _scene, items, "scenes", console, jobs)

    def scenes(folder: Path) -> Mapping[str, Any]:
        path = folder / "kept.json"
        return json.loads(path.read_text())["results"] if path.exists() else {}

    return Work("kept results", draw, scenes)


def _scene(seed: int) -> str:
    return sample_scene(_TASK, "easy", seed).to_json()


def _unused(value: Any) -> None:
    """Drop a value."""


def _or_nothing(rows: Callable[[Path], Mapping[Any, Any]], folder: Path) -> Mapping[Any, Any]:
    """Return the rows of a folder; none where nothing was written yet."""
    try:
        return rows(folder)
    except ResultsError as error:
        if "holds no results" not in str(error):
            raise
        return {}
