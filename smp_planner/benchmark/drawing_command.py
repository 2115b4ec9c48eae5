"""The command ``smp-bench draw``: one episode played again, as a figure and a video."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape

from smp_planner.benchmark.one_episode import plays_one_episode

if TYPE_CHECKING:
    from smp_planner.benchmark.episodes import EpisodeKey
    from smp_planner.benchmark.manifest import Manifest

__all__ = ["draw", "draw_episodes"]


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


@plays_one_episode
def draw(
    manifest: Manifest,
    key: EpisodeKey,
    out: Annotated[
        Path,
        typer.Option(help="Folder of figure and video; made if there is none.", file_okay=False),
    ],
    figure: Annotated[bool, typer.Option(help="Draw scene and particles.")] = True,
    video: Annotated[bool, typer.Option(help="Film the episode.")] = True,
) -> None:
    """Play one episode and write its figure and its video.

    Example: [green]smp-bench draw --method smp --seed 7 --out results/seven[/green]
    """
    draw_episodes(manifest, out, [key], figure=figure, video=video)
