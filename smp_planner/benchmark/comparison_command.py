"""The command ``smp-bench compare``: two methods on equal episodes, with a verdict."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from smp_planner.benchmark.joined_results import JoinedResults
    from smp_planner.benchmark.paired_comparison import Comparison, SolveTimes
    from smp_planner.benchmark.statistics import Estimate

__all__ = ["compare"]

_VERDICTS = {"better": "[green]better[/]", "worse": "[red]worse[/]"}


def compare(
    given: Annotated[
        list[str],
        typer.Argument(
            metavar="FOLDER... A B",
            help="Folders that `run` wrote, and the names of two methods in them.",
            show_default=False,
        ),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
) -> None:
    """Compare two methods on the episodes that both have played.

    Prints for each cell, and for tasks, difficulties and suites that take several of them together,
    both rates of success with Wilson intervals, how many episodes only one of the two solves, the
    difference with Newcombe's interval for pairs, and a verdict on A: better, worse or cannot tell.
    The verdict is that of the exact test of McNemar at 5 %, corrected by Holm's method for the
    lines that are judged together.

    A method that two folders hold of the same episodes is asked for as NAME@FOLDER, so that two
    versions of it can be compared.

    Example: [green]smp-bench compare results/tight smp rrt_connect[/green]
    """
    from smp_planner.benchmark.joined_results import join_results
    from smp_planner.benchmark.paired_comparison import compare_methods

    if len(given) < 3:
        raise typer.BadParameter(
            f"needs a folder and two methods at least, got {' '.join(given)!r}",
            param_hint="FOLDER... A B",
        )
    *folders, first, second = given
    results = join_results([Path(folder) for folder in folders])
    comparisons = compare_methods(results, first, second)
    if as_json:
        content = {"cautions": results.cautions(), "comparisons": [asdict(c) for c in comparisons]}
        typer.echo(json.dumps(content, indent=2, allow_nan=False))
        return
    _show(results, comparisons, Console(highlight=False))


def _show(results: JoinedResults, comparisons: Sequence[Comparison], console: Console) -> None:
    first, second = comparisons[0].first, comparisons[0].second
    console.print(_success(comparisons, first, second))
    console.print(_times(comparisons, first, second))
    for caution in results.cautions():
        console.print(caution, style="yellow", soft_wrap=True)


def _table(title: str, caption: str) -> Table:
    # As narrow as can be, and nothing is cut off where that is not narrow enough.
    table = Table(
        title=title,
        caption=caption,
        title_justify="left",
        caption_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    table.add_column("", overflow="fold")
    table.add_column("n", justify="right", overflow="fold")
    return table


def _success(comparisons: Sequence[Comparison], first: str, second: str) -> Table:
    table = _table(
        f"success of {first} and {second} on equal episodes",
        "95 % intervals: Wilson, and Newcombe's for pairs. Verdict on the first: exact\n"
        "test of McNemar at 5 %, corrected by Holm's method for the lines of a section.",
    )
    for title in (
        f"{first}, %",
        f"{second}, %",
        "only one solves",
        "difference, points",
        "verdict",
    ):
        table.add_column(title, justify="right", overflow="fold")
    for each, last in _with_ends(comparisons):
        table.add_row(
            each.name.replace("_", " "),
            str(each.counts.count),
            _percent(each.first_rate),
            _percent(each.second_rate),
            f"{each.counts.first_only} : {each.counts.second_only}",
            _percent(each.difference, "+.0f"),
            {"better": "[green]better[/]", "worse": "[red]worse[/]"}.get(
                each.verdict, each.verdict
            ),
            end_section=last,
        )
    return table


def _times(comparisons: Sequence[Comparison], first: str, second: str) -> Table:
    table = _table(
        "solve time and motion time, s",
        "Solve: median / 75th / 98th percentile over all n. Motion: means over the\n"
        "episodes that both solve, and the difference with its bootstrap interval.",
    )
    for title in (f"{first}: solve", f"{second}: solve", "both solve"):
        table.add_column(title, justify="right", overflow="fold")
    for title in (f"{first}: motion", f"{second}: motion", "difference"):
        table.add_column(title, justify="right", overflow="fold")
    for each, last in _with_ends(comparisons):
        if (times := each.times) is None:
            continue
        motion = ["–"] * 3
        if times.motion is not None:
            motion = [
                f"{times.motion.first:.2f}",
                f"{times.motion.second:.2f}",
                _interval(times.motion.difference, 1.0, "+.2f"),
            ]
        table.add_row(
            each.name.replace("_", " "),
            str(each.counts.count),
            _solve(times.first_solve),
            _solve(times.second_solve),
            str(each.counts.both),
            *motion,
            end_section=last,
        )
    return table


def _with_ends(comparisons: Sequence[Comparison]) -> list[tuple[Comparison, bool]]:
    """Return comparisons, each with whether it is the last of its level."""
    levels = [each.level for each in comparisons]
    return [
        (each, level != following)
        for each, level, following in zip(comparisons, levels, [*levels[1:], None], strict=True)
    ]


def _solve(times: SolveTimes) -> str:
    return " / ".join(f"{seconds:.2f}" for seconds in (times.median, times.p75, times.p98))


def _percent(estimate: Estimate, form: str = ".0f") -> str:
    return _interval(estimate, 100.0, form)


def _interval(estimate: Estimate, scale: float, form: str) -> str:
    value, low, high = (scale * estimate[name] for name in ("value", "low", "high"))
    to = " to " if "+" in form else "–"
    return f"{value:{form}} [dim]({low:{form}}{to}{high:{form}})[/]"
