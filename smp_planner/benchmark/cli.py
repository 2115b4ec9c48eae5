"""The command ``smp-bench``: measure methods, show results, draw one episode."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from smp_planner.benchmark.options import INTERRUPTED, progress_bar, split_names

if TYPE_CHECKING:
    from smp_planner.benchmark.episodes import EpisodeRow
    from smp_planner.benchmark.manifest import Manifest

__all__ = ["app"]

_MAP_SCENES = 20
_FIRST_SEED = 100_000

app = typer.Typer(
    name="smp-bench",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help=(
        "Measure planners on randomised manipulation episodes, judged by the physics engine.\n\n"
        "Start with [bold]smp-bench list[/bold], then for example:\n\n"
        "[green]smp-bench run --methods smp,promp --episodes 20 --out results/first[/green]"
    ),
)

_Difficulty = Annotated[
    str, typer.Option(help="How many obstacles on each route: none 0, easy 2, medium 4, hard 6.")
]

_Family = Annotated[
    str,
    typer.Option(
        help="Of the scenes: obstacles, shelf, box, cage, table, clutter, moving or displaced; "
        "not every task has all of them."
    ),
]


def _console(error: bool = False) -> Console:
    return Console(stderr=error, highlight=False)


def _fail(message: str, code: int) -> typer.Exit:
    _console(error=True).print(f"[bold red]error:[/] {escape(message)}", soft_wrap=True)
    return typer.Exit(code)


@app.command("list")
def list_command() -> None:
    """List the tasks, methods, difficulties and families that `run` accepts."""
    from smp_gym.scene import DIFFICULTIES, EVALUATION_SEEDS_START, FAMILIES, TASKS
    from smp_planner.planners.registry import installed_methods, known_methods

    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_row("[bold]tasks[/]", ", ".join(TASKS))
    table.add_row("[bold]methods[/]", ", ".join((*known_methods(), *installed_methods())))
    table.add_row("[bold]difficulties[/]", ", ".join(DIFFICULTIES))
    table.add_row("[bold]families[/]", ", ".join(FAMILIES))
    table.add_row(
        "[bold]seeds[/]",
        f"tuning 0–{EVALUATION_SEEDS_START - 1}, evaluation {EVALUATION_SEEDS_START} and up",
    )
    _console().print(table)


@app.command()
def run(
    out: Annotated[Path, typer.Option(help="Folder of the results; made if there is none.")],
    tasks: Annotated[
        str, typer.Option(metavar="NAMES", help="Names of tasks, separated by commas.")
    ] = "Placement",
    methods: Annotated[
        str,
        typer.Option(
            metavar="NAMES",
            help="Names of methods, separated by commas; name=module:Class is one of your own.",
        ),
    ] = "smp,promp",
    episodes: Annotated[int, typer.Option(min=1, help="Episodes for each task and method.")] = 20,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Seed of the first episode; episode k has seed + k, the same scene for every "
            "method. Tune on seeds below 100000 only. Default: 100000.",
        ),
    ] = None,
    difficulty: _Difficulty = "medium",
    family: _Family = "obstacles",
    frozen: Annotated[
        bool,
        typer.Option(
            "--frozen",
            help="Play the first episodes of the frozen lists, half of them sampled around a "
            "witness, half certified by RRT-Connect; the halves are also reported apart.",
        ),
    ] = False,
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
        bool, typer.Option(help="Draw the first episode of each task and method.")
    ] = True,
    video: Annotated[
        bool, typer.Option(help="Film the first episode of each task and method.")
    ] = True,
) -> None:
    """Play episodes and write table, figure and video.

    Writes into the folder [bold]--out[/bold]: [cyan]episodes.csv[/cyan] (a row per episode),
    [cyan]summary.json[/cyan] (rates with Wilson and means with bootstrap intervals),
    [cyan]scene_TASK_METHOD.png[/cyan] and [cyan]episode_TASK_METHOD.mp4[/cyan].

    Each row is stored as its episode ends. After an interruption the same command continues where
    it stopped; with more --episodes it adds to what is there. A folder of other settings, other
    package versions or other code is refused, unless --restart is given.

    Example: [green]smp-bench run --methods smp,promp --episodes 200 --seed 100000 --out
    results/medium[/green]
    """
    from smp_planner.benchmark.results_folder import ResultsError
    from smp_planner.benchmark.runner import EpisodeFailedError, WorkerDiedError
    from smp_planner.benchmark.worker_pool import available_cores

    first = seed if seed is not None else 0 if frozen else _FIRST_SEED
    manifest = _manifest(
        split_names(tasks),
        split_names(methods),
        difficulty,
        first,
        episodes,
        frozen=frozen,
        family=family,
    )
    workers = jobs or available_cores()
    try:
        rows = _run_with_progress(manifest, out, workers, restart)
    except ResultsError as error:
        raise _fail(str(error), 2) from error
    except (WorkerDiedError, EpisodeFailedError) as error:
        raise _fail(str(error), 1) from error
    except KeyboardInterrupt as error:
        message = f"interrupted; the episodes so far are kept in {str(out)!r}: the same command "
        raise _fail(message + "continues there", INTERRUPTED) from error
    _finish(manifest, rows, out)
    _draw(manifest, out, workers, figure, video)


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
    from smp_gym.sampling import sample_scene
    from smp_planner.benchmark.map_accuracy import measure_default_map
    from smp_planner.benchmark.results_folder import write_json
    from smp_planner.benchmark.summary import summarise, table, write_csv

    count = min(manifest.episodes, _MAP_SCENES)
    if manifest.frozen:
        lists = [load_episodes(task, manifest.difficulty)[:count] for task in manifest.tasks]
        scenes = [episode.scene for episodes in lists for episode in episodes]
    else:
        seeds = range(manifest.seed, manifest.seed + count)
        scenes = [
            sample_scene(task, manifest.difficulty, seed, manifest.family)
            for task in manifest.tasks
            for seed in seeds
        ]
    summary = summarise(manifest, rows, measure_default_map(scenes))
    write_csv(out / "episodes.csv", rows)
    write_json(out / "summary.json", summary)
    console = _console()
    console.print(table(summary))
    for name in ("episodes.csv", "summary.json"):
        console.print(f"wrote {escape(str(out / name))}", soft_wrap=True)


def _draw(
    manifest: Manifest, out: Path, jobs: int, figure: bool = True, video: bool = True
) -> None:
    """Play the first episode of each task and method again and write its figure and video."""
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
    """Show the table of a folder of results again."""
    from smp_planner.benchmark.manifest import read_results
    from smp_planner.benchmark.results_folder import ResultsError
    from smp_planner.benchmark.summary import summarise, table

    try:
        manifest, rows = read_results(folder)
    except ResultsError as error:
        raise _fail(str(error), 2) from error
    summary = summarise(manifest, rows)
    if as_json:
        typer.echo(json.dumps(summary, indent=2))
        return
    console = _console()
    console.print(table(summary))
    total = len(manifest.episode_keys())
    if len(rows) < total:
        console.print(f"unfinished: {len(rows)} of {total} episodes")


@app.command()
def draw(
    out: Annotated[Path, typer.Option(help="Folder of figure and video; made if there is none.")],
    task: Annotated[str, typer.Option(help="Name of the task.")] = "Placement",
    method: Annotated[str, typer.Option(help="Name of the method, or name=module:Class.")] = "smp",
    difficulty: _Difficulty = "medium",
    family: _Family = "obstacles",
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = 100_000,
    figure: Annotated[bool, typer.Option(help="Draw scene and particles.")] = True,
    video: Annotated[bool, typer.Option(help="Film the episode.")] = True,
) -> None:
    """Play one episode and write its figure and its video.

    Example: [green]smp-bench draw --method smp --seed 7 --out results/seven[/green]
    """
    manifest = _manifest((task,), (method,), difficulty, seed, 1, family=family)
    _draw(manifest, out, 1, figure, video)
