"""Counts of what came of many trials, by what was tried, as a printed table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.table import Table

__all__ = ["print_outcomes"]


def print_outcomes(
    console: Console,
    outcomes: Mapping[str, Counter[str]],
    kinds: Sequence[str],
    tried: str,
    title: str,
) -> Counter[str]:
    """Print a row for each thing that was tried and a last one of all, and return that.

    Args:
        console: to print on.
        outcomes: counts by what was tried.
        kinds: of outcomes, the columns.
        tried: name of the first column.
        title: of the table.

    Raises:
        ValueError: an outcome is of another kind.
    """
    total: Counter[str] = sum(outcomes.values(), Counter())
    if unknown := sorted(set(total) - set(kinds)):
        raise ValueError(f"outcomes must be of {', '.join(kinds)}; got {', '.join(unknown)}")
    table = Table(tried, *kinds, title=title)
    for name, counted in sorted(outcomes.items()):
        table.add_row(name, *(str(counted[kind] or "") for kind in kinds))
    table.add_row("all", *(str(total[kind]) for kind in kinds))
    console.print(table)
    return total
