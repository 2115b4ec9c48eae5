"""Tables of repeated measurements: rows, their means and spreads, and the files that hold them.

A row is a mapping from names of columns to texts, numbers or None, one per repetition. Rows are
kept as they are, in CSV; means and standard deviations are kept in JSON, and as text in Markdown.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from smp_gym.atomic_files import write_text
from smp_planner.benchmark.markdown_table import markdown_table
from smp_planner.benchmark.results_folder import write_table

__all__ = ["Column", "Row", "Spread", "print_table", "report", "summarise", "write_tables"]

_WIDEST = 1000
"""Characters in a line of a printed table."""

Row = Mapping[str, str | float | None]

Summary = Mapping[str, "str | Spread"]


@dataclass(frozen=True)
class Spread:
    """Summary of repeated measurements of one quantity; None where there are none.

    Attributes:
        mean: arithmetic mean.
        std: standard deviation, with the count less one for a divisor; 0 for one measurement.
        least: the least of them.
        greatest: the greatest of them.
        count: how many there are; measurements that are None are left out.
    """

    mean: float | None
    std: float | None
    least: float | None
    greatest: float | None
    count: int

    @classmethod
    def of(cls, values: Sequence[float | None]) -> Spread:
        """Return the spread of values, each finite or None."""
        known = np.array([value for value in values if value is not None], np.float64)
        if not len(known):
            return cls(None, None, None, None, 0)
        std = float(known.std(ddof=1)) if len(known) > 1 else 0.0
        return cls(float(known.mean()), std, float(known.min()), float(known.max()), len(known))


@dataclass(frozen=True)
class Column:
    """A column of a printed table.

    Attributes:
        name: key in the rows.
        title: as printed.
        digits: after the decimal point.
        extremes: print the least and the greatest beside mean and standard deviation.
    """

    name: str
    title: str
    digits: int = 2
    extremes: bool = False

    def text(self, value: str | Spread) -> str:
        """Return a summary's entry as it is printed."""
        if isinstance(value, str):
            return value
        if value.mean is None or value.std is None:
            return "–"
        text = f"{value.mean:.{self.digits}f} ± {value.std:.{self.digits}f}"
        if self.extremes:
            text += f" ({value.least:g}–{value.greatest:g})"
        return text


def summarise(rows: Sequence[Row], by: Sequence[str]) -> list[dict[str, str | Spread]]:
    """Return one summary for each combination of the texts in some columns, in order of appearance.

    Args:
        rows: all with the same columns.
        by: columns of text; of the others those of numbers or None are summarised, and what is text
            in all rows, as the name of a repetition, is left out.

    Raises:
        ValueError: rows of different columns, a number that is not finite, or text among numbers.
    """
    groups: dict[tuple[str, ...], list[Row]] = {}
    for index, row in enumerate(rows):
        if row.keys() != rows[0].keys():
            raise ValueError(
                f"rows must have the same columns: rows[{index}] has {sorted(row)}, "
                f"rows[0] has {sorted(rows[0])}"
            )
        groups.setdefault(tuple(str(row[name]) for name in by), []).append(row)
    texts = {name for name in rows[0] if all(isinstance(row[name], str) for row in rows)}
    summaries = []
    for key, members in groups.items():
        summary: dict[str, str | Spread] = dict(zip(by, key, strict=True))
        for name in members[0]:
            if name not in by and name not in texts:
                summary[name] = Spread.of([_number(name, row[name]) for row in members])
        summaries.append(summary)
    return summaries


def _number(name: str, value: str | float | None) -> float | None:
    if isinstance(value, str) or (value is not None and not math.isfinite(value)):
        raise ValueError(f"{name} must be a finite number or None, got {value!r}")
    return value


def print_table(
    console: Console, summaries: Sequence[Summary], columns: Sequence[Column], title: str = ""
) -> None:
    """Print summaries as a table, whole even where the terminal is narrower than it."""
    table = Table(title=title or None, title_justify="left")
    for column in columns:
        table.add_column(column.title, no_wrap=True)
    for summary in summaries:
        table.add_row(*(column.text(summary[column.name]) for column in columns))
    Console(file=console.file, width=_WIDEST).print(table)


def write_tables(
    rows: Sequence[Row],
    summaries: Sequence[Summary],
    columns: Sequence[Column],
    out: Path,
    name: str,
    note: str = "",
) -> None:
    """Write `name`.csv (all rows), `name`.json and `name`.md (their summaries) into a folder.

    Args:
        rows: at least one.
        summaries: of the rows.
        columns: of the Markdown table.
        out: folder, made if there is none.
        name: of the files, without suffix.
        note: text below the Markdown table.
    """
    out.mkdir(parents=True, exist_ok=True)
    header = list(rows[0])
    write_table(out / f"{name}.csv", header, ([row[key] for key in header] for row in rows))
    plain = [
        {key: asdict(value) if isinstance(value, Spread) else value for key, value in s.items()}
        for s in summaries
    ]
    write_text(out / f"{name}.json", json.dumps(plain, indent=1) + "\n")
    texts = [[column.text(summary[column.name]) for column in columns] for summary in summaries]
    parts = [markdown_table([[column.title for column in columns], *texts]), note]
    write_text(out / f"{name}.md", "\n\n".join(part for part in parts if part) + "\n")


def report(
    rows: Sequence[Row],
    by: Sequence[str],
    columns: Sequence[Column],
    out: Path,
    name: str,
    note: str = "",
    title: str = "",
) -> list[dict[str, str | Spread]]:
    """Summarise rows, print the summaries, write all of it by `write_tables`, and return them.

    Args:
        rows: at least one.
        by: columns of text, by which rows are taken together.
        columns: of the table.
        out: folder, made if there is none.
        name: of the files, without suffix.
        note: text below the table.
        title: above the printed table.

    Raises:
        ValueError: as `summarise`.
    """
    console = Console()
    summaries = summarise(rows, by)
    print_table(console, summaries, columns, title)
    if note:
        console.print(note)
    write_tables(rows, summaries, columns, out, name, note)
    console.print(f"wrote {name}.csv, .json and .md to {out}", soft_wrap=True, markup=False)
    return summaries
