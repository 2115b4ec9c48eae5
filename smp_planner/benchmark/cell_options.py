"""Options of command lines that say which cells are played and how, and what they ask for."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smp_planner.benchmark.options import print_error

if TYPE_CHECKING:
    from smp_gym.suites import Cell
    from smp_planner.benchmark.manifest import Manifest

__all__ = [
    "Difficulty",
    "Family",
    "Latency",
    "Lists",
    "Noise",
    "ReplanEvery",
    "Sensing",
    "chosen_cells",
    "fail",
    "find_own_modules",
    "replanning",
    "requested_manifest",
]

Difficulty = Annotated[
    str | None,
    typer.Option(help="Of single cells: none, easy, medium or hard. Default: medium."),
]
"""Option for the difficulty of single cells."""

Family = Annotated[
    str | None,
    typer.Option(
        help="Of the scenes of single cells: obstacles, shelf, box, cage, table, clutter, moving "
        "or displaced; not every task has all of them. Default: obstacles."
    ),
]
"""Option for the family of their scenes."""

Sensing = Annotated[
    str | None,
    typer.Option(
        help="What observations of single cells say of obstacles: exact rows, rows with noise, or "
        "a depth camera's points. Default: exact."
    ),
]
"""Option for their sensing."""

Noise = Annotated[
    float | None,
    typer.Option(help="Standard deviation of perceived positions with --sensing noise, m."),
]
"""Option for the noise of their sensing."""

Lists = Annotated[
    Path | None,
    typer.Option(help="Folder of frozen lists. Default: that of the package.", file_okay=False),
]
"""Option for where the frozen lists are."""

ReplanEvery = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Make plans anew after so many control steps at the latest, of methods that can: "
        "smp, promp. Default: plan once.",
    ),
]
"""Option for when plans are made anew."""

Latency = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Control steps from asking for a plan to its taking effect, whatever the machine; "
        "with --replan-every. Default: 2.",
    ),
]
"""Option for how late such plans take effect."""


def fail(message: str, code: int) -> typer.Exit:
    """Print a line of error, and return the end of the command with an exit status."""
    print_error(message)
    return typer.Exit(code)


def replanning(replan_every: int | None, latency: int | None) -> dict[str, int]:
    """Return the arguments of `make_manifest` that say when plans are made anew."""
    if replan_every is None:
        if latency is not None:
            raise fail(f"--latency needs --replan-every, got --latency {latency} without", 2)
        return {}
    return {"replan_every": replan_every} | ({} if latency is None else {"latency": latency})


def chosen_cells(
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
        raise fail(str(error), 2) from error


def find_own_modules() -> None:
    """Let modules of the working directory be imported, here and in worker processes."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())


def requested_manifest(*arguments: Any, **options: Any) -> Manifest:
    """Return `make_manifest` of arguments; modules of the working directory are found, too."""
    from smp_planner.benchmark.manifest import make_manifest

    find_own_modules()
    try:
        return make_manifest(*arguments, **options)
    except ValueError as error:
        raise fail(str(error), 2) from error
