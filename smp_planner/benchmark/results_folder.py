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

from smp_gym.atomic_files import write_text

__all__ = [
    "ResultsError",
    "ResultsFolder",
    "read_manifest",
    "read_rows",
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
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ResultsError(f"{path} is not a manifest of results: {error}") from error


def read_rows(path: Path, parse: Callable[[dict[str, Any]], Parsed]) -> tuple[list[Parsed], int]:
    """Return the rows of a file and the length of its whole lines in bytes.

    A last line without an end was torn by a crash, and is left out. A file that does not exist has
    no rows.

    Raises:
        ResultsError: a line that `parse` refuses with a ValueError or TypeError.
    """
    content = path.read_bytes() if path.exists() else b""
    whole = content.rfind(b"\n") + 1
    rows = []
    for number, line in enumerate(content[:whole].splitlines(), start=1):
        try:
            rows.append(parse(json.loads(line)))
        except (ValueError, TypeError) as error:
            raise ResultsError(
                f"{path}, line {number}, is not a row of results: {line[:80]!r} ({error})"
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
            old = old or {}
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
        parse: of the JSON object of a row.
        manifest: what is to be measured, as JSON holds it. A folder that exists is continued if it
            was made for the same; an entry ``episodes`` may have grown.
        parse_manifest: of the entries of the manifest that is there.
        restart: drop the rows of a folder that was made for something else, instead of refusing.

    Attributes:
        folder: see above.
        rows: those that are there.

    Raises:
        ResultsError: the folder was made for something else, is damaged, or is in use.
    """

    def __init__(
        self,
        folder: Path,
        rows_file: str,
        parse: Callable[[dict[str, Any]], Row],
        manifest: Mapping[str, Any],
        *,
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
            self.rows, whole = read_rows(self._path, parse)
            os.truncate(self._path, whole)
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

    def append(self, row: Row) -> None:
        """Add one row; it is on disk when this returns."""
        line = json.dumps(asdict(row), allow_nan=False) + "\n"  # type: ignore[call-overload]
        self._file.write(line.encode("utf-8"))
        os.fsync(self._file.fileno())
        self.rows.append(row)

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
