"""Allowed collision matrices of MoveIt's scenes."""

from itertools import product

import pytest

from smp_gym.datasets.moveit_matrix import allowed_of

NAMES = ["hand", "table", "cup"]
ROWS = [[False, True, False], [True, False, True], [False, True, True]]


def matrix(names=NAMES, rows=ROWS, **fields):
    return {"allowed_collision_matrix": {"entry_names": names, "entry_values": rows, **fields}}


def defaults(**values):
    return {"default_entry_names": list(values), "default_entry_values": list(values.values())}


def test_a_pairs_own_entry_counts():
    for rows in (ROWS, [{"enabled": row} for row in ROWS], [[int(v) for v in r] for r in ROWS]):
        allowed = allowed_of(matrix(rows=rows))
        for (i, first), (j, second) in product(enumerate(NAMES), repeat=2):
            if i != j:
                assert allowed.allows(first, second) is ROWS[i][j]
        assert not allowed.allows("hand", "floor")
        assert allowed.permitting == {"hand", "table", "cup"}


def test_defaults_count_where_a_pair_has_no_entry():
    """By the rules in MoveIt's header: both must allow it where both have a default."""
    allowed = allowed_of(matrix(**defaults(hand=True, cup=False, lid=True)))
    assert not allowed.allows("hand", "cup")
    assert allowed.allows("cup", "table")
    assert allowed.allows("hand", "floor")
    assert allowed.allows("floor", "hand")
    assert not allowed.allows("floor", "cup")
    assert allowed.allows("hand", "lid")
    assert not allowed.allows("lid", "cup")
    assert not allowed.allows("floor", "wall")
    assert allowed.permitting == {"hand", "table", "cup", "lid"}


@pytest.mark.parametrize(
    "message",
    [{}, {"allowed_collision_matrix": None}, {"allowed_collision_matrix": {}}, matrix([], [])],
)
def test_scenes_without_a_matrix_allow_nothing(message):
    allowed = allowed_of(message)
    assert not allowed.permitting
    assert not allowed.allows("hand", "table")


@pytest.mark.parametrize(
    ("message", "named"),
    [
        ({"allowed_collision_matrix": [1]}, "allowed_collision_matrix must be a mapping"),
        (matrix(names="hand"), "entry_names must be a list"),
        (matrix(names=["hand", "hand", "cup"]), "once, got 'hand'"),
        (matrix(names=["hand", "", "cup"]), "once, got ''"),
        (matrix(names=["hand", 3, "cup"]), "once, got 3"),
        (matrix(rows=ROWS[:2]), "a row for each of 3 entry_names, got 2"),
        (matrix(names=NAMES[:2]), "a row for each of 2 entry_names, got 3"),
        (matrix(rows=[*ROWS[:2], [True]]), r"entry_values\[2\], of 'cup', must have 3 .* got 1"),
        (matrix(rows=[*ROWS[:2], {"enabled": []}]), r"entry_values\[2\], .* must have 3 .* got 0"),
        (matrix(rows=[*ROWS[:2], "yes"]), r"entry_values\[2\] must be a list"),
        (matrix(rows=[*ROWS[:2], [0, 1, "no"]]), r"\[2\] must be true or false, got 'no'"),
        (matrix(rows=[*ROWS[:2], [0, 2, 0]]), r"\[2\] must be true or false, got 2"),
        (matrix(rows=[*ROWS[:2], [0, 0, 0]]), "symmetric, got two values for 'table' and 'cup'"),
        (matrix(default_entry_names=["hand"]), "a value for each of 1 default_entry_names, got 0"),
        (matrix(**defaults(hand="x")), "default_entry_values must be true or false, got 'x'"),
    ],
)
def test_damaged_matrices_are_refused(message, named):
    with pytest.raises(ValueError, match=named):
        allowed_of(message)
