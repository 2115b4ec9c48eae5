"""Shared parts of command lines: their errors and signals, names, seeds, bars, pools of workers."""

from __future__ import annotations

import functools
import inspect
import math
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, NoReturn, TypeVar, get_type_hints

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
from smp_planner.benchmark.worker_pool import workers

__all__ = [
    "AgentFolder",
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
    "tell",
    "tuning_seeds",
    "whole_numbers",
]

Names = Annotated[str, typer.Option(help="Separated by commas. Default: all.")]
"""Option for names, to be read by `chosen_names`."""

Jobs = Annotated[int, typer.Option(min=1, help="Worker processes.")]
"""Option for the number of worker processes."""

AgentFolder = Annotated[
    Path | None,
    typer.Option(help="Folder to write; by default below results/agents/.", file_okay=False),
]
"""Option for the folder of a training."""

LARGEST = 2**31 - 1
"""Largest whole number of an option: more than this neither memory nor time is there for."""

_REFUSALS = (OSError, ValueError, ImportError, MemoryError)
"""Errors that say what is wrong with a command line, or with the machine that it is run on."""

Item = TypeVar("Item")
Result = TypeVar("Result")


class Interrupted(SystemExit):
    """The end of a command line by SIGINT, SIGTERM or SIGHUP: an exit status as shells have it.

    It is 128 and the number of the signal.
    """


class CommandLine(typer.Typer):
    """A command line of which every end has an exit status and at most one line of words.

    The terminal's Ctrl-C, its closing and a request to terminate raise `Interrupted` where the
    command is, so that it leaves in order. Numbers and paths are checked before a command begins.
    An error that refuses a value, of the operating system, as of a full disk or of a folder that
    cannot be written, of a folder of results, of a package that is not installed, or of memory is
    printed, with status 2; Python's development mode (`python -X dev`) shows where it came from.
    """

    def command(self, *args: Any, **kwargs: Any) -> Callable[[Any], Any]:
        """Return a decorator that adds a function as a command, and gives it back as it was."""
        add = super().command(*args, **kwargs)

        def decorate(function: Any) -> Any:
            add(_with_checks(function))
            return function

        return decorate

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Read the command line and run its command."""
        # A name that is no text is printed with escapes.
        if hasattr(sys.stdout, "reconfigure"):
            sys.stdout.reconfigure(errors="backslashreplace")
        with _interruptible():
            try:
                return super().__call__(*args, **kwargs)
            except _REFUSALS as error:
                if sys.flags.dev_mode:
                    raise
                print_error(_described(error))
                raise SystemExit(2) from None
            except BrokenProcessPool:
                print_error(
                    "a worker process died (killed, or out of memory): fewer --jobs need less"
                )
                raise SystemExit(1) from None


def run_command(function: Callable[..., Any]) -> None:
    """Run a function as the one command of a `CommandLine`."""
    app = CommandLine(add_completion=False)
    app.command()(function)
    app()


def _with_checks(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command that refuses numbers and paths that no command could take."""

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        given = inspect.signature(function).bind(*args, **kwargs).arguments
        for name, value in given.items():
            for each in value if isinstance(value, (list, tuple)) else (value,):
                if problem := _problem(each):
                    raise typer.BadParameter(problem, param_hint=_shown_name(function, name))
        return function(*args, **kwargs)

    return checked


def _shown_name(function: Callable[..., Any], name: str) -> str:
    """Return the name on the command line of a parameter of a command."""
    hint = get_type_hints(function, include_extras=True)[name]
    (info,) = getattr(hint, "__metadata__", None) or (typer.Option(),)
    if isinstance(info, typer.models.ArgumentInfo):
        return str(info.metavar or name.upper())
    names = [declared for declared in info.param_decls or () if declared.startswith("--")]
    return names[0] if names else f"--{name.strip('_').replace('_', '-')}"


def _problem(value: Any) -> str:
    """Return what is wrong with a number or a path, whatever it is for; empty if nothing is."""
    if isinstance(value, float) and not math.isfinite(value):
        return f"must be finite, got {value}"
    if isinstance(value, int) and abs(value) > LARGEST:
        return f"must be within ±{LARGEST}, got {value}"
    if isinstance(value, Path):
        try:
            # What is not there can be made where its next folder is one.
            there = next((path for path in (value, *value.parents) if path.exists()), value)
        except OSError as error:
            return f"is no path: {error.strerror}, got {str(value)[:80]!r}"
        if there != value and not there.is_dir():
            return f"lies under {str(there)!r}, which is no folder; got {str(value)!r}"
    return ""


def print_error(message: str) -> None:
    """Print one line of error."""
    console = Console(stderr=True, highlight=False)
    console.print(f"[bold red]error:[/] {escape(message)}", soft_wrap=True)


def tell(message: str) -> None:
    """Print one line as it is: names of files may hold what looks like markup."""
    Console().print(message, highlight=False, markup=False, soft_wrap=True)


def _described(error: BaseException) -> str:
    if isinstance(error, MemoryError):
        return f"not enough memory for what is asked: {error}".removesuffix(": ")
    if not isinstance(error, OSError):
        lines = [line.strip() for line in str(error).splitlines()]
        return "; ".join(filter(None, lines)) or type(error).__name__
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
        typer.BadParameter: a name is not known, or given twice.
    """
    names = list(split_names(text)) or list(known)
    for name in names:
        one_of(name, known, option)
    if len(set(names)) < len(names):
        raise typer.BadParameter(f"must be different names, got {text!r}", param_hint=option)
    return names


def whole_numbers(text: str, option: str) -> list[int]:
    """Return the positive whole numbers in a list separated by commas.

    Args:
        text: what the user gave.
        option: its name on the command line, such as "--threads".

    Raises:
        typer.BadParameter: it holds something else, or nothing.
    """
    try:
        numbers = [int(number) for number in split_names(text)]
    except ValueError:
        numbers = []
    if not numbers or not 1 <= min(numbers) <= max(numbers) <= LARGEST:
        raise typer.BadParameter(
            f"must be whole numbers from 1 to {LARGEST}, separated by commas; got {text[:80]!r}",
            param_hint=option,
        )
    return numbers


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
