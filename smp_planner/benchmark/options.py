"""Shared parts of command lines: their errors and signals, names, seeds, bars, pools of workers."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Annotated, Any, NoReturn, TypeVar

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)

from smp_gym.scene import EVALUATION_SEEDS_START
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.benchmark.worker_pool import workers

__all__ = [
    "CommandLine",
    "Interrupted",
    "Jobs",
    "Names",
    "chosen_names",
    "one_of",
    "pooled",
    "print_error",
    "progress_bar",
    "run_command",
    "split_names",
    "tuning_seeds",
]

Names = Annotated[str, typer.Option(help="Separated by commas. Default: all.")]
"""Option for names, to be read by `chosen_names`."""

Jobs = Annotated[int, typer.Option(min=1, help="Worker processes.")]
"""Option for the number of worker processes."""

Item = TypeVar("Item")
Result = TypeVar("Result")


class Interrupted(SystemExit):
    """The end of a command line by SIGINT, SIGTERM or SIGHUP: an exit status as shells have it.

    It is 128 and the number of the signal.
    """


class CommandLine(typer.Typer):
    """A command line of which every end has an exit status and at most one line of words.

    The terminal's Ctrl-C, its closing and a request to terminate raise `Interrupted` where the
    command is, so that it leaves in order; an error of the operating system, as of a full disk or
    of a folder that cannot be written, and one of a folder of results are printed, with status 2.
    """

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Read the command line and run its command."""
        with _interruptible():
            try:
                return super().__call__(*args, **kwargs)
            except (OSError, ResultsError) as error:
                print_error(_described(error) if isinstance(error, OSError) else str(error))
                raise SystemExit(2) from None


def run_command(function: Callable[..., Any]) -> None:
    """Run a function as the one command of a `CommandLine`."""
    app = CommandLine(add_completion=False)
    app.command()(function)
    app()


def print_error(message: str) -> None:
    """Print one line of error."""
    console = Console(stderr=True, highlight=False)
    console.print(f"[bold red]error:[/] {escape(message)}", soft_wrap=True)


def _described(error: OSError) -> str:
    reason = error.strerror or (str(error).splitlines() or [type(error).__name__])[0]
    return reason if error.filename is None else f"{reason}: {str(error.filename)!r}"


@contextmanager
def _interruptible() -> Iterator[None]:
    """Raise `Interrupted` at the signals that end a command, unless they are disregarded."""

    def end(number: int, frame: FrameType | None) -> NoReturn:
        raise Interrupted(128 + number)

    names = ("SIGINT", "SIGTERM", "SIGHUP")
    signals = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {each: signal.getsignal(each) for each in signals}
    taken = [each for each, handler in before.items() if handler != signal.SIG_IGN]
    for each in taken:
        signal.signal(each, end)
    try:
        yield
    finally:
        for each in taken:
            signal.signal(each, before[each])


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
    on_result: Callable[[Result], None] | None = None,
) -> list[Result]:
    """Return a function's results, in order, from worker processes, under a progress bar.

    Args:
        function: of a module, since the workers import it anew.
        items: an argument for each call.
        title: of the bar.
        console: to show it on.
        jobs: worker processes.
        chunk: items that follow each other in one worker.
        on_result: called with each result in turn, as soon as it and those before it are there.
    """
    results = []
    with (
        workers(jobs) as pool,
        progress_bar(title, len(items), console) as (progress, bar),
    ):
        for result in pool.map(function, items, chunksize=chunk):
            results.append(result)
            if on_result is not None:
                on_result(result)
            progress.advance(bar)
    return results
