"""Demonstrations from CSV tables, whose columns are known by their names."""

from __future__ import annotations

import codecs
import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray, shown
from smp_gym.untrusted_files import read_file

__all__ = ["read_csv"]

_DEMONSTRATION = "demonstration"
_TIMES = ("time", "timestamp")
"""Names of the column of times, in any case."""

_COUNTERS = ("index", "idx", "row", "sample", "step", "frame", "seq", "id", "unnamed: 0")
_CLOCKS = ("t", "sec", "secs", "nsec", "nsecs", "stamp")
_NO_COORDINATES = frozenset((*_COUNTERS, *_CLOCKS))
"""Names of columns that count rows or tell times in ways that are not read."""

_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_DELIMITERS = ",;\t"


def read_csv(
    path: Path,
    joints: Sequence[str] | None = None,
    *,
    nan_is_missing: bool = False,
    one_of_several: bool = False,
) -> list[FloatArray]:
    """Return the demonstrations of a `.csv` file, in the order in which they first appear.

    Its first line names the columns: `demonstration`, which tells rows of different demonstrations
    apart; `time` or `timestamp`, optional; and one for each coordinate. With times, which rise
    within a demonstration, samples are interpolated to equal steps; without, they stand at such.
    Columns are separated by commas, semicolons (numbers may have decimal commas then) or tabs; the
    text is UTF-8, or UTF-16 with a byte order mark.

    Args:
        path: of the file.
        joints: names of a robot's joints. Columns of these names are put into their order;
            columns none of which is named like a joint are taken as they stand.
        nan_is_missing: whether an empty entry or NaN is a number that was not measured.
        one_of_several: whether the file is one of several: without a column `demonstration` it then
            holds one.

    Raises:
        FileNotFoundError: no such file.
        ValueError: the file is no such table; the message names file, line and column.
    """
    lines = csv.reader(io.StringIO(_text(path), newline=""), delimiter=",", strict=True)
    try:
        return _demonstrations(lines, path, joints, nan_is_missing, one_of_several)
    except csv.Error as error:
        raise ValueError(f"{path}, line {lines.line_num} is no line of a table: {error}") from error


def _text(path: Path) -> str:
    """Return the text of a table, its columns separated by commas and its decimals by points."""
    content = read_file(path)
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS if content.startswith(mark)), "utf-8")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise ValueError(
            f"{path}, line {line} must be text in UTF-8, got the byte "
            f"0x{content[error.start]:02x}; save it in that encoding"
        ) from error
    header = text.partition("\n")[0]
    delimiter = max(_DELIMITERS, key=header.count)
    if delimiter != ",":
        decimals = str.maketrans({delimiter: ",", ",": "."})
        text = text.translate(decimals)
    return text


def _columns(
    names: Sequence[str], path: Path, joints: Sequence[str] | None, one_of_several: bool
) -> list[int]:
    """Return the places of the columns demonstration and time (or -1), and of the coordinates."""
    where = f"{path}, line 1"
    lowered = [name.lower() for name in names]
    if "" in names and any(names):
        raise ValueError(
            f"{where} must name all columns, got none for column {names.index('') + 1}: an index "
            "or a last comma must be left out"
        )
    doubled = sorted({name for name in names if lowered.count(name.lower()) > 1})
    if doubled:
        raise ValueError(f"{where} must name each column once, got {', '.join(doubled)} twice")
    times = [place for place, name in enumerate(lowered) if name in _TIMES]
    if len(times) > 1:
        raise ValueError(f"{where} must have one column of times, got {', '.join(_TIMES)}")
    coordinates = [
        place for place, name in enumerate(lowered) if name != _DEMONSTRATION and place not in times
    ]
    labelled = _DEMONSTRATION in lowered
    if not (labelled or one_of_several) or not coordinates:
        raise ValueError(
            f"{path} must have the columns demonstration, time (optional) and one for each "
            f"coordinate, got {', '.join(names) or 'none'}; of files with one demonstration each, "
            "give a list"
        )
    if joints is not None:
        named = {names[place]: place for place in coordinates}
        coordinates = _of_joints(named, joints, where)
    counting = [names[place] for place in coordinates if lowered[place] in _NO_COORDINATES]
    if counting and (joints is None or not set(counting) <= set(joints)):
        raise ValueError(
            f"{where} has the column {counting[0]!r}, which is no coordinate: leave it out, call "
            f"it time if it holds times that rise, or give it another name"
        )
    label = lowered.index(_DEMONSTRATION) if labelled else -1
    return [label, times[0] if times else -1, *coordinates]


def _of_joints(places: Mapping[str, int], joints: Sequence[str], where: str) -> list[int]:
    """Return the places of columns in the order of a robot's joints."""
    if not set(places) & set(joints):
        alike = [name for name in places if any(joint in name for joint in joints)]
        if not alike:
            return list(places.values())
        raise ValueError(
            f"{where} must call columns as the joints are called, {', '.join(joints)}; "
            f"got {alike[0]!r}"
        )
    missing = [joint for joint in joints if joint not in places]
    if missing:
        raise ValueError(f"{where} must have a column for each joint, got none for {missing[0]!r}")
    other = [name for name in places if name not in joints]
    if other:
        raise ValueError(
            f"{where} has the column {other[0]!r}, which is none of the joints {', '.join(joints)}"
        )
    return [places[joint] for joint in joints]


def _demonstrations(
    lines: Any,
    path: Path,
    joints: Sequence[str] | None,
    nan_is_missing: bool,
    one_of_several: bool,
) -> list[FloatArray]:
    names = [name.strip() for name in next(lines, [])]
    label, time, *coordinates = _columns(names, path, joints, one_of_several)
    numbers = coordinates if time < 0 else [time, *coordinates]
    rows: dict[str, list[list[float]]] = {}
    for line in lines:
        if not any(entry.strip() for entry in line):
            continue
        where = f"{path}, line {lines.line_num}"
        if len(line) != len(names):
            raise ValueError(f"{where} must have {len(names)} entries, got {len(line)}")
        row = []
        for place in numbers:
            missing = nan_is_missing and place != time
            row.append(_number(line[place], f"{where}, column {names[place]!r}", missing))
        name = line[label].strip() if label >= 0 else ""
        known = rows.setdefault(name, [])
        if time >= 0 and known and row[0] <= known[-1][0]:
            raise ValueError(
                f"{where}, column {names[time]!r}: times of demonstration {name!r} "
                f"must rise, got {line[time].strip()} after {known[-1][0]!r}"
            )
        known.append(row)
    given = [np.array(samples) for samples in rows.values()]
    return given if time < 0 else [_evenly(samples) for samples in given]


def _number(entry: str, where: str, missing: bool) -> float:
    entry = entry.strip()
    try:
        number = math.nan if missing and not entry else float(entry.replace("_", " "))
    except ValueError:
        raise ValueError(f"{where} must hold numbers, got {shown(entry)}") from None
    if math.isinf(number) or (math.isnan(number) and not missing):
        hint = "; nan_is_missing=True takes NaN for what is missing" if math.isnan(number) else ""
        raise ValueError(f"{where} must hold finite numbers, got {entry}{hint}")
    return number


def _evenly(samples: FloatArray) -> FloatArray:
    """Return the coordinates (T, D) of samples (T, 1 + D), interpolated to equal steps of time."""
    times = samples[:, 0]
    even = np.linspace(times[0], times[-1], len(times))
    return np.stack([np.interp(even, times, column) for column in samples[:, 1:].T], axis=1)
