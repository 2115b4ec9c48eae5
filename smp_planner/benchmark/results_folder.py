"""A folder of results: a manifest and a file of rows that is only added to, so that runs continue.

``manifest.json`` holds what was requested, with which versions. The file of rows holds one JSON
object a line, written as its row is done; a line torn by a crash is dropped.
"""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar

from pydantic import TypeAdapter, ValidationError

from smp_gym.atomic_files import write_text

__all__ = [
    "ResultsError",
    "ResultsFolder",
    "checked",
    "parse_row",
    "read_manifest",
    "read_rows",
    "row_line",
    "write_json",
    "write_table",
]

MANIFEST = "manifest.json"
FORMAT_VERSION = 1
"""Version of the layout of a folder of results."""

_GROWING = "episodes"


class KeyedRow(Protocol):
    """Protocol of rows: dataclasses that record one piece of work each."""

    @property
    def key(self) -> Any:
        """Identifier of the piece of work."""
        ...


Row = TypeVar("Row", bound=KeyedRow)
Parsed = TypeVar("Parsed")


class ResultsError(ValueError):
    """A folder of results cannot be read or continued."""


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file of one object; values that are not finite are an error."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_text(path, text.getvalue())


def read_manifest(folder: Path, parse: Callable[[dict[str, Any]], Parsed]) -> Parsed:
    """Return the manifest of a folder.

    Args:
        folder: of the results.
        parse: of its entries, the format left out.

    Raises:
        ResultsError: there is none, or it is damaged or of another format.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise ResultsError(f"{str(folder)!r} holds no results: there is no {MANIFEST} in it")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        version = content.pop("format")
        if version != FORMAT_VERSION:
            raise ValueError(f"format must be {FORMAT_VERSION}, got {version!r}")
        return parse(content)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ResultsError(f"{path} is not a manifest of results: {error}") from error


def checked(kind: Any, content: str | bytes) -> Any:
    """Return JSON as what it has to be.

    Args:
        kind: a type, such as a dataclass, that says what that is.
        content: JSON, in which every value has to be of its type already.

    Raises:
        ValueError: it is something else; the message names the place and the value.
    """
    try:
        return TypeAdapter(kind).validate_json(content, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "all of it"
        raise ValueError(f"{place}: {first['msg']}, got {first['input']!r:.60}") from None


def row_line(row: Any) -> bytes:
    """Return the line that a row is kept as; values that are not finite are a ValueError."""
    return (json.dumps(asdict(row), allow_nan=False) + "\n").encode("utf-8")


def parse_row(kind: type[Parsed], line: bytes) -> Parsed:
    """Return the row that a line holds.

    Raises:
        ValueError: the line is not what `row_line` gives for a row of that kind: values have other
            types or are not finite, fields are missing, doubled or not known.
    """
    row: Parsed = checked(kind, line)
    if row_line(row) != line:
        raise ValueError("fields are missing, doubled, not known, or not in their order")
    return row


class _Rows(Generic[Row]):
    """The rows of a file, each of a key of its own that belongs there."""

    def __init__(self, kind: type[Row], belongs: Callable[[Any], bool]) -> None:
        self._kind, self._belongs = kind, belongs
        self._keys: set[Any] = set()
        self.rows: list[Row] = []

    def parse(self, line: bytes) -> Row:
        """Return the row that a line holds, to be added.

        Raises:
            ValueError: it is not a row, does not belong there, or is there already.
        """
        row = parse_row(self._kind, line)
        if not self._belongs(row.key):
            raise ValueError(f"it does not belong to this run: {row.key}")
        if row.key in self._keys:
            raise ValueError(f"it is there twice: {row.key}")
        return row

    def add(self, row: Row) -> None:
        """Add a row that `parse` has given."""
        self._keys.add(row.key)
        self.rows.append(row)


def read_rows(path: Path, kind: type[Row], belongs: Callable[[Any], bool]) -> list[Row]:
    """Return the rows of a file.

    A last line without an end was torn by a crash, and is left out. A file that does not exist has
    no rows.

    Args:
        path: of the file.
        kind: the dataclass of its rows.
        belongs: whether a key can be one of the run's.

    Raises:
        ResultsError: a line is not such a row, or of a key that does not belong there or was there
            before; the message names file and line.
    """
    return _read_rows(path, kind, belongs)[0].rows


def _read_rows(
    path: Path, kind: type[Row], belongs: Callable[[Any], bool]
) -> tuple[_Rows[Row], int]:
    """Return the rows of a file, and the length of its whole lines in bytes."""
    content = path.read_bytes() if path.exists() else b""
    whole = content.rfind(b"\n") + 1
    rows = _Rows(kind, belongs)
    for number, line in enumerate(io.BytesIO(content[:whole]), start=1):
        try:
            rows.add(rows.parse(line))
        except ValueError as error:
            raise ResultsError(
                f"{path}, line {number}, is not a row of these results: {error}"
            ) from error
    return rows, whole


def _differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    lines = []
    for name in {**here, **there}:
        old, new = there.get(name), here.get(name)
        if name == _GROWING:
            if here[name] < there[name]:
                lines.append(f"{name}: {old} there, only {new} now")
        elif isinstance(new, Mapping):
            old = old if isinstance(old, Mapping) else {}
            lines += [
                f"{name.removesuffix('s')} of {part}: {old.get(part)} there, {new.get(part)} now"
                for part in sorted({*old, *new})
                if old.get(part) != new.get(part)
            ]
        elif old != new:
            lines.append(f"{name}: {old!r} there, {new!r} now")
    return lines


class ResultsFolder(Generic[Row]):
    """The results of one folder, open for more rows, and for no other process.

    Args:
        folder: made if it does not exist.
        rows_file: name of the file of rows.
        kind: the dataclass of its rows.
        manifest: what is to be measured, as JSON holds it. A folder that exists is continued if it
            was made for the same; an entry ``episodes`` may have grown.
        belongs: whether a key can be one of the run's.
        parse_manifest: of the entries of the manifest that is there.
        restart: drop the rows of a folder that was made for something else, instead of refusing.

    Attributes:
        folder: see above.

    Raises:
        ResultsError: the folder was made for something else, is damaged, or is in use.
    """

    def __init__(
        self,
        folder: Path,
        rows_file: str,
        kind: type[Row],
        manifest: Mapping[str, Any],
        *,
        belongs: Callable[[Any], bool],
        parse_manifest: Callable[[dict[str, Any]], Any] = dict,
        restart: bool = False,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._path = folder / rows_file
        self._file = self._path.open("ab", buffering=0)
        try:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise ResultsError(f"another run is writing to {str(folder)!r}") from error
            self._adopt(manifest, parse_manifest, restart)
            self._rows, self._length = _read_rows(self._path, kind, belongs)
            os.truncate(self._path, self._length)
        except BaseException:
            self._file.close()
            raise

    def _adopt(
        self, manifest: Mapping[str, Any], parse: Callable[[dict[str, Any]], Any], restart: bool
    ) -> None:
        here = json.loads(json.dumps(manifest))
        if (self.folder / MANIFEST).exists():
            read_manifest(self.folder, parse)
            differences = _differences(read_manifest(self.folder, dict), here)
            if differences and restart:
                os.truncate(self._path, 0)
            elif differences:
                raise ResultsError(
                    f"{str(self.folder)!r} holds results of other settings and is left as it is; "
                    f"choose another folder, or start anew. {'; '.join(differences)}"
                )
        elif self._path.stat().st_size:
            raise ResultsError(f"{str(self.folder)!r} holds rows but no {MANIFEST}: damaged")
        write_json(self.folder / MANIFEST, {"format": FORMAT_VERSION, **here})

    @property
    def rows(self) -> list[Row]:
        """The rows that are there."""
        return self._rows.rows

    def append(self, row: Row) -> None:
        """Add one row; it is on disk when this returns.

        Raises:
            ResultsError: values of the row have other types than its fields or are not finite, it
                is there already or does not belong there, or the folder is not what it was.
            OSError: the row cannot be written, as to a disk that is full; what was written of it
                is taken back.
        """
        self._check_in_place()
        try:
            # Numbers without a fraction are floats where the field is one.
            line = row_line(checked(type(row), row_line(row)))
            kept = self._rows.parse(line)
        except ValueError as error:
            raise ResultsError(f"a row cannot be kept in {self._path}: {error}") from error
        try:
            left = memoryview(line)
            while left:
                left = left[self._file.write(left) :]
            os.fsync(self._file.fileno())
        except BaseException as error:
            os.ftruncate(self._file.fileno(), self._length)
            if isinstance(error, OSError):
                raise OSError(error.errno, error.strerror, str(self._path)) from error
            raise
        self._length += len(line)
        self._rows.add(kept)

    def _check_in_place(self) -> None:
        """Raise ResultsError unless the folder holds what this run has put there."""
        here = os.fstat(self._file.fileno())
        try:
            there = self._path.stat()
        except FileNotFoundError:
            there = None
        if (
            there is None
            or not os.path.samestat(there, here)
            or there.st_size != self._length
            or not (self.folder / MANIFEST).exists()
        ):
            raise ResultsError(
                f"{str(self.folder)!r} was removed, replaced or changed while this run was writing "
                "to it; what is not there has to be played again"
            )

    def missing(self, keys: Iterable[Any]) -> list[Any]:
        """Return those of `keys` that have no row yet, in their order."""
        present = {row.key for row in self.rows}
        return [key for key in keys if key not in present]

    def close(self) -> None:
        """Close the file and let other runs have the folder."""
        self._file.close()

    def __enter__(self) -> ResultsFolder[Row]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
