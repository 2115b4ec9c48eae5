"""Charts of a report as SVG, drawn for a width of 340 pixels and coloured by the page's style.

Every chart has a title and a description in words for those who do not see it. Colours are classes
(``m0``, ``m1``, … of the methods), so that a page in light and one in dark have their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from markupsafe import Markup, escape

from smp_planner.benchmark.paired_comparison import SolveTimes
from smp_planner.benchmark.report.findings import LevelRates, MethodFindings, Profiles
from smp_planner.benchmark.statistics import Estimate

__all__ = [
    "MARKS",
    "interval_bar",
    "level_chart",
    "mark",
    "profile_chart",
    "time_chart",
]

MARKS = ("circle", "square", "triangle", "diamond", "fall", "cross", "ring", "box")
"""Marks of the methods, in their order; from the ninth on they come again, in other colours."""

_WIDTH, _HEIGHT = 340.0, 230.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 36.0, 10.0, 12.0, 36.0
_BAR_WIDTH, _BAR_HEIGHT = 104.0, 16.0
_COLOURS = 10
_SIZE = 4.2
_SHORTEST = 1e-3


def _shape(kind: str, x: float, y: float, r: float) -> str:
    """Return a mark around a point."""
    if kind in ("circle", "ring"):
        hollow = ' class="hollow"' if kind == "ring" else ""
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r:.1f}"{hollow}/>'
    corners = {
        "square": [(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)],
        "box": [(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)],
        "triangle": [(0, -1.15), (1.1, 0.85), (-1.1, 0.85)],
        "fall": [(0, 1.15), (1.1, -0.85), (-1.1, -0.85)],
        "diamond": [(0, -1.3), (1.3, 0), (0, 1.3), (-1.3, 0)],
        "cross": [
            (-0.4, -1.2), (0.4, -1.2), (0.4, -0.4), (1.2, -0.4), (1.2, 0.4), (0.4, 0.4),
            (0.4, 1.2), (-0.4, 1.2), (-0.4, 0.4), (-1.2, 0.4), (-1.2, -0.4), (-0.4, -0.4),
        ],
    }[kind]  # fmt: skip
    hollow = ' class="hollow"' if kind == "box" else ""
    points = " ".join(f"{x + r * dx:.1f},{y + r * dy:.1f}" for dx, dy in corners)
    return f'<polygon points="{points}"{hollow}/>'


def _class(number: int) -> str:
    return f"m{number % _COLOURS}"


def _mark(number: int, x: float, y: float, r: float = _SIZE) -> str:
    return f'<g class="mark {_class(number)}">{_shape(MARKS[number % len(MARKS)], x, y, r)}</g>'


def mark(number: int) -> Markup:
    """Return the mark of a method, as it stands beside its name."""
    return Markup(
        '<svg class="key" width="14" height="14" viewBox="0 0 14 14" aria-hidden="true">'
        f"{_mark(number, 7, 7)}</svg>"
    )


def interval_bar(estimate: Estimate, number: int) -> Markup:
    """Return a rate and its interval on a line from 0 to 100 %, for a cell of a table."""
    pad = 6.0
    span = _BAR_WIDTH - 2 * pad
    value, low, high = (pad + span * estimate[name] for name in ("value", "low", "high"))
    middle = _BAR_HEIGHT / 2
    ticks = "".join(
        f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="2" y2="{_BAR_HEIGHT - 2:.0f}"/>'
        for x in (pad, pad + span / 2, pad + span)
    )
    return Markup(
        f'<svg class="bar" width="{_BAR_WIDTH:.0f}" height="{_BAR_HEIGHT:.0f}" '
        f'viewBox="0 0 {_BAR_WIDTH:.0f} {_BAR_HEIGHT:.0f}" aria-hidden="true">{ticks}'
        f'<line class="whisker {_class(number)}" x1="{low:.1f}" x2="{high:.1f}" '
        f'y1="{middle:.1f}" y2="{middle:.1f}"/>{_mark(number, value, middle)}</svg>'
    )


@dataclass
class _Chart:
    """An SVG that grows: axes first, then what is in them.

    Attributes:
        title: of the chart, read aloud.
        description: what it shows, in words.
        x: first and last value of the horizontal axis.
        y: of the vertical one.
        logarithmic: whether the horizontal axis is.
        parts: of the SVG.
    """

    title: str
    description: str
    x: tuple[float, float]
    y: tuple[float, float]
    logarithmic: bool = False
    parts: list[str] = field(default_factory=list)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Return where a point of the axes is, in pixels; within the frame."""
        (x0, x1), (y0, y1) = self.x, self.y
        if self.logarithmic:
            x, x0, x1 = math.log(max(x, x0)), math.log(x0), math.log(x1)
        across, up = (x - x0) / (x1 - x0), (y - y0) / (y1 - y0)
        return (
            _LEFT + min(max(across, 0.0), 1.0) * (_WIDTH - _LEFT - _RIGHT),
            _HEIGHT - _BOTTOM - min(max(up, 0.0), 1.0) * (_HEIGHT - _TOP - _BOTTOM),
        )

    def text(self, x: float, y: float, words: str, anchor: str = "middle", kind: str = "") -> None:
        """Add a text at pixels."""
        kinds = f' class="{kind}"' if kind else ""
        self.parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{kinds}>{escape(words)}</text>'
        )

    def line(self, kind: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Add a line between points in pixels."""
        self.parts.append(
            f'<line class="{kind}" x1="{start[0]:.1f}" y1="{start[1]:.1f}" x2="{end[0]:.1f}" '
            f'y2="{end[1]:.1f}"/>'
        )

    def percents(self) -> None:
        """Add the grid of a vertical axis from 0 to 100 %."""
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            left, y = self.at(self.x[0], share)
            self.line("axis" if share == 0.0 else "grid", (left, y), (_WIDTH - _RIGHT, y))
            self.text(_LEFT - 6, y + 4, f"{100 * share:.0f}", "end")

    def below(self, words: str) -> None:
        """Add the name of the horizontal axis."""
        middle = (_LEFT + _WIDTH - _RIGHT) / 2
        self.text(middle, _HEIGHT - 4, words, kind="label")

    def tick(self, x: float, words: str) -> None:
        """Add a mark of the horizontal axis with its number."""
        left, y = self.at(x, self.y[0])
        self.line("axis", (left, y), (left, y + 4))
        self.text(left, y + 16, words)

    def path(self, kind: str, points: Sequence[tuple[float, float]], closed: bool = False) -> None:
        """Add a line through points of the axes."""
        moves = " ".join(f"{x:.1f},{y:.1f}" for x, y in (self.at(*point) for point in points))
        shape = "polygon" if closed else "polyline"
        self.parts.append(f'<{shape} class="{kind}" points="{moves}"/>')

    def svg(self) -> Markup:
        """Return the chart."""
        return Markup(
            f'<svg class="chart" role="img" viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}">'
            f"<title>{escape(self.title)}</title><desc>{escape(self.description)}</desc>"
            f"{''.join(self.parts)}</svg>"
        )


def _rate(estimate: Estimate) -> str:
    value, low, high = (100 * estimate[name] for name in ("value", "low", "high"))
    return f"{value:.1f} % ({low:.1f} to {high:.1f})"


def level_chart(level: LevelRates, numbers: Mapping[str, int]) -> Markup:
    """Return success with intervals over the difficulties of a suite.

    Args:
        level: the rates.
        numbers: of the methods, by name; see `MethodFindings`.
    """
    count = len(level.difficulties)
    spoken = [
        f"{method} {', '.join(_spoken(level.difficulties, rates))}"
        for method, rates in level.rates.items()
    ]
    title = f"Success in the suite {level.suite} by difficulty"
    chart = _Chart(title, "; ".join(spoken) + ".", (-0.5, count - 0.5), (0.0, 1.0))
    chart.percents()
    for index, difficulty in enumerate(level.difficulties):
        chart.tick(index, f"{difficulty} (n = {level.episodes[index]})")
    step = min(0.8 / max(len(level.rates), 1), 0.14)
    for place, (method, rates) in enumerate(level.rates.items()):
        number = numbers[method]
        shift = step * (place - (len(level.rates) - 1) / 2)
        known = [(index + shift, rate) for index, rate in enumerate(rates) if rate is not None]
        if len(known) > 1:
            chart.path(f"trend {_class(number)}", [(x, rate["value"]) for x, rate in known])
        for x, rate in known:
            chart.line(
                f"whisker {_class(number)}", chart.at(x, rate["low"]), chart.at(x, rate["high"])
            )
            chart.parts.append(_mark(number, *chart.at(x, rate["value"])))
    chart.below("difficulty (n episodes of each method)")
    return chart.svg()


def _spoken(names: Sequence[str], rates: Sequence[Estimate | None]) -> list[str]:
    return [
        f"{name} {_rate(rate)}" for name, rate in zip(names, rates, strict=True) if rate is not None
    ]


def _round_steps(last: float) -> list[float]:
    """Return round numbers from 0 to a last one at most, four to eight of them."""
    step = 10.0 ** math.floor(math.log10(last))
    step *= next(f for f in (0.1, 0.2, 0.25, 0.5, 1.0, 2.0) if last / (step * f) <= 7.0)
    return [step * k for k in range(int(last / step + 1e-9) + 1)]


def profile_chart(profiles: Profiles, numbers: Mapping[str, int]) -> Markup:
    """Return the share of episodes completed by a time, with bands of 95 %.

    Args:
        profiles: of the methods.
        numbers: of the methods, by name.
    """
    times = [float(time) for time in profiles.times]
    half = len(times) // 2
    spoken = [
        f"{method} {100 * shares['value'][half]:.0f} % by {times[half]:.1f} s and "
        f"{100 * shares['value'][-1]:.0f} % by {times[-1]:.1f} s"
        for method, shares in profiles.shares.items()
    ]
    title = "Share of episodes completed, by the time of planning and motion"
    chart = _Chart(title, "; ".join(spoken) + ".", (0.0, times[-1]), (0.0, 1.0))
    chart.percents()
    for seconds in _round_steps(times[-1]):
        chart.tick(seconds, f"{seconds:g}")
    for method, shares in profiles.shares.items():
        upper = list(zip(times, map(float, shares["high"]), strict=True))
        lower = list(zip(times, map(float, shares["low"]), strict=True))
        chart.path(f"band {_class(numbers[method])}", upper + lower[::-1], closed=True)
    for method, shares in profiles.shares.items():
        points = list(zip(times, map(float, shares["value"]), strict=True))
        chart.path(f"curve {_class(numbers[method])}", points)
        chart.parts.append(_mark(numbers[method], *chart.at(*points[-1])))
    chart.below("planning and motion, s")
    return chart.svg()


def time_chart(methods: Sequence[MethodFindings]) -> Markup:
    """Return success against the time of planning, median to 98th percentile, on a log scale."""
    solves = {method.name: method.solve for method in methods}
    low = min(solve.median for solve in solves.values())
    high = max(solve.p98 for solve in solves.values())
    first, last = _decades(low, high)
    spoken = [f"{m.name} {_rate(m.success)}, planning {_seconds(m.solve)}" for m in methods]
    title = "Success against the time of planning"
    chart = _Chart(title, "; ".join(spoken) + ".", (first, last), (0.0, 1.0), True)
    chart.percents()
    for seconds in _log_steps(first, last):
        chart.tick(seconds, f"{seconds:g}")
    for method in methods:
        kind = f"whisker {_class(method.number)}"
        solve, rate = method.solve, method.success
        chart.line(kind, chart.at(solve.median, rate["low"]), chart.at(solve.median, rate["high"]))
        chart.line(
            f"{kind} thin",
            chart.at(solve.median, rate["value"]),
            chart.at(solve.p98, rate["value"]),
        )
        chart.parts.append(_mark(method.number, *chart.at(solve.median, rate["value"])))
    chart.below("planning, s: median, and a line to the 98th percentile")
    return chart.svg()


def _seconds(solve: SolveTimes) -> str:
    return f"{solve.median:.2f} s in the median and {solve.p98:.2f} s at the 98th percentile"


def _log_steps(first: float, last: float) -> list[float]:
    """Return 1, 2, 5 of each power of ten between two numbers, or the powers alone if many."""
    powers = range(math.floor(math.log10(first)), math.ceil(math.log10(last)) + 1)
    steps = [f * 10.0**p for p in powers for f in (1, 2, 5)]
    within = [step for step in steps if first * 0.999 <= step <= last * 1.001]
    return within if len(within) <= 8 else [10.0**p for p in powers if first <= 10.0**p <= last]


def _decades(low: float, high: float) -> tuple[float, float]:
    """Return the next numbers of 1, 2, 5 and their powers of ten beyond two positive numbers."""
    low = max(low, _SHORTEST)
    high = max(high, 1.5 * low)
    powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    steps = [f * 10.0**p for p in powers for f in (1, 2, 5)]
    return max(s for s in steps if s < low), min(s for s in steps if s > high)
