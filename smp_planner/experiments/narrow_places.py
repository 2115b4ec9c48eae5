"""Starts and goals in narrow places, in the manner of MotionBenchMaker's families.

Chamzas et al. 2022 (MotionBenchMaker) place an arm before shelves, a cage, a table, a box and a
kitchen whose parts are displaced at random. The families here are of that kind, with bodies of our
own. Nothing is chosen by whether it can be solved: the first free postures with the tool in two
places are start and goal.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from smp_gym.arrays import FloatArray
from smp_gym.scene import Obstacle
from smp_planner.benchmark.markdown_table import markdown_table
from smp_planner.benchmark.statistics import rate_interval
from smp_planner.collision.edge_check import EdgeChecker
from smp_planner.experiments.kept_results import kept_results
from smp_planner.experiments.public_arms import PUBLIC_ARMS, swings
from smp_planner.library.smp import SMP, Robot
from smp_planner.planners.rrt_connect.tree_search import rrt_connect
from smp_planner.planning.postures import reaching
from smp_planner.planning.tool_goals import GoalRegion

__all__ = [
    "FAMILIES",
    "METHODS",
    "NarrowPlace",
    "narrow_markdown",
    "narrow_place",
    "narrow_table",
    "solve_narrow_places",
]

_OVERSHOOT = 0.02
"""m, of the spheres that both planners see."""

_POSTURES = 100
"""Postures that are tried for a start or a goal at once."""

_ROUNDS = 20
"""Times that so many postures are tried, at most."""

_ITERATIONS = 20_000
"""Of RRT-Connect."""

_ALL = "all"
"""Family in the row of all families."""

METHODS = ("rrt_connect", "smp", "cpromp", "prompt_o", "promp_diff", "promp")
"""A single search on the same spheres and pairs, and the methods of `SMP.adapt` as they are."""

_TITLES = {
    "bookshelf_thin": "bookshelf, thin",
    "bookshelf_tall": "bookshelf, tall",
    "table_under": "under a table",
    "table_pick": "pick on a table",
    "jaco": "Jaco",
    "ur5": "UR5",
    "kuka_iiwa": "KUKA iiwa",
    "panda": "Panda",
}
"""Families and arms as they are printed, where that is otherwise than they are called."""

Regions = tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Lower and upper corners, m, between which the tool is at the start and at the goal."""


@dataclass(frozen=True)
class NarrowPlace:
    """A start and a goal among obstacles.

    Attributes:
        obstacles: in the frame of the arm's root link.
        start: (n,) rad, free.
        goal: (n,) rad, free.
    """

    obstacles: tuple[Obstacle, ...]
    start: FloatArray
    goal: FloatArray


def _box(lower: Sequence[float], upper: Sequence[float]) -> Obstacle:
    low, high = np.array(lower), np.array(upper)
    middle, half = (low + high) / 2, (high - low) / 2
    return Obstacle(shape="box", position=tuple(middle.tolist()), size=tuple(half.tolist()))


def _within(lower: Sequence[float], upper: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    return np.array(lower, np.float64), np.array(upper, np.float64)


_ABOVE = _within((0.25, -0.3, 0.6), (0.5, 0.3, 0.9))
"""m, before the arm and above what stands there."""


def _shelf(
    rng: np.random.Generator, heights: Sequence[float], half_width: float
) -> tuple[list[Obstacle], list[tuple[FloatArray, FloatArray]]]:
    """Return boards, sides and back of a shelf, and the places between its boards."""
    x, y = 0.45 + rng.uniform(-0.05, 0.05), rng.uniform(-0.15, 0.15)
    bodies = [_box((x, y - half_width, z - 0.01), (x + 0.3, y + half_width, z)) for z in heights]
    for side in (-half_width, half_width):
        lower, upper = (x, y + side - 0.01, heights[0]), (x + 0.3, y + side + 0.01, heights[-1])
        bodies.append(_box(lower, upper))
    bodies.append(
        _box((x + 0.3, y - half_width, heights[0]), (x + 0.32, y + half_width, heights[-1]))
    )
    places = [
        _within(
            (x + 0.02, y - half_width + 0.08, below + 0.08),
            (x + 0.12, y + half_width - 0.08, above - 0.08),
        )
        for below, above in pairwise(heights)
    ]
    return bodies, places


def _bookshelf(
    heights: Sequence[float], half_width: float
) -> Callable[[np.random.Generator], tuple[list[Obstacle], Regions]]:
    def made(rng: np.random.Generator) -> tuple[list[Obstacle], Regions]:
        bodies, places = _shelf(rng, heights, half_width)
        first, second = rng.permutation(len(places))[:2]
        return bodies, (places[first], places[second])

    return made


def _cage(rng: np.random.Generator) -> tuple[list[Obstacle], Regions]:
    x, y = 0.5 + rng.uniform(-0.05, 0.05), rng.uniform(-0.2, 0.2)
    half, top, bar = 0.22, 0.45, 0.012
    bodies = [_box((x - half, y - half, -0.02), (x + half, y + half, 0.0))]
    spots = np.linspace(-half, half, 3)
    for a in spots:
        for b in spots:
            if max(abs(a), abs(b)) == half:
                lower, upper = (x + a - bar, y + b - bar, 0.0), (x + a + bar, y + b + bar, top)
                bodies.append(_box(lower, upper))
    for side in (-half, half):
        for z in (0.2, top):
            bodies.append(
                _box((x + side - bar, y - half, z - bar), (x + side + bar, y + half, z + bar))
            )
            bodies.append(
                _box((x - half, y + side - bar, z - bar), (x + half, y + side + bar, z + bar))
            )
    inside = _within((x - 0.1, y - 0.1, 0.12), (x + 0.1, y + 0.1, 0.3))
    return bodies, (_ABOVE, inside)


def _box_family(rng: np.random.Generator) -> tuple[list[Obstacle], Regions]:
    x, y = 0.5 + rng.uniform(-0.05, 0.05), rng.uniform(-0.2, 0.2)
    half, top, wall = 0.2, 0.3, 0.01
    bodies = [_box((x - half, y - half, -0.02), (x + half, y + half, 0.0))]
    for side in (-half, half):
        bodies.append(_box((x + side - wall, y - half, 0.0), (x + side + wall, y + half, top)))
        bodies.append(_box((x - half, y + side - wall, 0.0), (x + half, y + side + wall, top)))
    return bodies, (_ABOVE, _within((x - 0.08, y - 0.08, 0.12), (x + 0.08, y + 0.08, 0.22)))


def _table(rng: np.random.Generator) -> tuple[list[Obstacle], float, float]:
    x, z = 0.35 + rng.uniform(-0.03, 0.03), 0.42 + rng.uniform(-0.04, 0.04)
    bodies = [_box((x, -0.5, z - 0.02), (x + 0.6, 0.5, z))]
    for far in (x, x + 0.56):
        for side in (-0.5, 0.46):
            bodies.append(_box((far, side, 0.0), (far + 0.04, side + 0.04, z - 0.02)))
    return bodies, x, z


def _table_under(rng: np.random.Generator) -> tuple[list[Obstacle], Regions]:
    bodies, x, z = _table(rng)
    above = _within((x + 0.05, -0.3, z + 0.12), (x + 0.25, 0.3, z + 0.3))
    return bodies, (above, _within((x, -0.3, z - 0.28), (x + 0.15, 0.3, z - 0.14)))


def _table_pick(rng: np.random.Generator) -> tuple[list[Obstacle], Regions]:
    bodies, x, z = _table(rng)
    for side in np.linspace(-0.35, 0.35, 5):
        place = (x + rng.uniform(0.05, 0.3), side + rng.uniform(-0.05, 0.05), z + 0.12)
        bodies.append(Obstacle(shape="cylinder", position=place, size=(0.035, 0.035, 0.12)))
    left, right = (
        _within((x + 0.05, s - 0.1, z + 0.08), (x + 0.25, s + 0.1, z + 0.15)) for s in (0.25, -0.25)
    )
    return bodies, (left, right)


def _kitchen(rng: np.random.Generator) -> tuple[list[Obstacle], Regions]:
    bodies, places = _shelf(rng, (0.65, 0.95), 0.35)
    x, z = 0.4 + rng.uniform(-0.03, 0.03), 0.25 + rng.uniform(-0.03, 0.03)
    # A counter with a sink, whose walls go down to 0.05 m.
    bodies += [
        _box((x, -0.6, z - 0.02), (x + 0.4, -0.2, z)),
        _box((x, 0.2, z - 0.02), (x + 0.4, 0.6, z)),
        _box((x, -0.2, 0.05), (x + 0.02, 0.2, z)),
        _box((x + 0.38, -0.2, 0.05), (x + 0.4, 0.2, z)),
        _box((x, -0.22, 0.05), (x + 0.4, -0.2, z)),
        _box((x, 0.2, 0.05), (x + 0.4, 0.22, z)),
        _box((x, -0.2, 0.03), (x + 0.4, 0.2, 0.05)),
    ]
    sink = _within((x + 0.1, -0.1, 0.17), (x + 0.3, 0.1, z))
    return bodies, (sink, places[0])


FAMILIES: Mapping[str, Callable[[np.random.Generator], tuple[list[Obstacle], Regions]]] = {
    "bookshelf_thin": _bookshelf((0.15, 0.45, 0.75), 0.2),
    "bookshelf_tall": _bookshelf((0.1, 0.4, 0.7, 1.0), 0.35),
    "cage": _cage,
    "box": _box_family,
    "table_under": _table_under,
    "table_pick": _table_pick,
    "kitchen": _kitchen,
}
"""Makers of obstacles and of the places of start and goal, by name."""


def narrow_place(robot: Robot, ready: FloatArray, family: str, seed: int) -> NarrowPlace | None:
    """Return the problem of a seed, or None where no free posture has the tool in its places.

    Args:
        robot: the arm, with pairs of its spheres that must stay clear of each other.
        ready: (n,) rad, beside which and anywhere within the limits postures are sought.
        family: one of `FAMILIES`.
        seed: of bodies and postures.
    """
    rng = np.random.default_rng([list(FAMILIES).index(family), seed])
    obstacles, regions = FAMILIES[family](rng)
    checker = EdgeChecker(robot.model, obstacles)
    ends = []
    for lower, upper in regions:
        region = GoalRegion(np.zeros(3), lower, upper)
        for _ in range(_ROUNDS):
            near = ready + rng.normal(0.0, 0.5, (_POSTURES, robot.dimension))
            # Of endless joints and wide limits one turn says all.
            limits = np.maximum(robot.model.lower, -np.pi), np.minimum(robot.model.upper, np.pi)
            anywhere = rng.uniform(*limits, (_POSTURES, robot.dimension))
            seeds = np.clip(np.concatenate([near, anywhere]), robot.model.lower, robot.model.upper)
            found = reaching((region,), robot.model, seeds, ready, rng)
            free = found[checker.configurations_free(found)] if len(found) else found
            if len(free):
                ends.append(free[0])
                break
        else:
            return None
    return NarrowPlace(tuple(obstacles), *ends)


def _solved(item: tuple[str, str, int, tuple[str, ...]]) -> dict[str, Any]:
    """Return which methods solve the problem of an arm, a family and a seed."""
    arm, family, seed, methods = item
    robot, ready = PUBLIC_ARMS[arm].robot(_OVERSHOOT), np.array(PUBLIC_ARMS[arm].ready)
    # Pairs of spheres that overlap in the posture for which an arm is built are no collision.
    still = swings(ready, ready, np.random.default_rng(0))
    place = narrow_place(SMP.fit(still, robot=robot).robot or robot, ready, family, seed)
    if place is None:
        return {"posed": False}
    drawn = swings(place.start, place.goal, np.random.default_rng(seed))
    demonstrations = np.clip(drawn, robot.model.lower, robot.model.upper)
    primitive = SMP.fit(demonstrations, robot=robot)
    result: dict[str, Any] = {"posed": True}
    for method in methods:
        begin = time.process_time()
        if method == "rrt_connect":
            result[method] = _searched(primitive, place, seed)
        else:
            plan = primitive.adapt(
                place.obstacles, start=place.start, goal=place.goal, seed=seed, method=method
            )
            result[method] = bool(plan.good.any())
        result[f"{method}_seconds"] = time.process_time() - begin
    return result


def _searched(primitive: SMP, place: NarrowPlace, seed: int) -> bool:
    """Return whether a single search finds a path."""
    assert primitive.robot is not None
    checker = EdgeChecker(primitive.robot.model, place.obstacles)
    rng = np.random.default_rng(seed)
    goal = place.goal[None]
    return rrt_connect(place.start, goal, checker, rng, iterations=_ITERATIONS) is not None


def solve_narrow_places(
    arms: Sequence[str],
    families: Sequence[str],
    methods: Sequence[str],
    problems: int,
    out: Path,
    console: Console,
    jobs: int,
) -> dict[str, dict[str, Any]]:
    """Return what solves each problem, by "arm family seed"; those of `out` are not solved again.

    Args:
        arms: of `PUBLIC_ARMS`.
        families: of `FAMILIES`.
        methods: of `METHODS`.
        problems: of each family and arm, with seeds from 0.
        out: JSON file of results.
        console: for the progress.
        jobs: worker processes.
    """
    items = {
        f"{arm} {family} {seed}": (arm, family, seed, tuple(methods))
        for seed in range(problems)
        for arm in arms
        for family in families
    }
    terms = {"overshoot": _OVERSHOOT, "iterations": _ITERATIONS, "methods": list(methods)}
    return kept_results(out, terms, _solved, items, "problems", console, jobs)


def narrow_table(results: Mapping[str, Mapping[str, Any]]) -> Table:
    """Return a row for each arm and family, and one for each arm, with Wilson intervals."""
    table = Table(title="Narrow places: problems that are solved")
    methods = _methods(results)
    for column in ("arm", "family", "posed", *methods):
        table.add_column(column, justify="left" if column in ("arm", "family") else "right")
    for (arm, family), each in _by_family(results).items():
        posed = [r for r in each if r["posed"]]
        shares = [_share([r[method] for r in posed], family == _ALL) for method in methods]
        table.add_row(arm, family, f"{len(posed)} of {len(each)}", *shares)
    return table


def narrow_markdown(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a table in Markdown: families in rows, arms in columns, all methods in each cell."""
    methods, groups = _methods(results), _by_family(results)
    arms, families = (list(dict.fromkeys(names)) for names in zip(*groups, strict=True))
    # The sum of each arm stands behind its families, and below those of all arms.
    families = [*(family for family in families if family != _ALL), _ALL]
    rows = [[" · ".join(methods), *(_TITLES.get(arm, arm) for arm in arms)]]
    for family in families:
        row = [_TITLES.get(family, family)]
        for arm in arms:
            posed = [result for result in groups[arm, family] if result["posed"]]
            counts = [str(sum(result[method] for result in posed)) for method in methods]
            row.append(f"{' · '.join(counts)} of {len(posed)}")
        rows.append(row)
    return markdown_table(rows)


def _methods(results: Mapping[str, Mapping[str, Any]]) -> list[str]:
    return [name for name in METHODS if any(name in result for result in results.values())]


def _by_family(
    results: Mapping[str, Mapping[str, Any]],
) -> dict[tuple[str, str], list[Mapping[str, Any]]]:
    """Return results by arm and family, and behind them all of each arm."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for name, result in results.items():
        arm, family, _ = name.split(" ")
        groups.setdefault((arm, family), []).append(result)
    for arm in dict.fromkeys(arm for arm, _ in groups):
        groups[arm, _ALL] = [r for (of, _), each in groups.items() if of == arm for r in each]
    return groups


def _share(solved: Sequence[bool], interval: bool) -> str:
    count, whole = sum(solved), len(solved)
    if not (interval and whole):
        return f"{count} of {whole}"
    rate = rate_interval(count, whole)
    return f"{count} of {whole} ({100.0 * rate['low']:.0f}–{100.0 * rate['high']:.0f} %)"
