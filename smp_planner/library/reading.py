"""Demonstrations from arrays and files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray, checked_array, shown
from smp_gym.untrusted_files import read_arrays, read_file
from smp_planner.library.csv_table import Recording, read_csv
from smp_planner.library.signals import Recorded
from smp_planner.movement_primitives.samples import checked_demonstrations

__all__ = ["demonstrations_of", "read_npz", "recordings_of"]

_NUMBERED = "demonstration_"


def demonstrations_of(
    given: Any, joints: Sequence[str] | None = None, *, nan_is_missing: bool = False
) -> tuple[FloatArray, ...]:
    """Return the paths of `recordings_of`, without what was recorded beside them."""
    return recordings_of(given, joints, nan_is_missing=nan_is_missing)[0]


def recordings_of(
    given: Any,
    joints: Sequence[str] | None = None,
    signals: Any = (),
    durations: Any = None,
    *,
    nan_is_missing: bool = False,
) -> tuple[tuple[FloatArray, ...], Recorded]:
    """Return demonstrations as read-only arrays (T_j, D) of one dimension, and what is beside them.

    Args:
        given: (N, T, D), N arrays (T_j, D), or a file or a list of files, see `read_npz` and
            `read_csv`.
        joints: names of the joints whose angles they are; see `read_csv`.
        signals: names of columns of `.csv` files that are no coordinates, or by name N arrays
            (T_j,).
        durations: (N,) of the demonstrations, above 0; None takes those of the times in `.csv`
            files.
        nan_is_missing: see `ProMP.fit`; of signals no number may be missing.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a file of another kind, fewer than two demonstrations, fewer than two samples in
            one, not all of one dimension, a number that is neither finite nor missing, or no such
            signals or durations.
    """
    names = _signal_names(signals, joints)
    columns = () if isinstance(signals, Mapping) else names
    files = isinstance(given, list | tuple) and any(isinstance(x, str | Path) for x in given)
    read: list[Recording] = []
    if isinstance(given, str | Path):
        read = _read(given, joints, columns, nan_is_missing, one_of_several=False)
    elif files:
        for index, file in enumerate(given):
            if not isinstance(file, str | Path):
                raise ValueError(
                    f"demonstrations[{index}] must be a file as others, got {shown(file)}"
                )
            read += _read(file, joints, columns, nan_is_missing, one_of_several=True)
    elif columns:
        raise ValueError(_mapped("arrays", columns))
    else:
        paths = _fixed(given, nan_is_missing)
        return paths, _recorded([Recording(path) for path in paths], signals, durations)
    try:
        paths = _fixed([recording.path for recording in read], nan_is_missing)
    except ValueError as error:
        found = ", ".join(Path(file).name for file in given) if files else str(given)
        raise ValueError(f"{found}: {error}") from error
    return paths, _recorded(read, signals, durations)


def _signal_names(signals: Any, joints: Sequence[str] | None) -> tuple[str, ...]:
    names = None
    if isinstance(signals, Iterable) and not isinstance(signals, str):
        names = tuple(signals)
    if names is None or not all(isinstance(name, str) and name for name in names):
        raise ValueError(
            "signals must be names of columns, or map names to numbers by demonstration, got "
            f"{shown(signals)}"
        )
    doubled = [name for name in names if names.count(name) > 1]
    if doubled or set(names) & set(joints or ()):
        wrong = (doubled or [name for name in names if name in (joints or ())])[0]
        raise ValueError(f"signals must be different, and none of the joints, got {wrong!r}")
    return names


def _mapped(kind: str, names: Sequence[str]) -> str:
    return (
        f"signals of {kind} must map names to numbers by demonstration, as "
        f"signals={{{names[0]!r}: [...]}}; only .csv files have named columns"
    )


def _recorded(recordings: Sequence[Recording], signals: Any, durations: Any) -> Recorded:
    """Return what was recorded beside demonstrations that are known to be good."""
    count = len(recordings)
    if durations is not None:
        durations = checked_array("durations", durations, (count,))
        if not (durations > 0.0).all():
            raise ValueError(f"durations must be above 0, got {shown(durations)}")
    elif all(recording.duration is not None for recording in recordings):
        durations = np.array([recording.duration for recording in recordings])
    phases = [
        np.linspace(0.0, 1.0, len(r.path)) if r.phases is None else r.phases for r in recordings
    ]
    values: dict[str, list[FloatArray]] = {}
    if isinstance(signals, Mapping):
        for name, given in signals.items():
            each = list(given) if isinstance(given, Iterable) else []
            if len(each) != count:
                raise ValueError(
                    f"signals[{name!r}] must hold numbers of {count} demonstrations, got "
                    f"{shown(given)}"
                )
            values[name] = [
                checked_array(f"signals[{name!r}][{index}]", numbers, (len(phases[index]),))
                for index, numbers in enumerate(each)
            ]
    else:
        values = {name: [r.signals[name] for r in recordings] for name in signals}
    return Recorded(durations, phases, values)


def _read(
    file: str | Path,
    joints: Sequence[str] | None,
    signals: Sequence[str],
    nan_is_missing: bool,
    one_of_several: bool,
) -> list[Recording]:
    path = Path(file)
    if path.suffix.lower() == ".npz":
        if signals:
            raise ValueError(f"{path}: {_mapped('.npz files', signals)}")
        return [Recording(array) for array in read_npz(path)]
    if path.suffix.lower() == ".csv":
        return read_csv(
            path, joints, signals, nan_is_missing=nan_is_missing, one_of_several=one_of_several
        )
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
