"""Arrays and numbers: names for arrays by the type of their entries, and checks of arguments.

The checks take what is meant as numbers and refuse, by the argument's name, what numpy would turn
into such in silence: texts, objects, imaginary parts, masks, truth values.
"""

from __future__ import annotations

import math
import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "AnyFloatArray",
    "BoolArray",
    "Float32Array",
    "FloatArray",
    "IntArray",
    "checked_array",
    "checked_count",
    "checked_number",
    "checked_seed",
    "shown",
]

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

AnyFloatArray = NDArray[np.floating[Any]]
"""Of any precision: goals are float32 in observations and float64 in the rules."""

_SHOWN = 100
"""Characters of a value that a message shows."""


def shown(value: Any) -> str:
    """Return a value as a message shows it: short, on one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _SHOWN else text[: _SHOWN - 4] + " ..."


def checked_array(
    name: str, value: Any, shape: tuple[int | None, ...] | None = None, *, nan: bool = False
) -> FloatArray:
    """Return numbers as a new float64 array.

    Args:
        name: of the argument, for the message.
        value: an array, or nested sequences.
        shape: that it must have; None in it is any length, None alone any shape.
        nan: whether NaN is allowed.

    Raises:
        ValueError: not numbers, of another shape, or not finite.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise ValueError(f"{name} must be a plain array of numbers, got a masked array")
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{name} must be an array of numbers: {error}") from error
    if array.dtype.kind not in "fiu":
        raise ValueError(
            f"{name} must be real numbers, got {shown(value)} of type {array.dtype.name}"
        )
    if shape is not None and (
        array.ndim != len(shape)
        or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True))
    ):
        wanted = tuple("any" if length is None else length for length in shape)
        raise ValueError(f"{name} must have shape {wanted}, got {array.shape}")
    checked: FloatArray = np.array(array, np.float64, order="C")
    bad = np.isinf(checked) if nan else ~np.isfinite(checked)
    if bad.any():
        index = tuple(int(i) for i in np.argwhere(bad)[0])
        place = f" at {index}" if index else ""
        raise ValueError(f"{name} must be finite, got {checked[index]}{place}")
    return checked


def checked_number(
    name: str,
    value: Any,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
) -> float:
    """Return a finite real number as a float.

    Args:
        name: of the argument, for the message.
        value: number.
        above: bound that it must exceed.
        least: bound that it must reach.
        most: bound that it must not exceed.

    Raises:
        ValueError: no real number, not finite, or out of bounds.
    """
    bounds = [
        text
        for bound, text in (
            (above, f"above {above}"),
            (least, f"at least {least}"),
            (most, f"at most {most}"),
        )
        if bound is not None
    ]
    real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    number = math.nan
    if real:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
    if (
        not math.isfinite(number)
        or (above is not None and not number > above)
        or (least is not None and not number >= least)
        or (most is not None and not number <= most)
    ):
        wanted = " ".join(["a finite number", " and ".join(bounds)]).rstrip()
        raise ValueError(f"{name} must be {wanted}, got {shown(value)}")
    return number


def checked_count(name: str, value: Any, *, least: int = 1, most: int | None = None) -> int:
    """Return a whole number, of Python or numpy, as an int.

    Raises:
        ValueError: not whole, or out of bounds; 8.0 is refused as 1.5 is.
    """
    try:
        number = None if isinstance(value, bool | np.bool_) else operator.index(value)
    except TypeError:
        number = None
    if number is None or number < least or (most is not None and number > most):
        bounds = f"at least {least}" if most is None else f"from {least} to {most}"
        raise ValueError(f"{name} must be a whole number {bounds}, got {shown(value)}")
    return number


def checked_seed(value: Any) -> int:
    """Return a seed, a whole number that is not negative and fits into 63 bits, as an int.

    Raises:
        ValueError: it is none; None, too, because the same call must give the same result.
    """
    return checked_count("seed", value, least=0, most=2**63 - 1)
