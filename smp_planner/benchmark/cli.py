"""The command ``smp-bench``: measure methods, show results, draw one episode."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from smp_planner.benchmark.options import (
    CommandLine,
    Interrupted,
    print_error,
    progress_bar,
    split_names,
)

if TYPE_CHECKING:
    from smp_gym.suites import Cell
    from smp_planner.benchmark.episodes import EpisodeRow
    from smp_planner.benchmark.manifest import Manifest

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

_Difficulty = Annotated[
    str | None,
    typer.Option(help="Of single cells: none, easy, medium or hard. Default: medium."),
]

_Family = Annotated[
    str | None,
    typer.Option(
        help="Of the scenes of single cells: obstacles, shelf, box, cage, table, clutter, moving "
        "or displaced; not every task has all of them. Default: obstacles."
    ),
]

_Sensing = Annotated[
    str | None,
    typer.Option(
        help="What observations of single cells say of obstacles: exact rows, rows with noise, or "
        "a depth camera's points. Default: exact."
    ),
]

_Noise = Annotated[
    float | None,
    typer.Option(help="Standard deviation of perceived positions with --sensing noise, m."),
]


def _console(error: bool = False) -> Console:
    return Console(stderr=error, highlight=False)


def _fail(message: str, code: int) -> typer.Exit:
    print_error(message)
    return typer.Exit(code)


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
    out: Annotated[Path, typer.Option(help="Folder of the results; made if there is none.")],
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
            help="Names of methods, separated by commas; name=module:Class is a planner of your "
            "own, name=path.zip an agent that stable-baselines3 saved: loading it runs code that "
            "the file holds, so name only files that you trust.",
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
    difficulty: _Difficulty = None,
    family: _Family = None,
    sensing: _Sensing = None,
    noise: _Noise = None,
    frozen: Annotated[
        bool,
        typer.Option(
            "--frozen",
            help="Play the first episodes of the frozen lists of single cells; where half of a "
            "list is sampled around witnesses and half placed without, the halves are also "
            "reported apart.",
        ),
    ] = False,
    lists: Annotated[
        Path | None,
        typer.Option(help="Folder of frozen lists. Default: that of the package."),
    ] = None,
    replan_every: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Make plans anew after so many control steps at the latest, of methods that can: "
            "smp, promp. Default: plan once.",
        ),
    ] = None,
    latency: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Control steps from asking for a plan to its taking effect, whatever the machine; "
            "with --replan-every. Default: 2.",
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Worker processes; rows do not depend on it. Default: all cores."),
    ] = None,
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

    Writes into the folder [bold]--out[/bold]: [cyan]episodes.csv[/cyan] (a row per episode),
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
    from smp_planner.benchmark.worker_pool import available_cores

    single = {"difficulty": difficulty, "family": family, "sensing": sensing, "noise": noise}
    chosen = _cells(suite, split_names(tasks), split_names(cells), single)
    manifest = _manifest(
        chosen,
        split_names(methods),
        seed or 0,
        episodes,
        frozen=frozen or (bool(suite) and seed is None),
        suite=suite,
        lists=lists,
        **_replanning(replan_every, latency),
    )
    workers = jobs or available_cores()
    try:
        rows = _run_with_progress(manifest, out, workers, restart)
    except ResultsError as error:
        raise _fail(str(error), 2) from error
    except (WorkerDiedError, EpisodeFailedError) as error:
        raise _fail(str(error), 1) from error
    except Interrupted:
        print_error(
            f"interrupted; the episodes so far are kept in {str(out)!r}: the same command "
            "continues there"
        )
        raise
    _finish(manifest, rows, out)
    drawn = not suite
    _draw(
        manifest,
        out,
        workers,
        drawn if figure is None else figure,
        drawn if video is None else video,
    )


def _replanning(replan_every: int | None, latency: int | None) -> dict[str, int]:
    """Return the arguments of `make_manifest` that say when plans are made anew."""
    if replan_every is None:
        if latency is not None:
            raise _fail(f"--latency needs --replan-every, got --latency {latency} without", 2)
        return {}
    return {"replan_every": replan_every} | ({} if latency is None else {"latency": latency})


def _cells(
    suite: str, tasks: Sequence[str], names: Sequence[str], single: Mapping[str, Any]
) -> tuple[Cell, ...]:
    """Return the cells of a suite, or one for each task.

    Args:
        suite: its name; empty for single cells.
        tasks: names; none for all of a suite, or for Placement.
        names: of cells of the suite; none for all.
        single: the fields of single cells that were given, and None for the others.
    """
    from smp_gym.suites import Cell, suite_cells

    given = {name: value for name, value in single.items() if value is not None}
    try:
        if suite:
            if given:
                raise ValueError(
                    f"--{next(iter(given))} is of single cells, got it with --suite {suite}: "
                    "choose cells of a suite by --tasks and --cells"
                )
            return suite_cells(suite, tasks, names)
        if names:
            raise ValueError(f"--cells needs --suite, got --cells {','.join(names)} without")
        return tuple(
            Cell(task, **{"difficulty": "medium", **given}) for task in tasks or ("Placement",)
        )
    except ValueError as error:
        raise _fail(str(error), 2) from error


def _manifest(*arguments: Any, **options: Any) -> Manifest:
    """Return `make_manifest` of arguments; modules of the working directory are found, too."""
    from smp_planner.benchmark.manifest import make_manifest

    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        return make_manifest(*arguments, **options)
    except ValueError as error:
        raise _fail(str(error), 2) from error


def _run_with_progress(manifest: Manifest, out: Path, jobs: int, restart: bool) -> list[EpisodeRow]:
    from smp_planner.benchmark.runner import run as run_episodes

    with progress_bar("episodes", None, _console(error=True)) as (progress, bar):
        return run_episodes(
            manifest,
            out,
            jobs=jobs,
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


def _draw(
    manifest: Manifest, out: Path, jobs: int, figure: bool = True, video: bool = True
) -> None:
    """Play the first episode of each cell and method again and write its figure and video."""
    from smp_planner.benchmark.runner import draw as draw_episodes

    with _console(error=True).status("drawing figures and videos"):
        written = draw_episodes(manifest, out, jobs=jobs, figure=figure, video=video)
    for path in written:
        _console().print(f"wrote {escape(str(path))}", soft_wrap=True)


@app.command()
def show(
    folder: Annotated[Path, typer.Argument(help="Folder that `run` wrote, finished or not.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Show the tables of a folder of results again."""
    from smp_planner.benchmark.manifest import read_results
    from smp_planner.benchmark.results_folder import ResultsError
    from smp_planner.benchmark.summary import summarise

    try:
        manifest, rows = read_results(folder)
    except ResultsError as error:
        raise _fail(str(error), 2) from error
    summary = summarise(manifest, rows)
    if as_json:
        typer.echo(json.dumps(summary, indent=2))
        return
    console = _console()
    _show(summary, console)
    total = len(manifest.episode_keys())
    if len(rows) < total:
        console.print(f"unfinished: {len(rows)} of {total} episodes")


@app.command()
def draw(
    out: Annotated[Path, typer.Option(help="Folder of figure and video; made if there is none.")],
    task: Annotated[str, typer.Option(help="Name of the task.")] = "Placement",
    method: Annotated[
        str,
        typer.Option(
            help="Name of the method, name=module:Class, or name=path.zip, which runs code."
        ),
    ] = "smp",
    difficulty: _Difficulty = None,
    family: _Family = None,
    sensing: _Sensing = None,
    noise: _Noise = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = 0,
    figure: Annotated[bool, typer.Option(help="Draw scene and particles.")] = True,
    video: Annotated[bool, typer.Option(help="Film the episode.")] = True,
) -> None:
    """Play one episode and write its figure and its video.

    Example: [green]smp-bench draw --method smp --seed 7 --out results/seven[/green]
    """
    single = {"difficulty": difficulty, "family": family, "sensing": sensing, "noise": noise}
    manifest = _manifest(_cells("", (task,), (), single), (method,), seed, 1)
    _draw(manifest, out, 1, figure, video)
