"""A table of an SQLite database that holds dataclasses: a row each, a column for each field."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, asdict, field, fields
from functools import lru_cache
from typing import Any, Generic, Protocol, TypeVar, get_type_hints

from pydantic import TypeAdapter, ValidationError

__all__ = ["KeyedRow", "RowTable", "checked", "compressed"]

_COMPRESSED = "compressed"
_TEXTS = "texts"
_ROW_DIGEST = "row_digest"
_LONGEST_TEXT = 2**26
_SQL = {bool: "INTEGER", int: "INTEGER", float: "REAL", str: "TEXT"}


class KeyedRow(Protocol):
    """Protocol of rows: dataclasses that record one piece of work each."""

    @property
    def key(self) -> Any:
        """Identifier of the piece of work, a dataclass whose fields the row has, too."""
        ...


Row = TypeVar("Row", bound=KeyedRow)


def compressed() -> Any:
    """Return a field for a long text, empty by default, that many rows may have in common."""
    return field(default="", repr=False, metadata={_COMPRESSED: True})


def checked(kind: Any, content: str | bytes) -> Any:
    """Return JSON as what it has to be.

    Args:
        kind: a type, such as a dataclass, that says what that is.
        content: JSON, in which every value has to be of its type already.

    Raises:
        ValueError: it is something else; the message names the place and the value.
    """
    try:
        return _adapter(kind).validate_json(content, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "all of it"
        raise ValueError(f"{place}: {first['msg']}, got {first['input']!r:.60}") from None


@lru_cache(maxsize=64)
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _json(value: Any) -> str:
    """Return a value as JSON, dataclasses as objects; what is not finite is a ValueError."""
    return json.dumps(value, allow_nan=False, default=asdict)


class RowTable(Generic[Row]):
    """A table for the rows of a dataclass, with one row at most for each key.

    Numbers, texts and flags are kept as they are, ``None`` as NULL, and all else as JSON. A field
    from `compressed` holds the digest of its text, which the table ``texts`` has once for all rows.
    A last column, ``row_digest``, tells rows that were changed or damaged after they were written.

    Args:
        name: of the table.
        kind: the dataclass of the rows.
        key: the dataclass of their keys.
    """

    def __init__(self, name: str, kind: type[Row], key: type) -> None:
        self._name, self._kind = name, kind
        self._key = [each.name for each in fields(key)]
        hints = get_type_hints(kind)
        described = {each.name: each for each in fields(kind)}  # type: ignore[arg-type]
        self._needed = {
            name
            for name, each in described.items()
            if each.default is MISSING and each.default_factory is MISSING
        }
        self._compressed = {n for n, each in described.items() if _COMPRESSED in each.metadata}
        self._flags = {n for n in described if bool in _parts(hints[n])}
        self._sql = {n: _sql_type(hints[n]) for n in described}

    def create(self, connection: sqlite3.Connection) -> None:
        """Make the table, within the caller's transaction."""
        columns = [
            f'"{name}" {sql or "TEXT"}{" NOT NULL" if name in self._needed else ""}'
            for name, sql in self._sql.items()
        ]
        columns.append(f"{_ROW_DIGEST} TEXT NOT NULL")
        key = ", ".join(f'"{name}"' for name in self._key)
        connection.execute(
            f'CREATE TABLE "{self._name}" ({", ".join(columns)}, PRIMARY KEY ({key}))'
        )
        connection.execute(
            f"CREATE TABLE {_TEXTS} (digest TEXT PRIMARY KEY, content BLOB NOT NULL)"
        )

    def check(self, row: Row) -> Row:
        """Return a row as it will be read again: whole numbers are floats where the field is one.

        Raises:
            ValueError: values have other types than the fields, or are not finite.
        """
        valid: Row = checked(self._kind, _json(row))
        return valid

    def insert(self, connection: sqlite3.Connection, row: Row) -> None:
        """Add a row that `check` has given, within the caller's transaction."""
        for name in self._compressed:
            if text := getattr(row, name):
                packed = zlib.compress(text.encode("utf-8"), 9)
                connection.execute(
                    f"INSERT OR IGNORE INTO {_TEXTS} VALUES (?, ?)", (_digest(text), packed)
                )
        stored = self._stored(row)
        stored[_ROW_DIGEST] = _digest(_json(list(stored.values())))
        names = ", ".join(f'"{name}"' for name in stored)
        marks = ", ".join("?" * len(stored))
        connection.execute(
            f'INSERT INTO "{self._name}" ({names}) VALUES ({marks})', list(stored.values())
        )

    def read(self, connection: sqlite3.Connection) -> Iterator[Row]:
        """Yield the rows in the order in which they came.

        A column that the table lacks, since it is of an older version, has its field's default.

        Raises:
            ValueError: there are other columns, or a row is not what `insert` makes of one.
        """
        found = [row[1] for row in connection.execute(f'PRAGMA table_info("{self._name}")')]
        unknown = set(found) - {*self._sql, _ROW_DIGEST}
        lacking = {*self._needed, _ROW_DIGEST} - set(found)
        if unknown or lacking:
            raise ValueError(
                f"the table {self._name!r} has columns that are not known: {sorted(unknown)}, or "
                f"lacks some: {sorted(lacking)}"
            )
        texts = {"": ""}
        for digest, packed in connection.execute(f"SELECT digest, content FROM {_TEXTS}"):
            texts[digest] = _unpacked(digest, packed)
        names = ", ".join(f'"{name}"' for name in found)
        chosen = connection.execute(f'SELECT {names} FROM "{self._name}" ORDER BY rowid')
        for number, values in enumerate(chosen, start=1):
            try:
                yield self._parsed(dict(zip(found, values, strict=True)), texts)
            except (ValueError, TypeError, RecursionError) as error:
                raise ValueError(f"row {number} of the table {self._name!r}: {error}") from error

    def _stored(self, row: Row) -> dict[str, Any]:
        """Return the values of the columns for a row."""
        stored = {}
        for name, sql in self._sql.items():
            value = getattr(row, name)
            if name in self._compressed:
                value = _digest(value) if value else ""
            elif sql is None and value is not None:
                value = _json(value)
            elif isinstance(value, bool):
                value = int(value)
            elif isinstance(value, float):
                # SQLite has no negative zero.
                value += 0.0
            stored[name] = value
        return stored

    def _parsed(self, stored: Mapping[str, Any], texts: Mapping[str, str]) -> Row:
        """Return the row of the values of the columns."""
        content = {}
        values = {name: value for name, value in stored.items() if name != _ROW_DIGEST}
        for name, value in values.items():
            if name in self._compressed:
                if value not in texts:
                    raise ValueError(f"{name}: no text has the digest {value!r:.60}")
                value = texts[value]
            elif name in self._flags and value in (0, 1):
                value = bool(value)
            elif self._sql[name] is None and value is not None:
                value = json.loads(value)
            content[name] = value
        row: Row = checked(self._kind, _json(content))
        if _digest(_json(list(values.values()))) != stored[_ROW_DIGEST]:
            raise ValueError("it was changed after it was written")
        return row


def _parts(hint: Any) -> tuple[Any, ...]:
    """Return the types of a union, but for None; a type alone."""
    parts = (
        getattr(hint, "__args__", ()) if type(None) in getattr(hint, "__args__", ()) else (hint,)
    )
    return tuple(part for part in parts if part is not type(None))


def _sql_type(hint: Any) -> str | None:
    """Return the type of a column; None for what is kept as JSON."""
    parts = _parts(hint)
    return _SQL.get(parts[0]) if len(parts) == 1 else None


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()[:32]


def _unpacked(digest: str, packed: bytes) -> str:
    """Return a compressed text.

    Raises:
        ValueError: it is damaged.
    """
    try:
        text = zlib.decompressobj().decompress(packed, _LONGEST_TEXT).decode("utf-8")
    except (zlib.error, TypeError) as error:
        raise ValueError(f"the text {digest!r:.60} is damaged: {error}") from error
    if _digest(text) != digest:
        raise ValueError(f"the text {digest!r:.60} is damaged")
    return text
