"""A Sphinx extension: the directive ``leaderboard``, tables of what methods have achieved."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from task_tables import markdown

from smp_gym.suites import Cell
from smp_planner.benchmark.leaderboard import (
    FROZEN,
    Entry,
    leaderboard_folder,
    read_leaderboard,
)


def _scenes(entry: Entry) -> str:
    if entry.scenes == FROZEN:
        return f"{entry.suite}, frozen list"
    return f"seeds {entry.scenes.replace('-', '–')}"


def _cell(entry: Entry) -> str:
    cell = Cell(entry.task, entry.difficulty, entry.family, entry.sensing, entry.noise)
    return cell.name.replace("_", ", ")


def lines(entries: Sequence[Entry]) -> list[str]:
    """Return the tables in Markdown, one for each cell and its scenes."""
    text: list[str] = []
    for (cell, scenes), group in groupby(entries, lambda entry: (_cell(entry), _scenes(entry))):
        table: list[Sequence[Any]] = [("Method", "Solved", "Success, %", "Planning, s", "Code")]
        for entry in group:
            again = f", anew every {entry.replan_every}" if entry.replan_every else ""
            rate, low, high = (f"{100 * x:.0f}" for x in (entry.rate, entry.low, entry.high))
            row = (
                f"`{entry.method}`{again}",
                f"{entry.successes} of {entry.n}",
                f"{rate} ({low}–{high})",
                f"{entry.planning_time:.2f}",
                f"`{entry.code[:8]}`",
            )
            table.append(row)
        text += [f"**{cell}**: {scenes}", "", *markdown(table), ""]
    return text


class Leaderboard(Directive):
    """The directive ``leaderboard``."""

    has_content: ClassVar[bool] = False

    def run(self) -> list[nodes.Node]:
        """Return the table, parsed as the Markdown that it is."""
        section = nodes.Element()
        text = lines(read_leaderboard(leaderboard_folder()))
        self.state.nested_parse(StringList(text, source=__file__), self.content_offset, section)
        return section.children


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("leaderboard", Leaderboard)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
