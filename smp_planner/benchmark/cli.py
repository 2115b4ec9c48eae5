"""The command ``smp-bench``: measure methods, show results, draw or watch one episode."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from smp_planner.benchmark.cell_options import (
    Difficulty,
    Family,
    Latency,
    Lists,
    Noise,
    ReplanEvery,
    Sensing,
    chosen_cells,
    fail,
    replanning,
    requested_manifest,
)
from smp_planner.benchmark.comparison_command import compare
from smp_planner.benchmark.drawing_command import draw, draw_episodes
from smp_planner.benchmark.folder_commands import export, import_results
from smp_planner.benchmark.options import (
    CommandLine,
    Interrupted,
    one_of,
    print_error,
    progress_bar,
    split_names,
)
from smp_planner.benchmark.report_command import report
from smp_planner.benchmark.watching_command import watch

if TYPE_CHECKING:
    from smp_planner.benchmark.episodes import EpisodeRow
    from smp_planner.benchmark.manifest import Manifest
    from smp_planner.benchmark.worker_pool import Backend

__all__ = ["app"]

_MAP_SCENES = 20
_EPISODES = 20

app = CommandLine(
    name="smp-bench",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help=(
        "Measure planners and agents on randomised manipulation episodes, judged by the physics "
        "engine.\n\n"
        "Start with [bold]smp-bench list[/bold], then for example:\n\n"
        "[green]smp-bench run --methods smp,promp --episodes 20 --out results/first[/green]"
    ),
)


def _console(error: bool = False) -> Console:
    return Console(stderr=error, highlight=False)


@app.command("list")
def list_command() -> None:
    """List the suites, tasks, methods, difficulties and families that `run` accepts."""
    from smp_gym.observation import SENSINGS
    from smp_gym.scene import (
        DIFFICULTIES,
        EVALUATION_RANGE_START,
        EVALUATION_SEEDS_START,
        FAMILIES,
        TASKS,
    )
    from smp_gym.suites import SUITES
    from smp_planner.benchmark.methods import known_methods_and_agents

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_row("[bold]tasks[/]", ", ".join(TASKS))
    table.add_row("[bold]methods[/]", ", ".join(known_methods_and_agents()))
    table.add_row("[bold]difficulties[/]", ", ".join(DIFFICULTIES))
    table.add_row("[bold]families[/]", ", ".join(FAMILIES))
    table.add_row("[bold]sensing[/]", ", ".join(SENSINGS))
    table.add_row(
        "[bold]seeds[/]",
        f"tuning 0–{EVALUATION_SEEDS_START - 1}, looked at {EVALUATION_SEEDS_START}–"
        f"{EVALUATION_RANGE_START - 1}, evaluation {EVALUATION_RANGE_START} and up",
    )
    for name, cells in SUITES.items():
        named = ", ".join(cell.name for cell in cells) or "no task has its families"
        table.add_row(f"[bold]suite {name}[/]", named)
    _console().print(table)


@app.command()
def run(
    out: Annotated[
        Path, typer.Option(help="Folder of the results; made if there is none.", file_okay=False)
    ],
    suite: Annotated[
        str,
        typer.Option(
            help="Play the cells of a suite, from their frozen lists: standard, tight, perception "
            "or dynamic."
        ),
    ] = "",
    tasks: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="Names of tasks, separated by commas. Default: all of a suite, else Placement.",
        ),
    ] = "",
    cells: Annotated[
        str,
        typer.Option(
            metavar="NAMES", help="Names of cells of the suite, separated by commas. Default: all."
        ),
    ] = "",
    methods: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="Names of methods, separated by commas; name=module:Class is a planner or an "
            "agent of your own, name=path.zip an agent that stable-baselines3 saved: loading it "
            "runs code that the file holds, so name only files that you trust.",
        ),
    ] = "smp,promp",
    episodes: Annotated[
        int, typer.Option(min=1, help="Episodes for each cell and method.")
    ] = _EPISODES,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Seed of the first episode; episode k has seed + k, the same scene for every "
            "method. Tune on seeds below 100000 only. With --suite, scenes are then drawn in place "
            "of the frozen lists. Default: 0.",
        ),
    ] = None,
    difficulty: Difficulty = None,
    family: Family = None,
    sensing: Sensing = None,
    noise: Noise = None,
    frozen: Annotated[
        bool,
        typer.Option(
            "--frozen",
            help="Play the first episodes of the frozen lists of single cells; where half of a "
            "list is sampled around witnesses and half placed without, the halves are also "
            "reported apart.",
        ),
    ] = False,
    lists: Lists = None,
    replan_every: ReplanEvery = None,
    latency: Latency = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Worker processes; rows do not depend on it. Default: all cores."),
    ] = None,
    backend: Annotated[
        str,
        typer.Option(
            help="Kind of workers: processes of this machine, or those of a Ray cluster that "
            "RAY_ADDRESS names (ray)."
        ),
    ] = "processes",
    restart: Annotated[
        bool,
        typer.Option(
            "--restart", help="Start anew if the folder holds results of other settings or code."
        ),
    ] = False,
    figure: Annotated[
        bool | None,
        typer.Option(
            "--figure/--no-figure",
            help="Draw the first episode of each cell and method. Default: without --suite.",
        ),
    ] = None,
    video: Annotated[
        bool | None,
        typer.Option(
            "--video/--no-video",
            help="Film the first episode of each cell and method. Default: without --suite.",
        ),
    ] = None,
) -> None:
    """Play episodes and write table, figure and video.

    Writes into the folder [bold]--out[/bold]: [cyan]results.sqlite[/cyan] (all of the run: a row
    per episode, its scene, settings and versions), and from it [cyan]episodes.csv[/cyan],
    [cyan]summary.json[/cyan] (rates with Wilson and means with bootstrap intervals),
    [cyan]scene_CELL_METHOD.png[/cyan] and [cyan]episode_CELL_METHOD.mp4[/cyan].

    Each row is stored as its episode ends. After an interruption the same command continues where
    it stopped; with more --episodes it adds to what is there. A folder of other settings, other
    package versions or other code is refused, unless --restart is given.

    Example: [green]smp-bench run --suite tight --methods smp,rrt_connect --episodes 100 --out
    results/tight[/green]
    """
    from smp_planner.benchmark.results_folder import ResultsError
    from smp_planner.benchmark.runner import EpisodeFailedError, WorkerDiedError
    from smp_planner.benchmark.worker_pool import BACKENDS, available_cores

    single = {"difficulty": difficulty, "family": family, "sensing": sensing, "noise": noise}
    listed = frozen or (bool(suite) and seed is None)
    if lists is not None and not listed:
        raise fail("--lists needs --frozen, or --suite without --seed, got it without", 2)
    chosen = chosen_cells(suite, split_names(tasks), split_names(cells), single)
    manifest = requested_manifest(
        chosen,
        split_names(methods),
        seed or 0,
        episodes,
        frozen=listed,
        suite=suite,
        lists=lists,
        **replanning(replan_every, latency),
    )
    kind = cast("Backend", one_of(backend, BACKENDS, "--backend"))
    try:
        workers = jobs or available_cores(kind)
        rows = _run_with_progress(manifest, out, workers, restart, kind)
    except (ResultsError, ModuleNotFoundError) as error:
        raise fail(str(error), 2) from error
    except (WorkerDiedError, EpisodeFailedError) as error:
        raise fail(str(error), 1) from error
    except Interrupted:
        print_error(
            f"interrupted; the episodes so far are kept in {str(out)!r}: the same command "
            "continues there"
        )
        raise
    _finish(manifest, rows, out)
    drawn = not suite
    draw_episodes(
        manifest,
        out,
        # What is drawn, is drawn here.
        jobs=workers if kind == "processes" else available_cores(),
        figure=drawn if figure is None else figure,
        video=drawn if video is None else video,
    )


def _run_with_progress(
    manifest: Manifest, out: Path, jobs: int, restart: bool, backend: Backend
) -> list[EpisodeRow]:
    from smp_planner.benchmark.runner import run as run_episodes

    with progress_bar("episodes", None, _console(error=True)) as (progress, bar):
        return run_episodes(
            manifest,
            out,
            jobs=jobs,
            backend=backend,
            restart=restart,
            on_progress=lambda done, total: progress.update(bar, completed=done, total=total),
        )


def _finish(manifest: Manifest, rows: list[EpisodeRow], out: Path) -> None:
    """Write rows and summary, and show the summary."""
    from smp_gym.datasets.frozen import load_episodes
    from smp_planner.benchmark.map_accuracy import measure_default_map
    from smp_planner.benchmark.results_folder import write_json
    from smp_planner.benchmark.summary import summarise, write_csv

    count = min(manifest.episodes, max(1, _MAP_SCENES // len(manifest.cells)))
    scenes = []
    for cell in manifest.cells:
        if manifest.frozen:
            episodes = load_episodes(cell, manifest.lists_folder)[:count]
            scenes += [episode.scene for episode in episodes]
        else:
            scenes += [cell.scene(manifest.seed + k) for k in range(count)]
    summary = summarise(manifest, rows, measure_default_map(scenes))
    write_csv(out / "episodes.csv", rows)
    write_json(out / "summary.json", summary)
    console = _console()
    _show(summary, console)
    for name in ("episodes.csv", "summary.json"):
        console.print(f"wrote {escape(str(out / name))}", soft_wrap=True)


def _show(summary: Mapping[str, Any], console: Console) -> None:
    """Print a table for each cell, and the rates of all of them."""
    from smp_planner.benchmark.summary import overview, tables

    for shown in tables(summary):
        console.print(shown)
    if len(summary["cells"]) > 1:
        console.print(overview(summary))


@app.command()
def show(
    folder: Annotated[
        Path, typer.Argument(help="Folder that `run` wrote, finished or not.", file_okay=False)
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Show the tables of a folder of results again."""
    from smp_planner.benchmark.manifest import read_results
    from smp_planner.benchmark.results_folder import ResultsError
    from smp_planner.benchmark.summary import summarise

    try:
        manifest, rows = read_results(folder)
    except ResultsError as error:
        raise fail(str(error), 2) from error
    summary = summarise(manifest, rows)
    if as_json:
        typer.echo(json.dumps(summary, indent=2))
        return
    console = _console()
    _show(summary, console)
    total = len(manifest.episode_keys())
    if len(rows) < total:
        console.print(f"unfinished: {len(rows)} of {total} episodes")


app.command()(export)
app.command("import")(import_results)
app.command()(draw)
app.command()(watch)
app.command()(compare)
app.command()(report)
