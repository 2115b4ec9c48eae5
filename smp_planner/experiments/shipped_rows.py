"""Rows of experiments as they ship with the package: what the documents print, in few bytes.

Each file is a table in CSV, compressed, of what is printed and of what says which measurement a
line is.
"""

from __future__ import annotations

import csv
import gzip
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from smp_gym.atomic_files import replacing
from smp_gym.suites import SUITES
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import read_results
from smp_planner.experiments.lasa_posterior import VARIANTS
from smp_planner.experiments.narrow_places import METHODS

__all__ = [
    "CAGES",
    "LASA",
    "NARROW_PLACES",
    "SETS",
    "SHIPPED_SUITES",
    "SIDES",
    "SIDES_MEASURES",
    "SuiteRows",
    "cage_rows",
    "lasa_rows",
    "narrow_rows",
    "set_rows",
    "ship",
    "suite_rows",
]

LASA, NARROW_PLACES, CAGES = "lasa.csv.gz", "narrow_places.csv.gz", "cages.csv.gz"
SETS, SIDES = "frozen_sets.csv.gz", "sides.csv.gz"
"""Names of the files."""

SHIPPED_SUITES = {suite: f"{suite}.csv.gz" for suite in ("standard", "tight")}
"""Names of the files of suites of which all episodes ship."""

_DIGITS = 6
"""Significant ones of a number; with four some printed means have another last digit."""

_SIMILARITY = ("wasserstein", "frechet", "mmd")
_CLASSES = ("free", "classes", "entropy")

_SETS = (
    *("solved", "good", "chosen", "success", "energy", "wasserstein", "frechet", "coverage"),
    *("demonstrations", "classes", "entropy", "length", "jerk", "seconds"),
)
SIDES_MEASURES = ("good", "goals", "variation", "wasserstein")
"""Measures that ship of sets with more than one goal."""

_CAGE = ("method", "difficulty", "seed", "success", "cause", "share_good")
_SUITE = (
    *("method", "task", "family", "difficulty", "half", "seed"),
    *("success", "cause", "share_good", "planning_time", "steps"),
)

Line = dict[str, str]


@dataclass(frozen=True)
class _Table:
    """A table of `scripts/lasa.py`.

    Attributes:
        experiment: command that writes it.
        file: in the folder of all tables.
        scene: column of the scene's name; a file that has none is of the one scene of that name.
        method: column of the method's name.
        measures: columns that are printed.
    """

    experiment: str
    file: str
    scene: str
    method: str
    measures: tuple[str, ...]


_LASA_TABLES = (
    _Table(
        "compare",
        "fig1/comparison.csv",
        "Sshape",
        "method",
        (*_CLASSES, *_SIMILARITY, *(f"{name}_free" for name in _SIMILARITY), "length"),
    ),
    _Table(
        "modulate",
        "fig2/modulation.csv",
        "scene",
        "method",
        ("free", "passed", "reached", "good", "worst_end_error"),
    ),
    _Table("boxes", "table1/boxes.csv", "shape", "prior", ("free", "ends", "starts")),
    _Table(
        "shapes",
        "shapes/shapes.csv",
        "shape",
        "method",
        ("solved", *_CLASSES, "wasserstein", "length"),
    ),
    *(
        _Table(
            "posterior",
            f"posterior/{variant}.csv",
            variant,
            "setting",
            (
                *("free", "classes", "variation", "wasserstein_exact", "diversity", "spread"),
                *(f"class_{number}" for number in range(1, 5)),
            ),
        )
        for variant in VARIANTS
    ),
)


def lasa_rows(folder: Path) -> list[Line]:
    """Return a line for each repetition of each method in all tables on handwriting.

    Args:
        folder: into which `scripts/lasa.py` wrote, without options ``results/lasa``.

    Raises:
        OSError: a table is not there.
        ValueError: a table lacks a column, or a measure is no number.
    """
    measures = dict.fromkeys(name for table in _LASA_TABLES for name in table.measures)
    lines = []
    for table in _LASA_TABLES:
        path = folder / table.file
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        needed = {table.method, "seed", *table.measures}
        if missing := sorted(needed - set(rows[0] if rows else ())):
            raise ValueError(f"{path} must have the columns {', '.join(missing)}")
        for row in rows:
            line = {
                "experiment": table.experiment,
                "scene": row.get(table.scene, table.scene),
                "method": row[table.method],
                "seed": row["seed"],
            }
            printed = {name: _rounded(row[name]) for name in table.measures}
            lines.append(line | {name: printed.get(name, "") for name in measures})
    return lines


def narrow_rows(path: Path) -> list[Line]:
    """Return a line for each method on each problem that is posed, and one for every other problem.

    Args:
        path: file of `scripts/narrow_places.py`.

    Raises:
        OSError: the file is not there.
        ValueError: it is another file.
    """
    try:
        results = json.loads(path.read_text(encoding="utf-8"))["results"]
        lines = []
        for name, result in results.items():
            problem = dict(zip(("arm", "family", "seed"), name.split(" "), strict=True))
            problem["posed"] = str(int(result["posed"]))
            if not result["posed"]:
                lines.append({**problem, "method": "", "solved": "", "seconds": ""})
            for method in METHODS:
                if method in result:
                    solved, seconds = str(int(result[method])), result[f"{method}_seconds"]
                    measured = {"solved": solved, "seconds": _rounded(seconds)}
                    lines.append({**problem, "method": method, **measured})
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is not a file of narrow places: {error}") from error
    return lines


def cage_rows(folders: Sequence[Path]) -> list[Line]:
    """Return a line for each episode of some runs of `smp-bench run` in the cages of Placement.

    Args:
        folders: of results, finished or not.

    Raises:
        ResultsError: a folder holds no results, or damaged ones.
        ValueError: a run is not of cages of Placement alone.
    """
    lines = []
    for folder in folders:
        manifest, rows = read_results(folder)
        if {(cell.task, cell.family) for cell in manifest.cells} != {("Placement", "cage")}:
            raise ValueError(f"{folder} must be a run of cages of Placement alone")
        ordered = sorted(rows, key=lambda row: (row.method, row.seed))
        lines += [_episode_line(row, _CAGE) for row in ordered]
    return lines


@dataclass(frozen=True)
class SuiteRows:
    """Episodes of a suite as they ship.

    Attributes:
        lines: one for each episode of each method.
        left_out: how many a folder holds, by its path, that are of other code than `lines` are.
    """

    lines: list[Line]
    left_out: dict[Path, int]


def suite_rows(suite: str, folders: Sequence[Path]) -> SuiteRows:
    """Return a line for each episode of some runs of the frozen lists of a suite.

    What a method has played of a task is of one code, that of the first folder with any of it; what
    later ones hold of other code is left out. Of an episode that two runs have played by the same
    method, the line is that of the first.

    Args:
        suite: one of `SHIPPED_SUITES`.
        folders: of results, finished or not.

    Raises:
        ResultsError: a folder holds no results, or damaged ones.
        ValueError: a run is of other scenes.
    """
    found: dict[tuple[str, tuple[str, ...], int], EpisodeRow] = {}
    codes: dict[tuple[str, str], str] = {}
    order: dict[str, int] = {}
    left_out = {}
    for folder in folders:
        manifest, rows = read_results(folder)
        if not manifest.frozen or not set(manifest.cells) <= set(SUITES[suite]):
            raise ValueError(f"{folder} must be a run of the frozen lists of the suite {suite}")
        for method in manifest.methods:
            order.setdefault(method, len(order))
        for row in rows:
            codes.setdefault((row.method, row.task), manifest.code)
        own = [row for row in rows if codes[row.method, row.task] == manifest.code]
        if len(own) < len(rows):
            left_out[folder] = len(rows) - len(own)
        for row in own:
            found.setdefault((row.method, *_episode(row)), row)
    kept = sorted(found.values(), key=lambda row: (order[row.method], *_episode(row)))
    return SuiteRows([_episode_line(row, _SUITE) for row in kept], left_out)


def _episode(row: EpisodeRow) -> tuple[tuple[str, ...], int]:
    return (row.task, row.family, row.difficulty, row.half), row.seed


def _episode_line(row: EpisodeRow, columns: Sequence[str]) -> Line:
    line = {}
    for name in columns:
        value = getattr(row, name)
        number = isinstance(value, float) or value is None
        line[name] = _rounded(value) if number else str(int(value) if name == "success" else value)
    return line


def set_rows(path: Path, measures: Sequence[str] = _SETS) -> list[Line]:
    """Return a line for each method in each scene.

    Args:
        path: ``sets.csv`` of `scripts/unselected_scenes.py`.
        measures: columns of it that are kept.

    Raises:
        OSError: the file is not there.
        ValueError: it lacks a column, or a measure is no number.
    """
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    needed = {"task", "method", "seed", *measures}
    if missing := sorted(needed - set(rows[0] if rows else ())):
        raise ValueError(f"{path} must have the columns {', '.join(missing)}")
    return [
        {"task": row["task"], "method": row["method"], "seed": f"{float(row['seed']):.0f}"}
        | {name: _rounded(row[name]) for name in measures}
        for row in rows
    ]


def ship(lines: Sequence[Line], path: Path) -> None:
    """Write lines as a table in CSV, compressed, the same bytes for the same lines.

    Args:
        lines: at least one, all with the same columns.
        path: of the file, whose folder is made if there is none.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as aside:
        aside.write_bytes(gzip.compress(text.getvalue().encode("utf-8"), mtime=0))


def _rounded(value: str | float | None) -> str:
    """Return a number with so many digits as are shipped; empty where there is none."""
    return "" if value in ("", None) else f"{float(value):.{_DIGITS}g}"
