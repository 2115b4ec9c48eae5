"""Commands of ``smp-bench`` that read a folder of results into other files: export and import."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape

from smp_planner.benchmark.options import Names, chosen_names, one_of, pooled, split_names

if TYPE_CHECKING:
    from smp_planner.benchmark.episodes import EpisodeRow

__all__ = ["export", "import_results"]

_FORMATS = ("csv", "parquet", "npz")


def export(
    folder: Annotated[
        Path, typer.Argument(help="Folder that `run` wrote, finished or not.", file_okay=False)
    ],
    format: Annotated[
        str,
        typer.Option(
            help="csv or parquet: a file of rows; npz: a file for each episode, which is played "
            "again, with its particle set, its scene and the executed path."
        ),
    ] = "csv",
    out: Annotated[
        Path | None,
        typer.Option(
            help="File, or folder for npz. Default: episodes.csv, episodes.parquet or particles "
            "in the folder."
        ),
    ] = None,
    cells: Names = "",
    methods: Names = "",
    seeds: Annotated[
        str, typer.Option(metavar="NUMBERS", help="Separated by commas. Default: all.")
    ] = "",
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes for npz.")] = 1,
) -> None:
    """Write the rows of a folder of results, or the particle sets of its episodes, for others.

    Example: [green]smp-bench export results/tight --format npz --methods smp --seeds 3,7[/green]
    """
    from smp_planner.benchmark.exports import export_episode, write_csv, write_parquet
    from smp_planner.benchmark.manifest import read_results

    one_of(format, _FORMATS, "--format")
    manifest, rows = read_results(folder)
    chosen = _chosen(rows, cells, methods, seeds, [cell.name for cell in manifest.cells])
    path = out or folder / ("particles" if format == "npz" else f"episodes.{format}")
    console = Console(highlight=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    if format == "npz":
        path.mkdir(parents=True, exist_ok=True)
        write = partial(export_episode, manifest.player, path)
        pooled(write, chosen, "episodes", Console(stderr=True), jobs=jobs)
    elif format == "csv":
        write_csv(path, chosen)
    else:
        try:
            write_parquet(path, chosen)
        except ModuleNotFoundError as error:
            raise typer.BadParameter(str(error), param_hint="--format") from error
    console.print(f"wrote {len(chosen)} episodes: {escape(str(path))}", soft_wrap=True)


def _chosen(
    rows: Sequence[EpisodeRow], cells: str, methods: str, seeds: str, known_cells: Sequence[str]
) -> list[EpisodeRow]:
    """Return the rows of cells, methods and seeds by their names.

    Raises:
        typer.BadParameter: the folder has none of one.
    """
    known = sorted({str(row.seed) for row in rows}, key=int)
    named = set(chosen_names(cells, known_cells, "--cells"))
    played = set(chosen_names(methods, sorted({row.method for row in rows}), "--methods"))
    for seed in split_names(seeds):
        if seed not in known:
            raise typer.BadParameter(f"no row has the seed {seed!r}", param_hint="--seeds")
    numbers = set(split_names(seeds) or known)
    chosen = [
        row
        for row in rows
        if row.key.cell.name in named and row.method in played and str(row.seed) in numbers
    ]
    if not chosen:
        raise typer.BadParameter("the folder holds no such episode", param_hint="FOLDER")
    return chosen


def import_results(
    old: Annotated[
        Path, typer.Argument(help="Folder that an older version wrote.", file_okay=False)
    ],
    out: Annotated[
        Path, typer.Option(help="Folder of the results; made if there is none.", file_okay=False)
    ],
) -> None:
    """Copy results of an older version (episodes.jsonl) into a folder of today.

    The old folder is left as it is. The new one holds the same manifest: it can be shown, compared
    and exported; `run` adds to it only where code and packages are still those of its rows.

    Example: [green]smp-bench import results/old --out results/new[/green]
    """
    from smp_planner.benchmark.old_results import import_results as copy

    manifest, rows = copy(old, out)
    total = len(manifest.episode_keys())
    Console(highlight=False).print(
        f"imported {len(rows)} of {total} episodes: {escape(str(out))}", soft_wrap=True
    )
