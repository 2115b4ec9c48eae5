"""Demonstrations from arrays and files."""

from __future__ import annotations

import csv
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray
from smp_planner.movement_primitives.samples import checked_demonstrations

__all__ = ["demonstrations_of", "read_csv", "read_npz"]

_NUMBERED = "demonstration_"


def demonstrations_of(given: Any, *, nan_is_missing: bool = False) -> tuple[FloatArray, ...]:
    """Return demonstrations as read-only arrays (T_j, D) of one dimension.

    Args:
        given: (N, T, D), N arrays (T_j, D), or a file: see `read_npz` and `read_csv`.
        nan_is_missing: see `ProMP.fit`.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a file of another kind, fewer than two demonstrations, fewer than two samples in
            one, not all of one dimension, or a number that is neither finite nor missing.
    """
    if isinstance(given, str | Path):
        readers = {".npz": read_npz, ".csv": read_csv}
        suffix = Path(given).suffix.lower()
        if suffix not in readers:
            raise ValueError(f"demonstrations must be a .npz or .csv file, got {str(given)!r}")
        given = readers[suffix](Path(given))
    tensors = checked_demonstrations(
        [np.array(one, np.float64) for one in given], nan_is_missing=nan_is_missing
    )
    checked = []
    for tensor in tensors:
        path: FloatArray = tensor.numpy()
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
    try:
        with np.load(path, allow_pickle=False) as archive:
            for name in ("demonstrations", "configurations"):
                if name in archive.files:
                    return list(archive[name])
            count = sum(name.startswith(_NUMBERED) for name in archive.files)
            names = [f"{_NUMBERED}{index}" for index in range(count)]
            if names and set(names) <= set(archive.files):
                return [archive[name] for name in names]
            found = ", ".join(archive.files) or "nothing"
    except (zipfile.BadZipFile, EOFError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{path} is damaged or no .npz file: {error}") from error
    raise ValueError(
        f"{path} must hold an array 'demonstrations' or arrays '{_NUMBERED}0', '{_NUMBERED}1' ...; "
        f"got {found}"
    )


def read_csv(path: Path) -> list[FloatArray]:
    """Return the demonstrations of a `.csv` file, in the order in which they first appear.

    Its first line names the columns: `demonstration`, which tells rows of different demonstrations
    apart; `time`, optional; and one for each coordinate. With times, which rise within a
    demonstration, samples are interpolated to equal steps; without, they stand at such.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a column is missing, a row is too short or too long, an entry is no number, or
            times do not rise.
    """
    rows: dict[str, list[list[float]]] = {}
    with open(path, newline="", encoding="utf-8") as file:
        lines = csv.reader(file)
        names = [name.strip() for name in next(lines, [])]
        columns = [name for name in names if name not in ("demonstration", "time")]
        if "demonstration" not in names or not columns:
            raise ValueError(
                f"{path} must have the columns demonstration, time (optional) and one for each "
                f"coordinate, got {', '.join(names) or 'none'}"
            )
        for line in lines:
            if not line:
                continue
            where = f"{path}, line {lines.line_num}"
            if len(line) != len(names):
                raise ValueError(f"{where} must have {len(names)} entries, got {len(line)}")
            entries = dict(zip(names, line, strict=True))
            try:
                numbers = [float(entries[name]) for name in ("time", *columns) if name in entries]
            except ValueError as error:
                raise ValueError(f"{where} must hold numbers: {error}") from error
            rows.setdefault(entries["demonstration"].strip(), []).append(numbers)
    given = {name: np.array(samples) for name, samples in rows.items()}
    if "time" not in names:
        return list(given.values())
    return [_evenly(name, samples, path) for name, samples in given.items()]


def _evenly(name: str, samples: FloatArray, path: Path) -> FloatArray:
    """Return the coordinates (T, D) of samples (T, 1 + D), interpolated to equal steps of time."""
    times = samples[:, 0]
    if not (np.diff(times) > 0.0).all():
        raise ValueError(f"{path}: times of demonstration {name!r} must rise, got {times}")
    even = np.linspace(times[0], times[-1], len(times))
    return np.stack([np.interp(even, times, column) for column in samples[:, 1:].T], axis=1)
