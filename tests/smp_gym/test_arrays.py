"""Checks of arguments: what is meant as numbers passes, everything else is named."""

import numpy as np
import pytest
import torch

from smp_gym.arrays import checked_array, checked_count, checked_number, checked_seed, shown


@pytest.mark.parametrize(
    "value",
    [
        [1, 2],
        (1.0, 2.0),
        np.array([1, 2], np.int8),
        np.array([1, 2], np.float32),
        torch.tensor([1.0, 2.0]),
    ],
)
def test_numbers_of_all_kinds_pass(value):
    array = checked_array("x", value, (2,))
    assert array.dtype == np.float64
    assert array.tolist() == [1.0, 2.0]
    assert array.flags.owndata


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1j, 2.0], "x must be real numbers, got .* of type complex128"),
        (np.ma.masked_array([1.0, 2.0], [True, False]), "x must be a plain array .* masked"),
        (["1", "2"], "x must be real numbers, got .* of type str"),
        ([object(), 1.0], "x must be real numbers, got .* of type object"),
        ([None, 1.0], "x must be real numbers"),
        ([True, False], "x must be real numbers, got .* of type bool"),
        (np.array(["2020-01-01"], "M8[D]"), "x must be real numbers"),
        ([[1.0, 2.0], [3.0]], "x must be an array of numbers"),
        ([1.0, np.nan], r"x must be finite, got nan at \(1,\)"),
        ([1.0, np.inf], r"x must be finite, got inf at \(1,\)"),
        ([1.0], r"x must have shape \(2,\), got \(1,\)"),
        (1.0, r"x must have shape \(2,\), got \(\)"),
    ],
)
def test_what_is_no_array_of_numbers_is_named(value, message):
    with pytest.raises(ValueError, match=message):
        checked_array("x", value, (2,))


def test_nan_passes_where_it_is_allowed():
    assert np.isnan(checked_array("x", [[np.nan, 1.0]], (None, 2), nan=True)[0, 0])
    with pytest.raises(ValueError, match="finite, got inf"):
        checked_array("x", [np.inf], nan=True)


def test_numbers_and_their_bounds():
    for value in (2, 2.0, np.int64(2), np.float32(2.0)):
        assert checked_number("r", value, above=0.0, most=2.0) == 2.0
    for value in (0.0, 2.1, "1", 1j, True, None, np.nan, np.inf, 10**400, [1.0], np.array([1.0])):
        with pytest.raises(ValueError, match=r"r must be a finite number above 0.0 and at mo"):
            checked_number("r", value, above=0.0, most=2.0)


def test_whole_numbers():
    for value in (8, np.int64(8), np.uint8(8)):
        assert checked_count("particles", value) == 8
    for value in (0, -1, 1.5, 8.0, "8", True, None, np.nan, 8j):
        with pytest.raises(ValueError, match="particles must be a whole number at least 1, got"):
            checked_count("particles", value)
    for seed in (-1, None, 1.0, 2**63, "0"):
        with pytest.raises(ValueError, match="seed must be a whole number from 0 to"):
            checked_seed(seed)


def test_values_are_shown_shortly():
    assert len(shown(np.arange(10_000))) <= 100
    assert shown("a" * 1000).endswith(" ...")
