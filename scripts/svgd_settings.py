"""Compare the settings of SVGD: success, similarity, ways, their weights, and diversity.

The weights of the ways round the obstacles are held against the exact posterior, which sequential
Monte Carlo draws from.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console
from rich.progress import track

from smp_planner.experiments.svgd_settings import EXACT, VARIANTS, Ground, settings_columns
from smp_planner.experiments.tables import rich_table, summarise, write_tables
from smp_planner.inference import SETTINGS
from smp_planner.inference.smc import SMCSettings


def main(
    domain: Annotated[
        Literal["lasa"], typer.Option(help="What is adapted: the S of LASA.")
    ] = "lasa",
    variant: Annotated[str, typer.Option(help="Scenes, by comma.")] = ",".join(VARIANTS),
    settings: Annotated[str, typer.Option(help="Settings, by comma.")] = ",".join(SETTINGS),
    particles: Annotated[int, typer.Option(min=2, help="Of each set.")] = 42,
    repetitions: Annotated[int, typer.Option(min=1, help="Of each setting.")] = 20,
    reference_particles: Annotated[int, typer.Option(min=2, help="Of each reference run.")] = 2000,
    reference_runs: Annotated[int, typer.Option(min=1, help="Of the reference.")] = 10,
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("results/svgd_settings"),
) -> None:
    """Write a table for each scene: CSV of all rows, JSON and Markdown of means and spreads.

    All scenes together take about ten minutes of one core.
    """
    console = Console()
    for wanted, known in ((variant, VARIANTS), (settings, SETTINGS)):
        for name in wanted.split(","):
            if name not in known:
                raise typer.BadParameter(f"must be one of {', '.join(known)}; got {name!r}")
    for name in variant.split(","):
        with console.status(f"{name}: drawing from the exact posterior"):
            ground = Ground.of(
                VARIANTS[name], reference_runs, SMCSettings(reference_particles, last_moves=100)
            )
            rows = list(ground.reference_rows())
        todo = [
            (setting, seed)
            for setting in [EXACT, *settings.split(",")]
            for seed in range(repetitions)
        ]
        for setting, seed in track(todo, name, console=console):
            rows.append(ground.row(setting, particles, seed))
        summaries, columns = summarise(rows, ["setting"]), settings_columns(ground)
        console.print(rich_table(summaries, columns, f"{domain}, {name}"))
        note = (
            f"{particles} particles, {repetitions} repetitions; the posterior by {reference_runs} "
            f"runs of {reference_particles} particles."
        )
        write_tables(rows, summaries, columns, out, f"{domain}_{name}", note)
    console.print(f"wrote {out}")


if __name__ == "__main__":
    typer.run(main)
