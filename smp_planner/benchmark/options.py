"""Shared parts of command lines: lists of names, seeds, progress bars and pools of workers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, TypeVar

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from smp_gym.scene import EVALUATION_SEEDS_START
from smp_planner.benchmark.worker_pool import workers

__all__ = [
    "INTERRUPTED",
    "Jobs",
    "Names",
    "chosen_names",
    "one_of",
    "pooled",
    "progress_bar",
    "split_names",
    "tuning_seeds",
]

INTERRUPTED = 130
"""Exit status of a command that the user interrupts, as shells have it."""

Names = Annotated[str, typer.Option(help="Separated by commas. Default: all.")]
"""Option for names, to be read by `chosen_names`."""

Jobs = Annotated[int, typer.Option(min=1, help="Worker processes.")]
"""Option for the number of worker processes."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def split_names(text: str) -> tuple[str, ...]:
    """Return the names in a list separated by commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def chosen_names(text: str, known: Sequence[str], option: str) -> list[str]:
    """Return the names in a list separated by commas; all known ones for an empty list.

    Args:
        text: what the user gave.
        known: what is allowed, in order.
        option: its name on the command line, such as "--tasks".

    Raises:
        typer.BadParameter: a name is not known.
    """
    names = list(split_names(text)) or list(known)
    for name in names:
        one_of(name, known, option)
    return names


def one_of(name: str, known: Sequence[str], option: str) -> str:
    """Return a name that has to be one of those known.

    Args:
        name: what the user gave.
        known: what is allowed, in order.
        option: its name on the command line, such as "--task".

    Raises:
        typer.BadParameter: the name is not known.
    """
    if name not in known:
        raise typer.BadParameter(f"must be of {', '.join(known)}; got {name!r}", param_hint=option)
    return name


def tuning_seeds(seed: int, count: int, option: str = "--seed") -> range:
    """Return so many seeds from one on, all of them below those of evaluation.

    Raises:
        typer.BadParameter: one of them is an evaluation seed.
    """
    if seed + count > EVALUATION_SEEDS_START:
        raise typer.BadParameter(
            f"must leave all seeds below {EVALUATION_SEEDS_START}, got {seed}", param_hint=option
        )
    return range(seed, seed + count)


@contextmanager
def progress_bar(
    title: str, total: int | None, console: Console, *, transient: bool = False
) -> Iterator[tuple[Progress, TaskID]]:
    """Show a bar with a title, how many of how many are done, and the time that remains.

    Args:
        title: text before the bar.
        total: how many there are; None if that is set later.
        console: to show it on.
        transient: take the bar away at the end.

    Yields:
        The display and its one bar, for `update` and `advance`.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=transient) as progress:
        yield progress, progress.add_task(title, total=total)


def pooled(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    title: str,
    console: Console,
    *,
    jobs: int,
    chunk: int = 1,
) -> list[Result]:
    """Return a function's results, in order, from worker processes, under a progress bar.

    Args:
        function: of a module, since the workers import it anew.
        items: an argument for each call.
        title: of the bar.
        console: to show it on.
        jobs: worker processes.
        chunk: items that follow each other in one worker.
    """
    results = []
    with (
        workers(jobs) as pool,
        progress_bar(title, len(items), console) as (progress, bar),
    ):
        for result in pool.map(function, items, chunksize=chunk):
            results.append(result)
            progress.advance(bar)
    return results
