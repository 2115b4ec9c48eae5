"""Sheets of scenes, as the environment's own camera shows them at the start of the episode."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.atomic_files import replacing
from smp_gym.registration import environment_id
from smp_gym.suites import Cell

__all__ = ["draw_sheet", "pictures"]

_COLUMNS = 4
_WIDTH, _HEIGHT = 400, 300
_DPI = 100


def pictures(cell: Cell, seeds: range) -> list[NDArray[np.uint8]]:
    """Return the first picture (300, 400, 3) of the episode of each seed of a cell."""
    env: gymnasium.Env[Any, Any] = gymnasium.make(
        environment_id(cell.task),
        **cell.make_arguments(),
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


def draw_sheet(path: Path, title: str, seeds: range, scenes: list[NDArray[np.uint8]]) -> None:
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
    with replacing(path) as aside:
        figure.savefig(aside)
