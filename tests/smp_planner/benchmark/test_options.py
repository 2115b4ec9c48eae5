"""What command lines share."""

import io
import os
import signal
from pathlib import Path
from typing import Annotated

import pytest
import typer
from rich.console import Console

from smp_gym.scene import EVALUATION_SEEDS_START
from smp_planner.benchmark.options import (
    LARGEST,
    CommandLine,
    chosen_names,
    one_of,
    pooled,
    progress_bar,
    split_names,
    tell,
    tuning_seeds,
    whole_numbers,
)


def test_names_are_read_with_or_without_blanks():
    assert split_names(" a, b,,c ") == ("a", "b", "c")


def test_an_empty_list_is_all_that_is_known():
    assert chosen_names("", ("a", "b"), "--tasks") == ["a", "b"]
    assert chosen_names("b", ("a", "b"), "--tasks") == ["b"]


def test_an_unknown_name_is_refused_with_what_is_known():
    with pytest.raises(typer.BadParameter, match="must be of a, b; got 'c'") as refusal:
        chosen_names("a,c", ("a", "b"), "--tasks")
    assert refusal.value.param_hint == "--tasks"


def test_one_name_is_taken_whole():
    assert one_of("a,b", ("a,b", "c"), "--task") == "a,b"
    with pytest.raises(typer.BadParameter, match="must be of a, b; got ''") as refusal:
        one_of("", ("a", "b"), "--task")
    assert refusal.value.param_hint == "--task"


def test_seeds_of_tuning_end_where_evaluation_begins():
    last = EVALUATION_SEEDS_START - 3
    assert list(tuning_seeds(last, 3)) == [last, last + 1, last + 2]
    with pytest.raises(typer.BadParameter, match=f"below {EVALUATION_SEEDS_START}, got {last}"):
        tuning_seeds(last, 4)


def test_a_bar_says_how_far_it_got():
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    with progress_bar("things", 5, console) as (progress, bar):
        progress.update(bar, completed=3)
    written = console.file.getvalue()
    assert "things" in written
    assert "3/5" in written


def test_results_of_workers_come_in_order():
    items = [9, -1, 4, 0]
    found = pooled(abs, items, "numbers", Console(file=io.StringIO()), jobs=2, chunk=2)
    assert found == [9, 1, 4, 0]


def test_a_name_is_given_once():
    with pytest.raises(typer.BadParameter, match="must be different names, got 'a,b,a'"):
        chosen_names("a,b,a", ("a", "b"), "--tasks")


def test_numbers_are_read_with_commas_between():
    assert whole_numbers("1, 16,2", "--sizes") == [1, 16, 2]
    for text in ("", "0", "-1", "1,x", "1.5", "9" * 5000):
        with pytest.raises(typer.BadParameter, match="must be whole numbers from 1 to") as refusal:
            whole_numbers(text, "--sizes")
        assert refusal.value.param_hint == "--sizes"


def _ended(function, *line):
    app = CommandLine(add_completion=False)
    assert app.command()(function) is function
    with pytest.raises(SystemExit) as end:
        app(list(line), prog_name="measure")
    return end.value.code


def _measure(
    places: Annotated[list[Path], typer.Argument(metavar="PLACE...")],
    scale: float = 1.0,
    count_: Annotated[int, typer.Option("--count")] = 1,
    deviation: Annotated[list[float] | None, typer.Option()] = None,
) -> None:
    typer.echo(f"measured {scale} {count_}")


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (("a", "--scale", "nan"), ("--scale", "finite", "nan")),
        (("a", "--deviation", "1", "--deviation", "-inf"), ("--deviation", "finite", "-inf")),
        (("a", "--count", str(LARGEST + 1)), ("--count", str(LARGEST), str(LARGEST + 1))),
        (("a", f"{__file__}/b"), ("PLACE", "no folder")),
        (("x" * 300,), ("PLACE", "too long")),
    ],
)
def test_numbers_and_paths_are_checked_before_a_command(line, words, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "500")
    assert _ended(_measure, *line) == 2
    printed = capsys.readouterr()
    assert "measured" not in printed.out
    for word in words:
        assert word in printed.err


def test_what_is_allowed_reaches_the_command(capsys):
    assert _ended(_measure, "none/deep", "--scale", "2.5", "--count", str(LARGEST)) == 0
    assert capsys.readouterr().out == f"measured 2.5 {LARGEST}\n"


def _killed(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_a_killed_worker_is_told_of_in_one_line(capsys):
    def measure() -> None:
        pooled(_killed, [1, 2], "numbers", Console(file=io.StringIO()), jobs=2)

    assert _ended(measure) == 1
    assert capsys.readouterr().err.strip().endswith("fewer --jobs need less")


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("width must be positive,\n  got -1"), "width must be positive,; got -1"),
        (FileNotFoundError(2, "No such file", "a[/b]"), "No such file: 'a[/b]'"),
        (ModuleNotFoundError("this needs that"), "this needs that"),
        (MemoryError(), "not enough memory for what is asked"),
        (EOFError("no data"), ""),
    ],
)
def test_an_error_that_refuses_is_one_line(error, line, capsys):
    def fail() -> None:
        raise error

    assert _ended(fail) == (2 if line else 1)
    printed = capsys.readouterr().err
    assert "Traceback" not in printed
    if line:
        assert printed == f"error: {line}\n"


def test_a_bug_is_no_refusal():
    def fail() -> None:
        raise KeyError("a")

    app = CommandLine(add_completion=False)
    app.command()(fail)
    with pytest.raises(KeyError):
        app([])


def test_names_of_files_are_told_as_they_are(capsys):
    tell("wrote [/red] [bold]")
    assert capsys.readouterr().out == "wrote [/red] [bold]\n"
