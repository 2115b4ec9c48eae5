"""Demonstrations from arrays and files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray
from smp_gym.untrusted_files import read_arrays, read_file
from smp_planner.library.csv_table import read_csv
from smp_planner.movement_primitives.samples import checked_demonstrations

__all__ = ["demonstrations_of", "read_npz"]

_NUMBERED = "demonstration_"


def demonstrations_of(
    given: Any, joints: Sequence[str] | None = None, *, nan_is_missing: bool = False
) -> tuple[FloatArray, ...]:
    """Return demonstrations as read-only arrays (T_j, D) of one dimension.

    Args:
        given: (N, T, D), N arrays (T_j, D), or a file: see `read_npz` and `read_csv`.
        joints: names of the joints whose angles they are; see `read_csv`.
        nan_is_missing: see `ProMP.fit`.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a file of another kind, fewer than two demonstrations, fewer than two samples in
            one, not all of one dimension, or a number that is neither finite nor missing.
    """
    if isinstance(given, str | Path):
        path = Path(given)
        if path.suffix.lower() not in (".npz", ".csv"):
            raise ValueError(f"demonstrations must be a .npz or .csv file, got {str(given)!r}")
        try:
            if path.suffix.lower() == ".npz":
                return _fixed(read_npz(path), nan_is_missing)
            return _fixed(read_csv(path, joints, nan_is_missing=nan_is_missing), nan_is_missing)
        except ValueError as error:
            named = str(path) in str(error)
            raise error if named else ValueError(f"{path}: {error}") from error
    return _fixed(given, nan_is_missing)


def _fixed(given: Iterable[Any], nan_is_missing: bool) -> tuple[FloatArray, ...]:
    tensors = checked_demonstrations(given, nan_is_missing=nan_is_missing)
    checked = []
    for tensor in tensors:
        path: FloatArray = np.array(tensor.detach().cpu().numpy(), np.float64)
        path.setflags(write=False)
        checked.append(path)
    return tuple(checked)


def read_npz(path: Path) -> list[FloatArray]:
    """Return the demonstrations of an `.npz` file.

    It holds one array (N, T, D) under the name `demonstrations` or `configurations` (as the files
    of `smp_gym.datasets.demonstrations`), or arrays (T_j, D) under `demonstration_0`,
    `demonstration_1` and so on. Pickled objects are refused.

    Raises:
        FileNotFoundError: no such file.
        ValueError: damaged, or without such arrays.
    """
    arrays = read_arrays(read_file(path), str(path))
    for name in ("demonstrations", "configurations"):
        if name in arrays:
            return list(np.atleast_1d(arrays[name]))
    count = sum(name.startswith(_NUMBERED) for name in arrays)
    names = [f"{_NUMBERED}{index}" for index in range(count)]
    if names and set(names) <= set(arrays):
        return [arrays[name] for name in names]
    found = ", ".join(arrays) or "nothing"
    raise ValueError(
        f"{path} must hold an array 'demonstrations' or arrays '{_NUMBERED}0', '{_NUMBERED}1' ...; "
        f"got {found}"
    )
