"""The command ``smp-bench draw``: one episode played again, as a figure and a video."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

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

if TYPE_CHECKING:
    from smp_gym.suites import Cell
    from smp_planner.benchmark.episodes import EpisodeKey
    from smp_planner.benchmark.manifest import Manifest

__all__ = ["Half", "Method", "draw", "draw_episodes", "one_episode"]

Method = Annotated[
    str,
    typer.Option(help="Name of the method, name=module:Class, or name=path.zip, which runs code."),
]
"""Option for the method of one episode."""

Half = Annotated[
    str,
    typer.Option(
        help="Half of a frozen list, witness or placed; the seed then names an episode of it."
    ),
]
"""Option for where that episode is from."""


def draw_episodes(
    manifest: Manifest,
    out: Path,
    keys: Sequence[EpisodeKey] = (),
    *,
    jobs: int = 1,
    figure: bool = True,
    video: bool = True,
) -> None:
    """Play episodes again, write their figures and videos, and say where; see `runner.draw`."""
    from smp_planner.benchmark import runner

    with Console(stderr=True).status("drawing figures and videos"):
        written = runner.draw(manifest, out, keys, jobs=jobs, figure=figure, video=video)
    for path in written:
        Console(highlight=False).print(f"wrote {escape(str(path))}", soft_wrap=True)


def draw(
    out: Annotated[
        Path,
        typer.Option(help="Folder of figure and video; made if there is none.", file_okay=False),
    ],
    task: Annotated[str, typer.Option(help="Name of the task.")] = "Placement",
    method: Method = "smp",
    difficulty: Difficulty = None,
    family: Family = None,
    sensing: Sensing = None,
    noise: Noise = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = 0,
    half: Half = "",
    lists: Lists = None,
    replan_every: ReplanEvery = None,
    latency: Latency = None,
    figure: Annotated[bool, typer.Option(help="Draw scene and particles.")] = True,
    video: Annotated[bool, typer.Option(help="Film the episode.")] = True,
) -> None:
    """Play one episode and write its figure and its video.

    Example: [green]smp-bench draw --method smp --seed 7 --out results/seven[/green]
    """
    single = {"difficulty": difficulty, "family": family, "sensing": sensing, "noise": noise}
    replanned = replanning(replan_every, latency)
    manifest, key = one_episode(task, method, seed, half, lists, single, replanned)
    draw_episodes(manifest, out, [key], figure=figure, video=video)


def one_episode(
    task: str,
    method: str,
    seed: int,
    half: str,
    lists: Path | None,
    single: Mapping[str, Any],
    replanned: Mapping[str, Any],
) -> tuple[Manifest, EpisodeKey]:
    """Return the manifest of a run of one episode, and its key; ends the command on bad options.

    Args:
        task: of the episode, as the next.
        method: spec of the method.
        seed: of the episode.
        half: of the frozen list that it is from; empty if its scene is drawn from the seed.
        lists: folder of the frozen lists.
        single: options of the cell by name.
        replanned: see `replanning`.
    """
    from smp_planner.benchmark.episodes import EpisodeKey

    (cell,) = chosen_cells("", (task,), (), single)
    if half:
        _check_listed(cell, half, seed, lists)
    elif lists is not None:
        raise fail("--lists needs --half, got it without", 2)
    manifest = requested_manifest((cell,), (method,), seed, 1, lists=lists, **replanned)
    return manifest, EpisodeKey.of(cell, manifest.methods[0], seed, half)


def _check_listed(cell: Cell, half: str, seed: int, lists: Path | None) -> None:
    """End the command unless the frozen list of a cell holds an episode."""
    from smp_gym.datasets.frozen import load_episodes

    try:
        seeds = [episode.seed for episode in load_episodes(cell, lists) if episode.half == half]
        if seed not in seeds:
            known = f"its seeds are {min(seeds)} to {max(seeds)}" if seeds else "it is empty"
            raise ValueError(
                f"no episode of seed {seed} in the half {half!r} of the frozen list of "
                f"{cell.name}; {known}"
            )
    except ValueError as error:
        raise fail(str(error), 2) from error
