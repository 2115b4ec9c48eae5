"""The command ``smp-bench compare``: two methods, or one in two runs, on equal episodes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from smp_planner.benchmark.joined_results import JoinedResults
    from smp_planner.benchmark.paired_comparison import Comparison, ReplanTimes, SolveTimes
    from smp_planner.benchmark.statistics import Estimate

__all__ = ["compare"]

_VERDICTS = {"better": "[green]better[/]", "worse": "[red]worse[/]"}

_ARGUMENTS = "FOLDER... A B | RUN RUN METHOD"


def compare(
    given: Annotated[
        list[str],
        typer.Argument(
            metavar=_ARGUMENTS,
            help="Folders that `run` wrote, and the names of two methods in them; or two such "
            "folders, and the name of one method in both.",
            show_default=False,
        ),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the comparison as JSON.")] = False,
) -> None:
    """Compare two methods, or one method in two runs, on the episodes that both have played.

    Prints for each cell, and for tasks, difficulties and suites that take several of them together,
    both rates of success with Wilson intervals, how many episodes only one of the two solves, the
    difference with Newcombe's interval for pairs, and a verdict on A: better, worse or cannot tell.
    The verdict is that of the exact test of McNemar at 5 %, corrected by Holm's method for the
    lines that are judged together. Then come the times of planning and of motion and, where plans
    were made anew, how many, how many of them in vain, and their times.

    One method in two runs, such as planning once and planning anew, two settings or two versions
    of the code, is compared with the first run as A; it is shown as METHOD@RUN. Episodes are pairs
    if cell and seed are equal. Where equal seeds are different scenes, nothing is compared.

    Of more than two folders, a method that several hold of the same episodes is asked for by that
    name, METHOD@RUN, too.

    Example of two methods: [green]smp-bench compare results/tight smp rrt_connect[/green]

    Example of two runs: [green]smp-bench compare results/anew results/once smp[/green]
    """
    from smp_planner.benchmark.paired_comparison import compare_methods

    results, first, second = _read(given)
    comparisons = compare_methods(results, first, second)
    told = [_setting(results, name) for name in (first, second)]
    cautions = [*_unpaired(results, first, second), *results.cautions()]
    if as_json:
        content = {
            "settings": told,
            "cautions": cautions,
            "comparisons": [asdict(c) for c in comparisons],
        }
        typer.echo(json.dumps(content, indent=2, allow_nan=False))
        return
    console = Console(highlight=False)
    _show(comparisons, console)
    if told[0].partition(" ")[2] != told[1].partition(" ")[2]:
        for line in told:
            console.print(escape(line), soft_wrap=True)
    for caution in cautions:
        console.print(escape(caution), style="yellow", soft_wrap=True)


def _read(given: Sequence[str]) -> tuple[JoinedResults, str, str]:
    """Return results, and the names of the two methods in them that are asked for.

    Raises:
        typer.BadParameter: arguments of no form.
        ResultsError: a name is neither a folder nor a method, or see `join_results`.
    """
    from smp_planner.benchmark.joined_results import join_results
    from smp_planner.benchmark.results_folder import ResultsError

    if len(given) < 3:
        raise typer.BadParameter(
            "needs a folder and two methods at least, or two folders and a method, got "
            f"{' '.join(given)!r}",
            param_hint=_ARGUMENTS,
        )
    *folders, first, second = given
    results = join_results([Path(folder) for folder in folders])
    # A folder may have the name of a method: the method is meant then.
    if first in results.methods or not Path(first).is_dir():
        if len(folders) == 1 and first not in results.methods:
            raise ResultsError(
                f"{first!r} is neither a folder nor a method of {folders[0]!r}, which has: "
                f"{', '.join(results.methods)}"
            )
        return results, first, second
    if len(folders) > 1:
        raise typer.BadParameter(
            f"one method is compared in two runs, got {len(folders) + 1} folders and {second!r}",
            param_hint=_ARGUMENTS,
        )
    runs = join_results([Path(folders[0]), Path(first)], apart=(second,))
    one, other = (f"{second}@{source.name}" for source in runs.sources)
    return runs, one, other


def _setting(results: JoinedResults, method: str) -> str:
    """Return a sentence on when a method plans, its name first."""
    settings = set()
    for number in results.origins[method].values():
        manifest = results.sources[number].manifest
        settings.add((manifest.replan_every, manifest.latency))
    said = [
        f"anew every {every} steps at the latest, with a latency of {latency}" if every else "once"
        for every, latency in sorted(settings)
    ]
    return f"{method} plans {' or '.join(said)}."


def _unpaired(results: JoinedResults, first: str, second: str) -> list[str]:
    """Return a sentence on episodes that only one of two methods has played, if there are such."""
    paired = len(results.common((first, second)))
    alone = [len(results.rows[name]) - paired for name in (first, second)]
    if not any(alone):
        return []
    return [
        f"Left out is what only one has played: {alone[0]} episodes of {first}, {alone[1]} of "
        f"{second}."
    ]


def _show(comparisons: Sequence[Comparison], console: Console) -> None:
    first, second = escape(comparisons[0].first), escape(comparisons[0].second)
    console.print(_success(comparisons, first, second))
    console.print(_times(comparisons, first, second))
    times = [each.times for each in comparisons if each.times is not None]
    if any(each.first_replans or each.second_replans for each in times):
        console.print(_replans(comparisons, first, second))


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
            _VERDICTS.get(each.verdict, each.verdict),
            end_section=last,
        )
    return table


def _times(comparisons: Sequence[Comparison], first: str, second: str) -> Table:
    table = _table(
        "solve time and motion time, s",
        "Solve: median / 75th / 98th percentile over all n, and the ratio, in the\n"
        "geometric mean. Motion: means over the episodes that both solve, and the\n"
        "difference. Intervals: bootstrap.",
    )
    for title in (f"{first}: solve", f"{second}: solve", "ratio", "both solve"):
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
            _ratio(times.solve_ratio),
            str(each.counts.both),
            *motion,
            end_section=last,
        )
    return table


def _replans(comparisons: Sequence[Comparison], first: str, second: str) -> Table:
    table = _table(
        "plans made anew, and their times, s",
        "A row for each method that made some. Median of their number in an episode;\n"
        "share of them without a good particle; time of one: median / 75th / 98th\n"
        "percentile over the episodes, and as a share of that of the first plan. Ratios\n"
        "are geometric means with bootstrap intervals.",
    )
    for title in ("method", "an episode", "in vain, %", "time", "of first plan"):
        table.add_column(title, justify="right", overflow="fold")
    compared = any(each.times and each.times.replan_ratio for each in comparisons)
    if compared:
        table.add_column(f"{first} : {second}", justify="right", overflow="fold")
    for each, last in _with_ends(comparisons):
        if (times := each.times) is None:
            continue
        made = [
            (name, replans)
            for name, replans in ((first, times.first_replans), (second, times.second_replans))
            if replans is not None
        ]
        for number, (name, replans) in enumerate(made):
            ratio = [_ratio(times.replan_ratio) if number == 0 else ""] if compared else []
            end = last and number == len(made) - 1
            table.add_row(*_of_replans(each, name, replans), *ratio, end_section=end)
    return table


def _of_replans(each: Comparison, name: str, replans: ReplanTimes) -> list[str]:
    return [
        each.name.replace("_", " "),
        str(each.counts.count),
        name,
        f"{replans.replans:.0f}",
        f"{100 * replans.failed:.0f}",
        f"{replans.median:.2f} / {replans.p75:.2f} / {replans.p98:.2f}",
        _ratio(replans.of_first),
    ]


def _ratio(estimate: Estimate | None) -> str:
    return "–" if estimate is None else _interval(estimate, 1.0, ".2f")


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
