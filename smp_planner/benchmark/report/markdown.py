"""The tables of a report in Markdown, as a README has them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from smp_planner.benchmark.report.answer import answer, percent, points
from smp_planner.benchmark.report.findings import Findings, cell_title
from smp_planner.benchmark.report.page import base, origin, span
from smp_planner.benchmark.statistics import Estimate

__all__ = ["markdown"]


def markdown(findings: Findings) -> str:
    """Return answer, success by cell, methods with their times, pairs, and where it is from."""
    parts = [
        " ".join(answer(findings)),
        "\n".join(findings.cautions),
        f"Success, of n episodes of each method, with 95 % Wilson intervals:\n\n{_cells(findings)}",
        f"Methods, {base(findings)}; times in s:\n\n{_methods(findings)}",
        _pairs(findings),
        _trainings(findings),
        _sources(findings),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> str:
    """Return a table of which the first columns are words and the others numbers."""
    lines = [header, [":---"] * words + ["---:"] * (len(header) - words), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cells(findings: Findings) -> str:
    names = [method.name for method in findings.methods]
    rows = []
    for found in findings.cells:
        rates = {r.method: f"{r.successes} ({span(r.success)} %)" for r in found.rates}
        counts = [rates.get(name, "–") for name in names]
        rows.append([cell_title(found.cell), str(found.episodes), *counts])
    return _table(["", "n", *names], rows)


def _methods(findings: Findings) -> str:
    rows = [
        [
            m.name,
            f"{m.successes} of {m.success['count']}",
            _rate(m.success),
            "–" if m.good is None else f"{100 * m.good['value']:.1f}",
            f"{m.solve.median:.2f} / {m.solve.p75:.2f} / {m.solve.p98:.2f}",
            "–" if m.motion is None else f"{m.motion['value']:.1f}",
            ", ".join(f"{cause} {times}" for cause, times in m.causes.items()) or "–",
        ]
        for m in findings.methods
    ]
    header = [
        "",
        "successes",
        "rate",
        "good, %",
        "planning: median / 75th / 98th",
        "motion",
        "failures",
    ]
    return _table(header, rows)


def _pairs(findings: Findings) -> str:
    if not findings.pairs:
        return ""
    rows = []
    for pair in findings.pairs:
        c = pair.comparison
        value, low, high = (points(100 * c.difference[name]) for name in ("value", "low", "high"))
        alone = f"{c.counts.first_only} : {c.counts.second_only}"
        rows.append([c.first, c.second, alone, f"{value} ({low} to {high})", c.verdict])
    header = ["first", "second", "only one solves", "difference, points", "the first is"]
    note = (
        f"Differences, {base(findings)}, with Newcombe’s intervals for pairs; verdicts of the "
        "exact test of McNemar, corrected by Holm’s method:"
    )
    return f"{note}\n\n{_table(header, rows, 2)}"


def _trainings(findings: Findings) -> str:
    if not findings.trainings:
        return ""
    rows = []
    for each in findings.trainings:
        worst, best = (f"{100 * rate:.1f}" for rate in each.range)
        rows.append([each.agent, str(len(each.methods)), worst, best, _rate(each.typical)])
    note = (
        f"Trainings that differ in their seed alone, success in %, {base(findings)}; typically is "
        "the interquartile mean over trainings and cells, with a bootstrap that draws trainings:"
    )
    return f"{note}\n\n{_table(['', 'trainings', 'worst', 'best', 'typically'], rows)}"


def _sources(findings: Findings) -> str:
    lines = []
    for source in findings.sources:
        manifest = source.manifest
        lines.append(f"{source.name}: {origin(manifest)}, code `{manifest.code}`")
    return f"From {'; '.join(lines)}."


def _rate(estimate: Estimate) -> str:
    return f"{percent(estimate)} ({span(estimate)})"
