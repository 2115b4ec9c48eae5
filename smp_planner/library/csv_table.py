"""Demonstrations from CSV tables, whose columns are known by their names."""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from smp_gym.arrays import FloatArray, shown
from smp_gym.untrusted_files import read_file

__all__ = ["Recording", "read_csv"]

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

_AXES = (("x", "y"), ("x", "y", "z"))
"""Names of coordinates, in any case, that are put into this order."""

_SIGNS = re.compile(r"[\W_]+")
_NUMBERED = re.compile(r"(.*?)(\d+)\D*")
_LEAST_LETTERS = 3
"""Of a part of a name by which a joint is known."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A demonstration, and what was recorded beside its coordinates.

    Attributes:
        path: (T, D) at equal steps of phase.
        duration: in the unit of the times; None where there were none.
        phases: (T,) of the samples of the signals, from 0 to 1; None for equal steps.
        signals: (T,) by name.
    """

    path: FloatArray
    duration: float | None = None
    phases: FloatArray | None = None
    signals: Mapping[str, FloatArray] = field(default_factory=dict)


def read_csv(
    path: Path,
    joints: Sequence[str] | None = None,
    signals: Sequence[str] = (),
    *,
    nan_is_missing: bool = False,
    one_of_several: bool = False,
) -> list[Recording]:
    """Return the demonstrations of a `.csv` file, in the order in which they first appear.

    Its first line names the columns: `demonstration`, which tells rows of different demonstrations
    apart; `time` or `timestamp`, optional; and one for each coordinate, of which x, y and z may
    stand in any order. With times, which rise within a demonstration, samples are interpolated to
    equal steps; without, they stand at such. Columns are separated by commas, semicolons (numbers
    may have decimal commas then) or tabs; the text is UTF-8, or UTF-16 with a byte order mark.

    Args:
        path: of the file.
        joints: names of a robot's joints. Columns of these names are put into their order;
            columns none of which is named like a joint are taken as they stand, unless parts of
            names or their numbers say that this is another order.
        signals: names of columns that are no coordinates.
        nan_is_missing: whether an empty entry or NaN is a number that was not measured.
        one_of_several: whether the file is one of several: without a column `demonstration` it then
            holds one.

    Raises:
        FileNotFoundError: no such file.
        ValueError: the file is no such table; the message names file, line and column.
    """
    lines = csv.reader(io.StringIO(_text(path), newline=""), delimiter=",", strict=True)
    try:
        return _recordings(lines, path, joints, signals, nan_is_missing, one_of_several)
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
    names: Sequence[str],
    path: Path,
    joints: Sequence[str] | None,
    signals: Sequence[str],
    one_of_several: bool,
) -> list[int]:
    """Return the places of the columns demonstration and time (or -1), coordinates and signals."""
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
    missing = [name for name in signals if name not in (names[place] for place in coordinates)]
    if missing:
        raise ValueError(
            f"{where} must have a column for each signal, got none for {missing[0]!r} in "
            f"{', '.join(names)}"
        )
    coordinates = [place for place in coordinates if names[place] not in signals]
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
    elif tuple(sorted(lowered[place] for place in coordinates)) in _AXES:
        coordinates.sort(key=lowered.__getitem__)
    counting = [names[place] for place in coordinates if lowered[place] in _NO_COORDINATES]
    if counting and (joints is None or not set(counting) <= set(joints)):
        raise ValueError(
            f"{where} has the column {counting[0]!r}, which is no coordinate: leave it out, call "
            f"it time if it holds times that rise, or give it another name"
        )
    label = lowered.index(_DEMONSTRATION) if labelled else -1
    beside = [names.index(name) for name in signals]
    return [label, times[0] if times else -1, *coordinates, *beside]


def _of_joints(places: Mapping[str, int], joints: Sequence[str], where: str) -> list[int]:
    """Return the places of columns in the order of a robot's joints."""
    if not set(places) & set(joints):
        alike = [name for name in places if any(joint in name for joint in joints)]
        alike = alike or _out_of_order(list(places), joints)
        if not alike:
            return list(places.values())
        raise ValueError(
            f"{where} must call columns as the joints are called, {', '.join(joints)}, or by other "
            f"names in this order; got {alike[0]!r}"
        )
    missing = [joint for joint in joints if joint not in places]
    if missing:
        raise ValueError(f"{where} must have a column for each joint, got none for {missing[0]!r}")
    other = [name for name in places if name not in joints]
    if other:
        raise ValueError(
            f"{where} has the column {other[0]!r}, which is none of the joints "
            f"{', '.join(joints)}; signals=[{other[0]!r}] carries it along"
        )
    return [places[joint] for joint in joints]


def _out_of_order(names: Sequence[str], joints: Sequence[str]) -> list[str]:
    """Return the names of columns that seem to stand in another order than the joints.

    Columns that are called otherwise than the joints are read as they stand, which parts of names
    in another order, or numbers that do not rise, contradict.
    """
    meant: dict[str, int] = {}
    for name in names:
        alike = [index for index, joint in enumerate(joints) if _names_alike(name, joint)]
        if len(alike) == 1:
            meant[name] = alike[0]
    if meant:
        return [name for place, name in enumerate(names) if meant.get(name, place) != place]
    numbers = [_NUMBERED.fullmatch(name) for name in names]
    numbered = [(found[1], int(found[2])) for found in numbers if found is not None]
    is_counted = len(numbered) == len(names) and len({stem for stem, _ in numbered}) == 1
    if not is_counted:
        return []
    pairs = zip(numbered, numbered[1:], names[1:], strict=False)
    return [name for (_, before), (_, after), name in pairs if after <= before]


def _names_alike(one: str, other: str) -> bool:
    """Return whether one of two names is a part of the other, signs and case aside."""
    plain = (_SIGNS.sub("", name).lower() for name in (one, other))
    part, whole = sorted(plain, key=len)
    if sum(letter.isalpha() for letter in part) < _LEAST_LETTERS:
        return False
    # Joint 1 is no part of joint 12.
    begin = r"(?<!\d)" if part[0].isdigit() else ""
    end = r"(?!\d)" if part[-1].isdigit() else ""
    return re.search(begin + re.escape(part) + end, whole) is not None


def _recordings(
    lines: Any,
    path: Path,
    joints: Sequence[str] | None,
    signals: Sequence[str],
    nan_is_missing: bool,
    one_of_several: bool,
) -> list[Recording]:
    names = [name.strip() for name in next(lines, [])]
    label, time, *measured = _columns(names, path, joints, signals, one_of_several)
    numbers = measured if time < 0 else [time, *measured]
    rows: dict[str, list[list[float]]] = {}
    for line in lines:
        if not any(entry.strip() for entry in line):
            continue
        where = f"{path}, line {lines.line_num}"
        if len(line) != len(names):
            raise ValueError(f"{where} must have {len(names)} entries, got {len(line)}")
        row = []
        for place in numbers:
            entry = f"{where}, column {names[place]!r}"
            if names[place] in signals:
                row.append(_number(line[place], entry, None))
            else:
                row.append(_number(line[place], entry, nan_is_missing and place != time))
        name = line[label].strip() if label >= 0 else ""
        known = rows.setdefault(name, [])
        if time >= 0 and known and row[0] <= known[-1][0]:
            raise ValueError(
                f"{where}, column {names[time]!r}: times of demonstration {name!r} "
                f"must rise, got {line[time].strip()} after {known[-1][0]!r}"
            )
        known.append(row)
    return [_recording(np.array(samples), time >= 0, signals) for samples in rows.values()]


def _number(entry: str, where: str, missing: bool | None) -> float:
    """Return the number of an entry; None where no option allows that it is missing."""
    entry = entry.strip()
    try:
        number = math.nan if missing and not entry else float(entry.replace("_", " "))
    except ValueError:
        raise ValueError(f"{where} must hold numbers, got {shown(entry)}") from None
    if math.isinf(number) or (math.isnan(number) and not missing):
        hint = "; nan_is_missing=True takes NaN for what is missing"
        hint = hint if math.isnan(number) and missing is not None else ""
        raise ValueError(f"{where} must hold finite numbers, got {entry}{hint}")
    return number


def _recording(samples: FloatArray, is_timed: bool, signals: Sequence[str]) -> Recording:
    """Return what samples (T, ...) hold: times, if there are some, coordinates, signals."""
    times = samples[:, 0] if is_timed else None
    measured = samples[:, 1:] if is_timed else samples
    path = measured[:, : measured.shape[1] - len(signals)]
    beside = dict(zip(signals, measured[:, path.shape[1] :].T, strict=True))
    if times is None:
        return Recording(path, signals=beside)
    duration = float(times[-1] - times[0])
    if len(times) < 2:
        return Recording(path, signals=beside)
    return Recording(_evenly(times, path), duration, (times - times[0]) / duration, beside)


def _evenly(times: FloatArray, path: FloatArray) -> FloatArray:
    """Return the coordinates (T, D) at times (T,), interpolated to equal steps of time."""
    even = np.linspace(times[0], times[-1], len(times))
    return np.stack([np.interp(even, times, column) for column in path.T], axis=1)
