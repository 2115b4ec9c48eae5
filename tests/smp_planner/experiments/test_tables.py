"""Tables of repeated measurements."""

import csv
import io
import json
import statistics
from pathlib import Path

import pytest
from rich.console import Console

from smp_planner.experiments.tables import (
    Column,
    Spread,
    print_table,
    report,
    summarise,
    write_tables,
)

ROWS = [
    {"method": "b", "free": 1.0, "distance": 2.5},
    {"method": "a", "free": 42.0, "distance": None},
    {"method": "b", "free": 4.0, "distance": None},
    {"method": "b", "free": 10.0, "distance": 3.5},
]
COLUMNS = [Column("method", "Method"), Column("free", "Free", 1, True), Column("distance", "W1")]


def test_summaries_agree_with_the_standard_library() -> None:
    first, second = summarise(ROWS, ["method"])
    assert (first["method"], second["method"]) == ("b", "a")
    values = [1.0, 4.0, 10.0]
    assert first["free"] == Spread(
        pytest.approx(statistics.mean(values)),
        pytest.approx(statistics.stdev(values)),
        1.0,
        10.0,
        3,
    )
    assert first["distance"] == Spread(3.0, pytest.approx(0.5**0.5), 2.5, 3.5, 2)
    assert second["free"] == Spread(42.0, 0.0, 42.0, 42.0, 1)
    assert second["distance"] == Spread(None, None, None, None, 0)


def test_files_hold_the_same(tmp_path: Path) -> None:
    summaries = summarise(ROWS, ["method"])
    write_tables(ROWS, summaries, COLUMNS, tmp_path / "out", "t", "Three repetitions.")
    with (tmp_path / "out" / "t.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["method"] for row in rows] == ["b", "a", "b", "b"]
    assert [row["distance"] for row in rows] == ["2.5", "", "", "3.5"]
    plain = json.loads((tmp_path / "out" / "t.json").read_text())
    assert plain[0]["free"]["mean"] == 5.0
    assert plain[1]["distance"]["mean"] is None
    lines = (tmp_path / "out" / "t.md").read_text().splitlines()
    assert lines[0] == "| Method | Free | W1 |"
    assert lines[2] == "| b | 5.0 ± 4.6 (1–10) | 3.00 ± 0.71 |"
    assert lines[3] == "| a | 42.0 ± 0.0 (42–42) | – |"
    assert lines[-1] == "Three repetitions."
    narrow = Console(width=20, file=io.StringIO())
    print_table(narrow, summaries, COLUMNS)
    assert isinstance(narrow.file, io.StringIO)
    assert "42.0 ± 0.0 (42–42)" in narrow.file.getvalue()


def test_names_of_repetitions_are_in_no_summary() -> None:
    (summary,) = summarise([{"a": "x", "b": 1.0}, {"a": "y", "b": 2.0}], [])
    assert list(summary) == ["b"]


def test_errors() -> None:
    with pytest.raises(ValueError, match=r"rows\[1\] has \['a', 'b'\], rows\[0\] has \['a'\]"):
        summarise([{"a": 1.0}, {"a": 1.0, "b": 2.0}], [])
    with pytest.raises(ValueError, match="a must be a finite number or None, got 'x'"):
        summarise([{"a": "x"}, {"a": 1.0}], [])
    with pytest.raises(ValueError, match="a must be a finite number or None, got nan"):
        summarise([{"a": float("nan")}], [])


def test_a_report_is_printed_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summaries = report(ROWS, ["method"], COLUMNS, tmp_path, "t", "Three repetitions.", "A title")
    assert summaries == summarise(ROWS, ["method"])
    printed = capsys.readouterr().out
    for text in ("A title", "5.0 ± 4.6 (1–10)", "Three repetitions.", "t.csv, .json and .md"):
        assert text in printed
    assert {path.name for path in tmp_path.iterdir()} == {"t.csv", "t.json", "t.md"}
