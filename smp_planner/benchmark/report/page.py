"""The report as one page of HTML that needs nothing else: no script, no font, no network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from smp_gym.scene import DIFFICULTIES, FAMILIES
from smp_gym.tasks.registry import task_definition
from smp_planner.benchmark.manifest import Manifest
from smp_planner.benchmark.report.answer import answer, least_certain, listed, points, title
from smp_planner.benchmark.report.charts import (
    interval_bar,
    level_chart,
    mark,
    profile_chart,
    time_chart,
)
from smp_planner.benchmark.report.findings import CellFindings, Findings, cell_title
from smp_planner.benchmark.report.training_costs import TrainingCost
from smp_planner.benchmark.statistics import Estimate

__all__ = ["Media", "Picture", "base", "origin", "page", "span"]

_HERE = Path(__file__).parent

_METHODS = {
    "smp": "Stein movement primitives: particles of a learned primitive, moved together by "
    "Stein variational inference until they fit the scene.",
    "promp": "A probabilistic movement primitive, conditioned on start and goal, that does not "
    "look at the obstacles.",
    "cpromp": "A Gaussian over the primitive’s weights, fitted to the scene by variational "
    "inference.",
    "cpromp_chance": "The Gaussian over the primitive’s weights that is nearest to it and collides "
    "with a bounded probability.",
    "prompt_o": "Draws of the primitive, each optimised; their mean is that of the new Gaussian.",
    "promp_diff": "The primitive’s mean path carried past the obstacles by a smooth flow.",
    "rrt_connect": "Rapidly exploring random trees from start and goal, their path shortened and "
    "smoothed; it learns nothing from demonstrations.",
    "mp_rl": "Learned by policy search: smooth bumps on the primitive’s mean, which depend on the "
    "obstacles; of 42 proposals the best by the exact check is executed.",
    "mp_rl_physics": "Policy search as that of mp_rl, rewarded by the outcome of episodes alone.",
    "detour": "Policy search as that of mp_rl, without seeing the obstacles.",
    "sac_her": "Soft actor-critic, learned from its own episodes, with goals in hindsight.",
    "sac_demonstrations": "Soft actor-critic, learned from its own episodes and some of smp’s.",
    "cloning": "A network that imitates what smp does.",
    "distilled": "A network that imitates what smp does, also where it is pushed off its path.",
    "random": "Random actions.",
}


@dataclass(frozen=True)
class Picture:
    """A picture or video that stands in a page.

    Attributes:
        method: that played the episode.
        source: the file as a URI of its content.
        width: pixels.
        height: pixels.
        caption: what it shows.
        description: the same for those who do not see it.
    """

    method: str
    source: str
    width: int
    height: int
    caption: str
    description: str


@dataclass(frozen=True)
class Media:
    """Pictures and videos of a report.

    Attributes:
        pictures: of each episode, under its name.
        videos: of successes and failures.
        per_method: how many episodes there are pictures of.
        other_code: whether they were played again by another version of the code than the rows.
    """

    pictures: tuple[tuple[str, tuple[Picture, ...]], ...] = ()
    videos: tuple[Picture, ...] = ()
    per_method: int = 0
    other_code: bool = False


@cache
def _environment() -> Environment:
    return Environment(
        loader=FileSystemLoader(_HERE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def page(
    findings: Findings, media: Media | None = None, training: Sequence[TrainingCost] = ()
) -> str:
    """Return the page.

    Args:
        findings: of the results.
        media: pictures and videos, if there are any.
        training: what training the methods has cost, as far as it is known.
    """
    causes: dict[str, int] = {}
    for method in findings.methods:
        for cause, times in method.causes.items():
            causes[cause] = causes.get(cause, 0) + times
    tasks = list(dict.fromkeys(found.cell.task for found in findings.cells))
    suites = [
        (suite, [found for found in _ordered(findings.cells, tasks) if found.suite == suite])
        for suite in dict.fromkeys(found.suite for found in findings.cells)
    ]
    levels = findings.levels
    template = _environment().get_template("page.html.j2")
    return template.render(
        findings=findings,
        media=media or Media(),
        title=title(findings),
        subtitle=_subtitle(findings),
        answer=[Markup(_unbroken(sentence)) for sentence in answer(findings)],
        base=base(findings),
        causes=sorted(causes, key=lambda cause: -causes[cause]),
        # Of one suite and difficulty, the table of all methods shows the same.
        levels=levels if sum(len(level.difficulties) for level in levels) > 1 else (),
        suites=suites,
        numbers={method.name: method.number for method in findings.methods},
        descriptions=_descriptions(findings),
        tasks=_tasks(findings),
        least=least_certain(len(findings.pairs)),
        training=training,
        style=Markup((_HERE / "page.css").read_text(encoding="utf-8")),
        cell_title=cell_title,
        interval_bar=interval_bar,
        level_chart=level_chart,
        mark=mark,
        number=number,
        origin=origin,
        p_value=p_value,
        profile_chart=profile_chart,
        seconds=seconds,
        span=span,
        time_chart=time_chart,
    )


def _ordered(cells: Sequence[CellFindings], tasks: Sequence[str]) -> list[CellFindings]:
    """Return cells by task, family, sensing and difficulty, the easiest first."""

    def place(found: CellFindings) -> tuple[int, int, str, float, int]:
        cell = found.cell
        return (
            tasks.index(cell.task),
            FAMILIES.index(cell.family),
            cell.sensing,
            cell.noise,
            DIFFICULTIES.index(cell.difficulty),
        )

    return sorted(cells, key=place)


def _unbroken(sentence: str) -> str:
    """Return a sentence, escaped, with spaces that do not break between a number and its unit."""
    text = str(Markup.escape(sentence))
    return text.replace(" %", "\N{NARROW NO-BREAK SPACE}%")


def _subtitle(findings: Findings) -> str:
    rows = sum(findings.played.values())
    names = listed([source.name for source in findings.sources])
    return f"{rows} episodes, judged by the physics engine, from the results in {names}"


def base(findings: Findings) -> str:
    """Return of how many episodes the numbers over all scenes are."""
    if findings.episodes:
        return f"n = {len(findings.episodes)} episodes of each method"
    return "each over its own episodes, which differ"


def _descriptions(findings: Findings) -> list[tuple[str, str]]:
    names = [method.name for method in findings.methods]
    return [(n, _METHODS[base]) for n in names if (base := n.partition("@")[0]) in _METHODS]


def _tasks(findings: Findings) -> list[tuple[str, str]]:
    """Return names of tasks with what their packages say of them."""
    found = []
    for name in dict.fromkeys(found.cell.task for found in findings.cells):
        words = import_module(task_definition(name).package).__doc__ or ""
        line = words.strip().partition("\n")[0].removeprefix(f"{name}: ")
        if line:
            found.append((name, line[0].upper() + line[1:]))
    return found


def number(value: float, digits: int) -> str:
    """Return a number with digits after its point and a true minus."""
    if digits == 1:
        return points(value)
    return f"{value:.{digits}f}".replace("-", "\N{MINUS SIGN}")


def seconds(value: float) -> str:
    """Return a time to completion, s; one that is infinite is never reached."""
    return number(value, 1) if math.isfinite(value) else "never"


def p_value(value: float) -> str:
    """Return a p-value as it is printed."""
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def span(estimate: Estimate) -> str:
    """Return the interval of a rate in percent."""
    return f"{100 * estimate['low']:.1f}–{100 * estimate['high']:.1f}"


def origin(manifest: Manifest) -> str:
    """Return which scenes a run has played."""
    if manifest.frozen:
        return f"first {manifest.episodes} of each frozen list"
    return f"seeds {manifest.seed}–{manifest.seed + manifest.episodes - 1}"
