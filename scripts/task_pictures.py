"""Take the pictures of the tasks for the documentation, with the camera of the environments."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import imageio.v3 as imageio
import numpy as np
import typer

from smp_gym.atomic_files import replacing
from smp_gym.inspection.sheets import pictures
from smp_gym.scene import TASKS
from smp_gym.suites import Cell
from smp_gym.tasks.registry import task_definition
from smp_planner.benchmark.options import Names, chosen_names, run_command, tell

_DIFFICULTIES = ("easy", "hard")
_SEEDS = range(79_200, 79_203)


def main(
    out: Annotated[Path, typer.Option(help="Folder of the pictures.", file_okay=False)] = Path(
        "docs/tasks"
    ),
    tasks: Names = "",
) -> None:
    """Take a picture of each task, or of some: three easy scenes above three hard ones.

    Example: python scripts/task_pictures.py --tasks DrawS --out results/pictures
    """
    out.mkdir(parents=True, exist_ok=True)
    for task in chosen_names(tasks, TASKS, "--tasks"):
        rows = [np.hstack(pictures(Cell(task, name), _SEEDS)) for name in _DIFFICULTIES]
        path = out / f"{task_definition(task).package.rpartition('.')[2]}.png"
        with replacing(path) as aside:
            imageio.imwrite(aside, np.vstack(rows), extension=".png")
        tell(str(path))


if __name__ == "__main__":
    run_command(main)
