"""Demonstrations from arrays and files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray, shown
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
        given: (N, T, D), N arrays (T_j, D), or a file or a list of files, see `read_npz` and
            `read_csv`.
        joints: names of the joints whose angles they are; see `read_csv`.
        nan_is_missing: see `ProMP.fit`.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a file of another kind, fewer than two demonstrations, fewer than two samples in
            one, not all of one dimension, or a number that is neither finite nor missing.
    """
    files = isinstance(given, list | tuple) and any(isinstance(x, str | Path) for x in given)
    if isinstance(given, str | Path):
        read = _read(given, joints, nan_is_missing, one_of_several=False)
    elif files:
        read = []
        for index, file in enumerate(given):
            if not isinstance(file, str | Path):
                raise ValueError(
                    f"demonstrations[{index}] must be a file as others, got {shown(file)}"
                )
            read += _read(file, joints, nan_is_missing, one_of_several=True)
    else:
        return _fixed(given, nan_is_missing)
    try:
        return _fixed(read, nan_is_missing)
    except ValueError as error:
        names = ", ".join(Path(file).name for file in given) if files else str(given)
        raise ValueError(f"{names}: {error}") from error


def _read(
    file: str | Path, joints: Sequence[str] | None, nan_is_missing: bool, one_of_several: bool
) -> list[FloatArray]:
    path = Path(file)
    if path.suffix.lower() == ".npz":
        return read_npz(path)
    if path.suffix.lower() == ".csv":
        return read_csv(path, joints, nan_is_missing=nan_is_missing, one_of_several=one_of_several)
    raise ValueError(f"demonstrations must be .npz or .csv files, got {str(file)!r}")


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
