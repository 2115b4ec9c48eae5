"""What command lines share."""

import io

import pytest
import typer
from rich.console import Console

from smp_gym.scene import EVALUATION_SEEDS_START
from smp_planner.benchmark.options import (
    chosen_names,
    one_of,
    pooled,
    progress_bar,
    split_names,
    tuning_seeds,
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
