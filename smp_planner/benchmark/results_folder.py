"""A folder of results: one SQLite file with what was requested and a row for each piece of work.

``results.sqlite`` is all that there is to a run: its manifest says what was requested and with
which versions, and each row is on disk once its piece of work is done. While a run is writing, what
is new may stand in a write-ahead log beside it (``results.sqlite-wal``), which belongs to it; a run
that ends takes it back, and after a kill whoever opens the file next does.
"""

from __future__ import annotations

import csv
import io
import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, TypeVar

from smp_gym.atomic_files import write_text
from smp_gym.folder_lock import FolderLock
from smp_planner.benchmark.row_table import Row, RowTable

__all__ = [
    "RESULTS",
    "ResultsError",
    "ResultsFolder",
    "ResultsKind",
    "read_folder",
    "write_json",
    "write_table",
]

RESULTS = "results.sqlite"
"""Name of the file of results."""

FORMAT_VERSION = 2
"""Version of the layout of a folder of results; the first was of lines of JSON."""

# Marks our files among those of SQLite: "smpb".
_APPLICATION = 0x736D7062
_OLD_MANIFEST = "manifest.json"
_GROWING = "episodes"

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


@dataclass(frozen=True)
class ResultsKind(Generic[Parsed, Row]):
    """A kind of results: what is in the manifest, what is in a row, and how they belong together.

    Attributes:
        table: of the rows.
        parse: of the entries of a manifest, as JSON holds them; raises KeyError, TypeError or
            ValueError where they are something else.
        belongs: from a manifest, whether a key can be one of the run's.
    """

    table: RowTable[Row]
    parse: Callable[[dict[str, Any]], Parsed]
    belongs: Callable[[Parsed], Callable[[Any], bool]]


def read_folder(folder: Path, kind: ResultsKind[Parsed, Row]) -> tuple[Parsed, list[Row]]:
    """Return manifest and rows of a folder of results, finished or not.

    Raises:
        ResultsError: there are no results, or they are damaged or of another kind or format.
    """
    path = folder / RESULTS
    if not path.is_file():
        raise ResultsError(
            _of_old_format(folder)
            or f"{str(folder)!r} holds no results: there is no {RESULTS} in it"
        )
    log = Path(f"{path}-wal")
    options = "mode=rw"
    if not os.access(folder, os.W_OK):
        # Without a log nobody is writing, and SQLite need not ask who is, which takes a file.
        logged = log.exists() and log.stat().st_size > 0
        options = "mode=ro" if logged else "mode=ro&immutable=1"
    with _naming(path), _opened(path, options) as database, _transaction(database, "DEFERRED"):
        if _is_empty(database):
            raise ResultsError(f"{path} holds no results yet")
        _check_format(database, path)
        manifest = _parsed(_manifest(database, path), kind, path)
        return manifest, _rows(database, path, kind.table, kind.belongs(manifest))


def _of_old_format(folder: Path) -> str:
    """Return what to say of a folder that an older version wrote; nothing of another."""
    if not (folder / _OLD_MANIFEST).is_file():
        return ""
    return (
        f"{str(folder)!r} holds results as an older version wrote them and is left as it is: "
        f"`smp-bench import {folder} --out NEW` makes a folder of today of those of the benchmark"
    )


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the file in the errors of SQLite."""
    try:
        yield
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise ResultsError(f"{path} cannot be read or written as results: {error}") from error


@contextmanager
def _opened(path: Path, options: str) -> Iterator[sqlite3.Connection]:
    """Open a database and close it; what is torn or none at all is an error of SQLite at once."""
    database = sqlite3.connect(f"{path.absolute().as_uri()}?{options}", uri=True)
    try:
        database.isolation_level = None
        damage = database.execute("PRAGMA quick_check(1)").fetchone()[0]
        if damage != "ok":
            raise sqlite3.DatabaseError(" ".join(damage.split()))
        yield database
    finally:
        database.close()


@contextmanager
def _transaction(database: sqlite3.Connection, kind: str) -> Iterator[None]:
    """Do all of it or nothing."""
    database.execute(f"BEGIN {kind}")
    try:
        yield
        database.execute("COMMIT")
    except BaseException:
        # A disk that is full may have ended the transaction already.
        if database.in_transaction:
            database.execute("ROLLBACK")
        raise


def _is_empty(database: sqlite3.Connection) -> bool:
    """Return whether nothing has been written to a database: a kill came first."""
    return database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0] == 0


def _check_format(database: sqlite3.Connection, path: Path) -> None:
    application = database.execute("PRAGMA application_id").fetchone()[0]
    version = database.execute("PRAGMA user_version").fetchone()[0]
    if application != _APPLICATION:
        raise ResultsError(f"{path} is a database of something else than results")
    if version != FORMAT_VERSION:
        raise ResultsError(f"{path}: its format must be {FORMAT_VERSION}, got {version}")


def _manifest(database: sqlite3.Connection, path: Path) -> dict[str, Any]:
    """Return the entries of the manifest, as JSON holds them."""
    entries = database.execute("SELECT entry, value FROM manifest ORDER BY rowid")
    try:
        return {entry: json.loads(value) for entry, value in entries}
    except (ValueError, TypeError, RecursionError) as error:
        raise ResultsError(f"{path} holds no manifest of results: {error}") from error


def _parsed(content: dict[str, Any], kind: ResultsKind[Parsed, Row], path: Path) -> Parsed:
    try:
        return kind.parse(content)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ResultsError(f"{path} holds no manifest of these results: {error}") from error


def _rows(
    database: sqlite3.Connection, path: Path, table: RowTable[Row], belongs: Callable[[Any], bool]
) -> list[Row]:
    rows = []
    try:
        for row in table.read(database):
            if not belongs(row.key):
                raise ValueError(f"a row does not belong to this run: {row.key}")
            rows.append(row)
    except ValueError as error:
        raise ResultsError(f"{path} is damaged: {error}") from error
    return rows


def _differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    lines = []
    for name in {**here, **there}:
        old, new = there.get(name), here.get(name)
        if name == _GROWING and old is not None and new is not None:
            if new < old:
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


class ResultsFolder(Generic[Parsed, Row]):
    """The results of one folder, open for more rows, and for no other process.

    Args:
        folder: made if it does not exist.
        kind: of the results.
        manifest: what is to be measured, as JSON holds it. A folder that exists is continued if it
            was made for the same; an entry ``episodes`` may have grown.
        restart: drop the rows of a folder that was made for something else, instead of refusing.

    Attributes:
        folder: see above.
        rows: that are there.

    Raises:
        ResultsError: the folder was made for something else, or is damaged.
        OSError: it is in use (`FolderInUseError`), or cannot be written to.
    """

    def __init__(
        self,
        folder: Path,
        kind: ResultsKind[Parsed, Row],
        manifest: Mapping[str, Any],
        *,
        restart: bool = False,
    ) -> None:
        self.folder, self._kind, self._path = folder, kind, folder / RESULTS
        here = json.loads(json.dumps(manifest))
        self._belongs = kind.belongs(kind.parse(here))
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as opened:
            opened.enter_context(FolderLock(folder))
            if not (self._path.exists() or restart) and (old := _of_old_format(folder)):
                raise ResultsError(old)
            with _naming(self._path):
                self._database = opened.enter_context(_opened(self._path, "mode=rwc"))
                with _transaction(self._database, "IMMEDIATE"):
                    self._adopt(here, restart)
                # Readers do not keep a row from being written, and a row is on disk when it is in
                # the log.
                self._database.execute("PRAGMA journal_mode=WAL")
                self._database.execute("PRAGMA synchronous=FULL")
                self.rows = _rows(self._database, self._path, kind.table, self._belongs)
            self._keys = {row.key for row in self.rows}
            self._traces = self._found()
            self._opened = opened.pop_all()

    def _adopt(self, here: dict[str, Any], restart: bool) -> None:
        """Have the file be one of this run's, within a transaction."""
        database = self._database
        if not _is_empty(database):
            _check_format(database, self._path)
            there = _manifest(database, self._path)
            _parsed(there, self._kind, self._path)
            differences = _differences(there, here)
            if not differences:
                database.execute("DELETE FROM manifest")
            elif restart:
                tables = database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
                for (name,) in tables.fetchall():
                    database.execute(f'DROP TABLE "{name}"')
            else:
                raise ResultsError(
                    f"{str(self.folder)!r} holds results of other settings and is left as it is; "
                    f"choose another folder, or start anew. {'; '.join(differences)}"
                )
        if _is_empty(database):
            database.execute(f"PRAGMA application_id={_APPLICATION}")
            database.execute(f"PRAGMA user_version={FORMAT_VERSION}")
            database.execute("CREATE TABLE manifest (entry TEXT PRIMARY KEY, value TEXT NOT NULL)")
            self._kind.table.create(database)
        entries = [(entry, json.dumps(value, allow_nan=False)) for entry, value in here.items()]
        database.executemany("INSERT INTO manifest VALUES (?, ?)", entries)

    def append(self, row: Row) -> None:
        """Add one row; it is on disk when this returns.

        Raises:
            ResultsError: values of the row have other types than its fields or are not finite, it
                is there already or does not belong there, the folder is not what it was, or the
                row cannot be written, as to a disk that is full; nothing of it is then there.
        """
        if self._found() != self._traces:
            raise ResultsError(
                f"{str(self.folder)!r} was removed, replaced or changed while this run was writing "
                "to it; what is not there has to be played again"
            )
        try:
            kept = self._kind.table.check(row)
            if not self._belongs(row.key):
                raise ValueError(f"it does not belong to this run: {row.key}")
            if row.key in self._keys:
                raise ValueError(f"it is there twice: {row.key}")
            with _transaction(self._database, "IMMEDIATE"):
                self._kind.table.insert(self._database, kept)
        except sqlite3.Error as error:
            raise ResultsError(
                f"{self._path} cannot be written: {error}; the rows before are kept, and the same "
                "command goes on from them"
            ) from error
        except (ValueError, OverflowError) as error:
            raise ResultsError(f"a row cannot be kept in {self._path}: {error}") from error
        finally:
            self._traces = self._found()
        self.rows.append(kept)
        self._keys.add(kept.key)

    def _found(self) -> list[tuple[int, ...]]:
        """Return what tells the files of this run from others in their place."""
        found: list[tuple[int, ...]] = []
        for suffix in ("", "-wal"):
            with suppress(FileNotFoundError, NotADirectoryError):
                status = os.stat(f"{self._path}{suffix}")
                found.append((status.st_dev, status.st_ino, status.st_size))
        return found

    def missing(self, keys: Iterable[Any]) -> list[Any]:
        """Return those of `keys` that have no row yet, in their order."""
        return [key for key in keys if key not in self._keys]

    def close(self) -> None:
        """Take the log back into the file, and let other runs have the folder."""
        with self._opened:
            if self._found() == self._traces:
                # Whoever reads at the moment, or a full disk, keeps the log, which loses nothing.
                with suppress(sqlite3.Error):
                    self._database.execute("PRAGMA journal_mode=DELETE")

    def __enter__(self) -> ResultsFolder[Parsed, Row]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
