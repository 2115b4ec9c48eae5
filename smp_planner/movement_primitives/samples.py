"""Demonstrations as samples along the phase: checked, and stacked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import checked_array, shown

__all__ = ["checked_demonstrations", "equal_stacks"]


def checked_demonstrations(
    demonstrations: Iterable[Any], *, fewest: int = 2, nan_is_missing: bool = False
) -> list[Tensor]:
    """Return demonstrations as tensors (T_j, D) of one dtype and device.

    Args:
        demonstrations: N arrays (T_j, D), T_j at least 2.
        fewest: N at least.
        nan_is_missing: whether NaN stands for a number that was not measured, of which every
            dimension of every demonstration must have two at least.

    Raises:
        ValueError: too few demonstrations, not all of one dimension, too few samples in one, or a
            number that is not finite.
    """
    if isinstance(demonstrations, np.ma.MaskedArray) or not isinstance(demonstrations, Iterable):
        raise ValueError(f"demonstrations must be arrays of numbers, got {shown(demonstrations)}")
    checked: list[Tensor] = []
    for index, given in enumerate(demonstrations):
        d = _tensor(given, index)
        if d.ndim != 2 or d.shape[0] < 2 or d.shape[1] < 1:
            raise ValueError(
                f"demonstrations[{index}] must have shape (T, D) with T of at least 2, "
                f"got {tuple(d.shape)}"
            )
        if checked and d.shape[1] != checked[0].shape[1]:
            raise ValueError(
                f"demonstrations must all have one dimension: demonstrations[{index}] has "
                f"{d.shape[1]}, demonstrations[0] has {checked[0].shape[1]}"
            )
        _check_numbers(d, index, nan_is_missing)
        checked.append(d.to(checked[0]) if checked else d)
    if len(checked) < fewest:
        raise ValueError(f"demonstrations must be at least {fewest}, got {len(checked)}")
    return checked


def _tensor(given: Any, index: int) -> Tensor:
    if isinstance(given, Tensor) and given.is_floating_point():
        return given
    return torch.from_numpy(checked_array(f"demonstrations[{index}]", given, nan=True))


def _check_numbers(demonstration: Tensor, index: int, nan_is_missing: bool) -> None:
    finite = torch.isfinite(demonstration)
    missing = torch.isnan(demonstration) & nan_is_missing
    bad = ~(finite | missing).all(-1)
    if bool(bad.any()):
        row = int(bad.nonzero()[0])
        hint = "; nan_is_missing=True takes NaN for samples that are missing"
        raise ValueError(
            f"demonstrations[{index}] must be finite, got {demonstration[row].tolist()} "
            f"at sample {row}" + ("" if nan_is_missing else hint)
        )
    present = finite.sum(0)
    if bool((present < 2).any()):
        dimension = int((present < 2).nonzero()[0])
        raise ValueError(
            f"demonstrations[{index}] must have at least 2 samples that are not missing in every "
            f"dimension, got {int(present[dimension])} in dimension {dimension}"
        )


def equal_stacks(demonstrations: Sequence[Tensor]) -> list[Tensor]:
    """Return stacks (n, T, D) of the demonstrations with equal length and equal missing samples.

    Shorter ones come first; in a stack the demonstrations stand in the order that they are given.
    """
    stacks: dict[tuple[int, bytes], list[Tensor]] = {}
    for d in demonstrations:
        key = (len(d), torch.isnan(d).cpu().numpy().tobytes())
        stacks.setdefault(key, []).append(d)
    return [torch.stack(stacks[key]) for key in sorted(stacks)]
