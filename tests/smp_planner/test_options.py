"""Lists of names on the command line."""

import pytest
import typer

from smp_planner.benchmark.options import chosen_names, split_names


def test_names_are_read_with_or_without_blanks():
    assert split_names(" a, b,,c ") == ("a", "b", "c")


def test_an_empty_list_is_all_that_is_known():
    assert chosen_names("", ("a", "b"), "--tasks") == ["a", "b"]
    assert chosen_names("b", ("a", "b"), "--tasks") == ["b"]


def test_an_unknown_name_is_refused_with_what_is_known():
    with pytest.raises(typer.BadParameter, match="must be of a, b; got 'c'") as refusal:
        chosen_names("a,c", ("a", "b"), "--tasks")
    assert refusal.value.param_hint == "--tasks"
