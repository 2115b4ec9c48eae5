"""The answer of a report: who succeeds most, what is certain, what is open, and who is quickest."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite

from smp_planner.benchmark.paired_comparison import BETTER, CANNOT_TELL, WORSE, Comparison
from smp_planner.benchmark.report.findings import Findings
from smp_planner.benchmark.statistics import Estimate

__all__ = ["answer", "least_certain", "listed", "number_word", "percent", "points", "title"]

_NAMED = 4
"""Methods that a sentence names with their numbers; of more it says how many."""

_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def answer(findings: Findings) -> tuple[str, ...]:
    """Return three sentences, and a fourth where time tells apart what success does not."""
    if not findings.episodes:
        return (
            f"No episode was played by all of {listed([m.name for m in findings.methods])}, so "
            "their rates are of different scenes.",
            "No difference between them is certain.",
            "Which of them is best cannot be told before they play the same episodes.",
        )
    sentences = _first(findings), _second(findings), _third(findings), _soonest(findings)
    return tuple(sentence for sentence in sentences if sentence)


def _first(findings: Findings) -> str:
    best = [m for m in findings.methods if m.successes == findings.methods[0].successes]
    count = len(findings.episodes)
    estimate = best[0].success
    rate = f"{best[0].successes} of {count} ({percent(estimate)}; 95 % interval {_span(estimate)})"
    where = _where(findings)
    if len(findings.methods) == 1:
        return f"{best[0].name} succeeds in {rate} of its episodes {where}."
    played = f"On the {count} episodes that {_all(len(findings.methods))} played {where}"
    if len(best) == 1:
        return f"{played}, {best[0].name} succeeds most often: in {rate}."
    if len(best) == len(findings.methods):
        return f"{played}, all succeed equally often: in {rate}."
    return f"{played}, {listed([m.name for m in best])} succeed most often: each in {rate}."


def _where(findings: Findings) -> str:
    """Return tasks and difficulties of the episodes, in brackets."""
    played = {episode.cell for episode in findings.episodes}
    cells = [found.cell for found in findings.cells if found.cell in played]
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    difficulties = list(dict.fromkeys(cell.difficulty for cell in cells))
    return f"({listed(tasks)}; {listed(difficulties)})"


def _second(findings: Findings) -> str:
    if len(findings.methods) == 1:
        return "There is no other method to compare it with."
    best = findings.methods[0].name
    better = [each for each in _of_best(findings) if each.verdict == BETTER]
    worse = [each for each in findings.where if each.verdict == WORSE]
    exceptions = listed(
        [f"on {each.name} {each.second} is better, by {_reach(each, -1)}" for each in worse]
    )
    if better:
        named = listed(_first_of([f"{each.second} by {_reach(each)}" for each in better]))
        sentence = f"Compared episode by episode, {best} is better than {named}{_mainly(findings)}"
    else:
        others = findings.methods[1].name if len(findings.methods) == 2 else "another method"
        sentence = f"No difference between {best} and {others} is beyond chance"
        certain = [p.comparison for p in findings.pairs if p.comparison.verdict == BETTER]
        if certain:
            named = listed(
                _first_of([f"{each.first} is better than {each.second}" for each in certain])
            )
            sentence += f", though {named}"
    return f"{sentence}{'; but ' + exceptions if worse else ''}."


def _of_best(findings: Findings) -> list[Comparison]:
    """Return the comparisons of the method of most successes with each other one."""
    best = findings.methods[0].name
    return [pair.comparison for pair in findings.pairs if pair.comparison.first == best]


def _mainly(findings: Findings) -> str:
    """Return the task on which most of the lead of the best method arises, if there is one."""
    better = {each.second for each in _of_best(findings) if each.verdict == BETTER}
    leads: Counter[str] = Counter()
    for each in findings.where:
        if each.second in better:
            leads[each.name] += each.counts.first_only - each.counts.second_only
    if leads and 2 * (lead := leads.most_common(1)[0])[1] > leads.total():
        return f", most of it on {lead[0]}"
    return ""


def _third(findings: Findings) -> str:
    count = len(findings.episodes)
    if len(findings.methods) == 1:
        return "How it compares with others cannot be told from these results."
    open_ = [p.comparison for p in findings.pairs if p.comparison.verdict == CANNOT_TELL]
    least = (
        f"a difference of fewer than {least_certain(len(findings.pairs))} of {count} episodes is "
        "never beyond chance"
    )
    if not open_:
        return f"No two methods are left undecided, but {least}."
    # Those of the best method come first.
    named = [f"{each.first} and {each.second} ({_between(each)})" for each in open_]
    return f"Which is better cannot be told of {'; '.join(_first_of(named))}: {least}."


def _soonest(findings: Findings) -> str:
    """Return who is done soonest of those that may be the best; nothing if that is not certain."""
    open_ = [each.second for each in _of_best(findings) if each.verdict == CANNOT_TELL]
    names = {findings.methods[0].name, *open_}
    done = {m.name: m.completion["value"] for m in findings.methods if m.name in names}
    soonest, *others = sorted(done, key=lambda name: done[name])
    if not others or not all(map(isfinite, done.values())):
        return ""
    for pair in findings.pairs:
        against = {pair.comparison.first, pair.comparison.second}
        if soonest in against and against <= names:
            least = pair.sooner["low"]
            if pair.comparison.first != soonest:
                least = 1.0 - pair.sooner["high"]
            if least <= 0.5:
                return ""
    times = listed([f"{name} after {done[name]:.1f} s" for name in others])
    return (
        f"Of those that may be the best {soonest} is done soonest: typically {done[soonest]:.1f} s "
        f"after it began to plan, {times}."
    )


def least_certain(comparisons: int) -> int:
    """Return how many episodes one method alone must solve, and none the other, to be better.

    It is the least b with 2 · ½^b < 5 % / m, the exact test of the surest of m comparisons.
    """
    needed = 1
    while 2.0 * 0.5**needed >= 0.05 / max(comparisons, 1):
        needed += 1
    return needed


def _reach(comparison: Comparison, sign: int = 1) -> str:
    """Return a difference with its interval, as "12.5 points (3.1 to 24.0)"."""
    value, low, high = _points(comparison, sign)
    return f"{points(value)} points ({points(low)} to {points(high)})"


def _between(comparison: Comparison) -> str:
    value, low, high = _points(comparison, 1)
    return f"{points(value)} points apart, {points(low)} to {points(high)}"


def _points(comparison: Comparison, sign: int) -> tuple[float, float, float]:
    """Return a difference and its interval in percentage points, or of the other less the first."""
    value, low, high = (
        100.0 * sign * comparison.difference[name] for name in ("value", "low", "high")
    )
    return value, min(low, high), max(low, high)


def _first_of(named: Sequence[str]) -> list[str]:
    """Return the first of names, and how many more there are."""
    more = len(named) - _NAMED
    return [*named[:_NAMED], *([f"{number_word(more)} more"] if more > 0 else [])]


def _all(count: int) -> str:
    return "both methods" if count == 2 else f"all {number_word(count)} methods"


def _span(estimate: Estimate) -> str:
    return f"{100.0 * estimate['low']:.1f}–{100.0 * estimate['high']:.1f}"


def percent(estimate: Estimate) -> str:
    """Return a rate in percent with one decimal."""
    return f"{100.0 * estimate['value']:.1f} %"


def points(value: float) -> str:
    """Return percentage points with one decimal and a true minus."""
    return f"{value:.1f}".replace("-0.0", "0.0").replace("-", "−")


def number_word(number: int) -> str:
    """Return a number up to ten as a word, others in figures."""
    return _NUMBERS[number] if number < len(_NUMBERS) else str(number)


def listed(names: Sequence[str]) -> str:
    """Return names as they stand in a sentence."""
    if not names:
        return ""
    *before, end = names
    return f"{', '.join(before)} and {end}" if before else end


def title(findings: Findings) -> str:
    """Return what the report is of, in a few words."""
    methods = [method.name for method in findings.methods]
    tasks = {found.cell.task for found in findings.cells}
    number = f"{number_word(len(methods))} method{'s' if len(methods) > 1 else ''}"
    where = f"{number_word(len(tasks))} task{'s' if len(tasks) > 1 else ''}"
    return f"{number} on {where}".capitalize()
