"""Rows of a real run: three methods on twelve scenes of each task at hard."""

import csv
import gzip
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

from smp_gym.suites import Cell
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import EpisodeStore, Manifest

METHODS = ("smp", "cpromp", "rrt_connect")
TASKS = ("Placement", "DoubleSidedPlacement", "DrawS", "PushLiftBox")
FIRST_SEED = 79400
EPISODES = 12

_PATH = Path(__file__).parent / "smp_planner" / "benchmark" / "hard_rows.csv.gz"
_PARSE: dict[str, Callable[[str], Any]] = {
    "str": str,
    "int": int,
    "float": float,
    "bool": lambda text: {"True": True, "False": False}[text],
}


def _parsed(kind: str, text: str) -> Any:
    name, *optional = kind.split(" | ")
    return None if optional and not text else _PARSE[name](text)


@cache
def real_rows() -> tuple[EpisodeRow, ...]:
    """Return all rows."""
    kinds = {field.name: str(field.type) for field in fields(EpisodeRow)}
    with gzip.open(_PATH, "rt", newline="") as file:
        return tuple(
            EpisodeRow(**{name: _parsed(kinds[name], text) for name, text in row.items()})
            for row in csv.DictReader(file)
        )


def write_folder(
    folder: Path,
    tasks: Sequence[str] = TASKS,
    methods: Sequence[str] = METHODS,
    episodes: int = EPISODES,
    *,
    change: Callable[[EpisodeRow], EpisodeRow] = replace,
    **manifest: Any,
) -> list[EpisodeRow]:
    """Write a folder of results that holds some of the real rows, and return them.

    Args:
        folder: made.
        tasks: of the rows.
        methods: of the rows.
        episodes: of each task and method, the first ones.
        change: applied to each row.
        manifest: entries of the manifest that differ.
    """
    cells = tuple(Cell(task, "hard") for task in tasks)
    specs = {method: method for method in methods}
    settings: dict[str, Any] = {
        "versions": {"numpy": "2.4.6"},
        "code": "d0de2010cfedd9c0",
        "specs": specs,
    }
    settings |= {"seed": FIRST_SEED, **manifest}
    made = Manifest(cells, tuple(methods), episodes=episodes, **settings)
    keys = set(made.episode_keys())
    rows = [row for row in map(change, real_rows()) if row.key in keys]
    with EpisodeStore(folder, made) as store:
        for row in rows:
            store.append(row)
    return rows
