"""Rows of a dataclass come back from a database as they went in, also from an older version's."""

import sqlite3
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import pytest

from smp_planner.benchmark.row_table import RowTable, compressed


@dataclass(frozen=True)
class Key:
    name: str


@dataclass(frozen=True)
class Yesterday:
    name: str
    height: float
    done: bool = False

    @property
    def key(self) -> Key:
        return Key(self.name)


@dataclass(frozen=True)
class Part:
    weight: float


@dataclass(frozen=True)
class Today(Yesterday):
    count: int | None = None
    flag: bool | None = None
    parts: tuple[Part, ...] = ()
    best: Part | None = None
    times: Mapping[str, float] = field(default_factory=dict)
    scene: str = compressed()


TODAY, YESTERDAY = RowTable("rows", Today, Key), RowTable("rows", Yesterday, Key)


@pytest.fixture
def database() -> Iterator[sqlite3.Connection]:
    opened = sqlite3.connect(":memory:")
    yield opened
    opened.close()


def put(database: sqlite3.Connection, table: RowTable[Any], *rows: Any) -> None:
    table.create(database)
    for row in rows:
        table.insert(database, table.check(row))


def test_rows_come_back_as_they_went_in(database: sqlite3.Connection) -> None:
    rows = [
        Today("b", 0.1 + 0.2, True, 2**62, False, (Part(5e-324), Part(-1e308)), Part(1.0)),
        Today("a – \u00fc\U0001f916\n'\"", 1.0, times={"map": 1 / 3}, scene="long " * 1000),
        Today("c", 2.0, flag=True, scene="long " * 1000),
    ]
    put(database, TODAY, *rows)
    assert list(TODAY.read(database)) == rows
    assert database.execute("SELECT count(*) FROM texts").fetchone() == (1,)
    (packed,) = database.execute("SELECT content FROM texts").fetchone()
    assert len(packed) < 100


def test_whole_numbers_and_negative_zero_come_back_as_floats(database: sqlite3.Connection) -> None:
    put(database, TODAY, Today("a", 3), Today("b", -0.0))
    assert [repr(row.height) for row in TODAY.read(database)] == ["3.0", "0.0"]


def test_a_field_of_today_has_its_default_in_a_table_of_yesterday(
    database: sqlite3.Connection,
) -> None:
    put(database, YESTERDAY, Yesterday("a", 0.5, True))
    assert list(TODAY.read(database)) == [Today("a", 0.5, True)]


def test_a_field_of_tomorrow_is_named(database: sqlite3.Connection) -> None:
    put(database, TODAY, Today("a", 0.5))
    with pytest.raises(ValueError, match=r"columns that are not known.*'best', 'count', 'flag'"):
        list(YESTERDAY.read(database))


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (Today("a", float("nan")), "JSON compliant"),
        (Today("a", 0.5, count=1.5), "count: .*1.5"),  # type: ignore[arg-type]
        (Today("a", "0.5"), "height: .*'0.5'"),  # type: ignore[arg-type]
        (Today("a", 0.5, times={"map": float("inf")}), "JSON compliant"),
        (Today("\ud800", 0.5), "Invalid JSON"),
    ],
)
def test_a_row_of_other_types_is_refused(row: Today, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TODAY.check(row)


def test_what_a_database_cannot_hold_is_an_error(database: sqlite3.Connection) -> None:
    with pytest.raises(OverflowError):
        put(database, TODAY, Today("a", 0.5, count=2**63))
    assert list(TODAY.read(database)) == []
