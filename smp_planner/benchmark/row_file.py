"""A file of rows, one JSON object a line, only added to: what a run that was cut left is whole."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

__all__ = ["ResultsError", "RowFile", "read_rows"]

Row = TypeVar("Row")


class ResultsError(ValueError):
    """A folder of results cannot be read or continued."""


def read_rows(path: Path, parse: Callable[[str], Row]) -> tuple[list[Row], int]:
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
            rows.append(parse(line.decode("utf-8")))
        except (ValueError, TypeError) as error:
            raise ResultsError(
                f"{path}, line {number}, is not a row of results: {line[:80]!r} ({error})"
            ) from error
    return rows, whole


class RowFile(Generic[Row]):
    """A file of rows, open for more, and for no other process.

    Args:
        path: of the file, made if it does not exist; its folder must exist.
        parse: of a line.

    Raises:
        ResultsError: another process has it open.
    """

    def __init__(self, path: Path, parse: Callable[[str], Row]) -> None:
        self._path, self._parse = path, parse
        self._file = path.open("ab", buffering=0)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._file.close()
            raise ResultsError(f"another run is writing to {str(path.parent)!r}") from error

    def read(self) -> list[Row]:
        """Return all rows, and drop a line torn by a crash.

        Raises:
            ResultsError: a line is no row.
        """
        rows, whole = read_rows(self._path, self._parse)
        os.truncate(self._path, whole)
        return rows

    def clear(self) -> None:
        """Drop all rows."""
        os.truncate(self._path, 0)

    @property
    def empty(self) -> bool:
        """Whether there is nothing in the file."""
        return self._path.stat().st_size == 0

    def append(self, row: Mapping[str, Any]) -> None:
        """Add one row; it is on disk when this returns."""
        line = json.dumps(row, allow_nan=False) + "\n"
        self._file.write(line.encode("utf-8"))
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file and let other processes have it."""
        self._file.close()
