"""Put rows of experiments among the assets, so that the tables of the documents can be recounted.

lasa takes the tables on handwriting, narrow-places those of public arms in narrow places, cages the
episodes of Placement in cages, sets the particle sets on frozen scenes, sides those on scenes with
two goals, standard and tight the episodes of the suites of these names.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from smp_planner.benchmark.markdown_table import markdown_table
from smp_planner.benchmark.options import CommandLine, tell
from smp_planner.experiments.set_summary import ratio_table, set_table
from smp_planner.experiments.shipped_rows import (
    CAGES,
    LASA,
    NARROW_PLACES,
    SETS,
    SHIPPED_SUITES,
    SIDES,
    SIDES_MEASURES,
    cage_rows,
    lasa_rows,
    narrow_rows,
    set_rows,
    ship,
    suite_rows,
)
from smp_planner.experiments.suite_summary import (
    cell_table,
    equal_episodes,
    method_table,
    pair_table,
)

app = CommandLine(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, help=__doc__
)

_Out = Annotated[Path, typer.Option(help="Folder to write.", file_okay=False)]
_Runs = Annotated[list[Path], typer.Argument(help="That smp-bench run wrote.", file_okay=False)]
_Method = Annotated[str, typer.Option(help="Held against each of the others.")]
_RESULTS = Path("envs_assets/results")


@app.command()
def lasa(
    folder: Annotated[
        Path, typer.Argument(help="Into which scripts/lasa.py wrote.", file_okay=False)
    ],
    out: _Out = _RESULTS,
) -> None:
    """Ship the rows of Fig. 1, Fig. 2, Table I, all shapes and the posterior.

    Example: python scripts/ship_rows.py lasa results/lasa
    """
    _write(lasa_rows(folder), out / LASA)


@app.command("narrow-places")
def narrow_places(
    file: Annotated[Path, typer.Argument(help="Of scripts/narrow_places.py.", dir_okay=False)],
    out: _Out = _RESULTS,
) -> None:
    """Ship which methods solve each problem in narrow places.

    Example: python scripts/ship_rows.py narrow-places results/narrow_places.json
    """
    _write(narrow_rows(file), out / NARROW_PLACES)


@app.command()
def cages(folders: _Runs, out: _Out = _RESULTS) -> None:
    """Ship the episodes of Placement in cages.

    Example: python scripts/ship_rows.py cages results/cages results/cages_rivals
    """
    _write(cage_rows(folders), out / CAGES)


@app.command()
def sets(
    folders: Annotated[
        list[Path], typer.Argument(help="Of scripts/unselected_scenes.py.", file_okay=False)
    ],
    out: _Out = _RESULTS,
) -> None:
    """Ship the rows of particle sets, and print their means and distances to the posterior.

    Example: python scripts/ship_rows.py sets results/sets results/further_sets
    """
    of_folders = [set_rows(folder / "sets.csv") for folder in folders]
    _write([line for lines in of_folders for line in lines], out / SETS)
    for folder, lines in zip(folders, of_folders, strict=True):
        for table in (set_table(lines), ratio_table(lines)):
            tell(f"{folder}:\n\n{markdown_table(table)}\n")


@app.command()
def sides(
    folder: Annotated[
        Path, typer.Argument(help="Of scripts/unselected_scenes.py.", file_okay=False)
    ],
    out: _Out = _RESULTS,
) -> None:
    """Ship the shares of goals in particle sets, and print their means.

    Example: python scripts/ship_rows.py sides results/sides
    """
    lines = set_rows(folder / "sets.csv", SIDES_MEASURES)
    _write(lines, out / SIDES)
    tell(markdown_table(set_table(lines, [(name, 2) for name in SIDES_MEASURES])))


@app.command()
def standard(folders: _Runs, method: _Method = "smp", out: _Out = _RESULTS) -> None:
    """Ship the episodes of the suite standard, and print its tables.

    Example: python scripts/ship_rows.py standard results/standard
    """
    _suite("standard", folders, method, "task", out)


@app.command()
def tight(folders: _Runs, method: _Method = "smp", out: _Out = _RESULTS) -> None:
    """Ship the episodes of the suite tight, and print its tables, by family.

    Example: python scripts/ship_rows.py tight results/tight
    """
    _suite("tight", folders, method, "family", out)


def _suite(suite: str, folders: Sequence[Path], method: str, by: str, out: Path) -> None:
    """Ship the episodes of a suite, and print its tables by task or family."""
    found = suite_rows(suite, folders)
    for folder, count in found.left_out.items():
        tell(f"left out {count} rows of {folder}, which are of other code")
    methods = {line["method"] for line in found.lines}
    if method not in methods:
        allowed = ", ".join(sorted(methods))
        raise typer.BadParameter(f"got {method!r}, allowed are {allowed}", param_hint="--method")
    _write(found.lines, out / SHIPPED_SUITES[suite])
    episodes = equal_episodes(found.lines)
    tell(f"{len(episodes)} episodes that all have played")
    for table in (
        method_table(episodes, by),
        pair_table(episodes, method, by),
        cell_table(found.lines, method, by),
    ):
        tell(f"\n{markdown_table(table)}")


def _write(lines: Sequence[dict[str, str]], path: Path) -> None:
    ship(lines, path)
    tell(f"wrote {len(lines)} rows to {path}")


if __name__ == "__main__":
    app()
