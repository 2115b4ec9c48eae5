"""Draw sheets of scenes: what each task looks like at each difficulty.

One PNG file per task and difficulty, twelve scenes on it, as the environment's own camera shows
them at the start of the episode.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
import typer
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.scene import DIFFICULTIES, EVALUATION_SEEDS_START, TASKS
from smp_planner.benchmark.options import chosen_names

_COLUMNS = 4
_WIDTH, _HEIGHT = 400, 300
_DPI = 100


def pictures(task: str, difficulty: str, seeds: range) -> list[NDArray[np.uint8]]:
    """Return the first picture (300, 400, 3) of the episode of each seed."""
    env: gymnasium.Env[Any, Any] = gymnasium.make(
        f"smp_gym/{task}-v0",
        difficulty=difficulty,
        render_mode="rgb_array",
        width=_WIDTH,
        height=_HEIGHT,
    )
    taken = []
    for seed in seeds:
        env.reset(seed=seed)
        picture = env.render()
        assert isinstance(picture, np.ndarray)
        taken.append(picture)
    env.close()
    return taken


def draw(path: Path, title: str, seeds: range, scenes: list[NDArray[np.uint8]]) -> None:
    """Write a sheet of pictures, each with its seed below it."""
    rows = -(-len(scenes) // _COLUMNS)
    size = (_COLUMNS * _WIDTH / _DPI, (rows * (_HEIGHT + 24) + 40) / _DPI)
    figure = Figure(figsize=size, dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=12)
    grid = figure.subplots(rows, _COLUMNS, squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    for axes, seed, picture in zip(grid.flat, seeds, scenes, strict=False):
        axes.imshow(picture)
        axes.set_title(f"seed {seed}", fontsize=8, y=-0.09)
    figure.savefig(path)


def main(
    out: Annotated[Path, typer.Option(help="Folder of the sheets.")] = Path("results/scenes"),
    tasks: Annotated[str, typer.Option(help="Separated by commas. Default: all.")] = "",
    difficulties: Annotated[str, typer.Option(help="Separated by commas. Default: all.")] = "",
    scenes: Annotated[int, typer.Option(min=1, max=48, help="On each sheet.")] = 12,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 0,
) -> None:
    """Draw a sheet of scenes for each task and difficulty."""
    seeds = range(seed, seed + scenes)
    if seeds.stop > EVALUATION_SEEDS_START > seeds.start:
        raise typer.BadParameter(
            f"seeds must not run across {EVALUATION_SEEDS_START}, where evaluation begins",
            param_hint="--seed",
        )
    cells = [
        (task, difficulty)
        for task in chosen_names(tasks, TASKS, "--tasks")
        for difficulty in chosen_names(difficulties, DIFFICULTIES, "--difficulties")
    ]
    out.mkdir(parents=True, exist_ok=True)
    console = Console()
    for task, difficulty in track(cells, description="sheets", console=console):
        sheet = out / f"{task}_{difficulty}.png"
        draw(sheet, f"{task}, {difficulty}", seeds, pictures(task, difficulty, seeds))
    console.print(f"{len(cells)} sheets in {out}")


if __name__ == "__main__":
    typer.run(main)
