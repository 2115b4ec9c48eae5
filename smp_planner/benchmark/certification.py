"""The making of frozen episode lists: scenes drawn seed after seed, kept if any solver solves them.

Half of a list is sampled around witnesses, half placed without one where the task can place. Each
scene meets the `SOLVERS` in order of cost until one has solved it in the physics, so that no method
decides alone what a list holds; what none solves is kept apart. OMPL's searches end by the clock,
all else depends on the seeds alone.
"""

from __future__ import annotations

import platform
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import metadata
from itertools import count as numbers
from itertools import zip_longest
from pathlib import Path
from types import MappingProxyType
from typing import Any

import gymnasium

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.datasets.frozen import (
    HALVES,
    FrozenEpisode,
    list_path,
    read_header,
    write_episodes,
)
from smp_gym.inspection.witness_check import trajectory_solves
from smp_gym.registration import environment_id
from smp_gym.rollout import rollout
from smp_gym.sampling import place_without_witness, sample_with_witness
from smp_gym.scene import EVALUATION_RANGE_START, FAMILIES
from smp_gym.suites import Cell, home_suite
from smp_gym.tasks.registry import task_definition
from smp_planner.benchmark.worker_pool import workers
from smp_planner.planners.ompl_search import ompl_is_installed
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = [
    "ATTEMPTS",
    "REFERENCE",
    "SOLVERS",
    "Candidate",
    "certified",
    "halves_of",
    "make_list",
    "make_lists",
    "solvers",
]

REFERENCE = "reference"
"""Name of the first solver: the feasible reference trajectory (witness), where there is one."""

SOLVERS: Mapping[str, tuple[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "smp": ("smp", {}),
        "rrt_connect": ("rrt_connect", {"iterations": 20_000}),
        "ompl": ("ompl=smp_planner.planners.ompl_search:OMPLPlanner", {"seconds": 60.0}),
    }
)
"""Spec and settings of the other solvers, by name, in order of cost."""

ATTEMPTS = 2
"""Plans that each solver makes of a scene, each with randomness of its own; OMPL makes one."""

MOST_DRAWN = 10
"""Scenes that are drawn at most for each that is required."""

_PACKAGES = ("gymnasium", "numba", "numpy", "pybullet", "scipy", "torch")


@dataclass(frozen=True)
class Candidate:
    """A scene that may become an episode of a list.

    Attributes:
        cell: that it is of.
        half: of the list, one of `smp_gym.datasets.frozen.HALVES`.
        seed: that it is drawn from.
        solvers: names of the solvers that it meets after its reference trajectory.
    """

    cell: Cell
    half: str
    seed: int
    solvers: tuple[str, ...] = tuple(SOLVERS)


def solvers() -> tuple[str, ...]:
    """Return the names of the solvers that are installed; `REFERENCE` is not one of them."""
    return tuple(name for name in SOLVERS if name != "ompl" or ompl_is_installed())


def halves_of(cell: Cell, episodes: int) -> dict[str, int]:
    """Return how many episodes of a cell's list are to come from each half."""
    places = cell.family == FAMILIES[0] and task_definition(cell.task).sampler.place is not None
    placed = episodes // 2 if places else 0
    return {half: n for half, n in zip(HALVES, (episodes - placed, placed), strict=True) if n}


@lru_cache(maxsize=1)
def _env(cell: Cell) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(environment_id(cell.task), **cell.make_arguments())


@lru_cache(maxsize=8)
def _policy(name: str, task: str, attempt: int) -> PlannerPolicy:
    spec, settings = SOLVERS[name]
    return PlannerPolicy.make(spec, task, settings=settings, seed=attempt)


def certified(candidate: Candidate) -> FrozenEpisode:
    """Return the episode of a candidate with the first solver that solved it in the physics."""
    cell, half, seed = candidate.cell, candidate.half, candidate.seed
    if half == HALVES[0]:
        scene, trajectory = sample_with_witness(cell.task, cell.difficulty, seed, cell.family)
        if trajectory_solves(scene, trajectory):
            return FrozenEpisode(half, seed, scene, REFERENCE)
    else:
        scene = place_without_witness(cell.task, cell.difficulty, seed)
    for name in candidate.solvers:
        for attempt in range(1 if name == "ompl" else ATTEMPTS):
            if rollout(_env(cell), _policy(name, cell.task, attempt), scene=scene).success:
                return FrozenEpisode(half, seed, scene, name)
    return FrozenEpisode(half, seed, scene)


@dataclass
class _Half:
    """The episodes of a half, in the order of their seeds."""

    kept: list[FrozenEpisode] = field(default_factory=list)
    unknown: list[FrozenEpisode] = field(default_factory=list)

    def counts(self) -> dict[str, int]:
        kept, unknown = len(self.kept), len(self.unknown)
        return {"drawn": kept + unknown, "kept": kept, "unknown": unknown}


def _half(
    candidates: Iterator[Candidate],
    wanted: int,
    pool: Executor,
    jobs: int,
    on_kept: Callable[[], None],
) -> _Half:
    """Return the first of the candidates, until so many are kept."""
    half = _Half()
    waiting: deque[Future[FrozenEpisode]] = deque()
    while len(half.kept) < wanted:
        if len(half.kept) + len(half.unknown) >= MOST_DRAWN * wanted:
            raise RuntimeError(f"only {len(half.kept)} of {MOST_DRAWN * wanted} scenes were solved")
        # Never many more than are needed: what is not solved takes minutes.
        while len(waiting) < min(2 * jobs, max(jobs, wanted - len(half.kept))):
            waiting.append(pool.submit(certified, next(candidates)))
        episode = waiting.popleft().result()
        if episode.solver:
            half.kept.append(episode)
            on_kept()
        else:
            half.unknown.append(episode)
    for future in waiting:
        future.cancel()
    return half


def make_list(
    path: Path,
    cell: Cell,
    episodes: int,
    pool: Executor,
    jobs: int,
    *,
    seed: int = EVALUATION_RANGE_START,
    on_kept: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Make and write the list of a cell, and return its header.

    Args:
        path: of the file.
        cell: of a suite, sensed exactly.
        episodes: of the list.
        pool: of worker processes.
        jobs: how many those are.
        seed: from which on scenes are drawn, in each half.
        on_kept: called after each episode that is kept.

    Raises:
        RuntimeError: of `MOST_DRAWN` times as many scenes, too few were solved.
    """
    present = solvers()
    halves: dict[str, _Half] = {}
    for name, wanted in halves_of(cell, episodes).items():
        drawn = (Candidate(cell, name, number, present) for number in numbers(seed))
        try:
            halves[name] = _half(drawn, wanted, pool, jobs, on_kept)
        except RuntimeError as error:
            raise RuntimeError(f"{cell.name}, {name} half: {error}") from error
    in_turn = zip_longest(*(half.kept for half in halves.values()))
    kept = [episode for together in in_turn for episode in together if episode is not None]
    unknown = [episode for half in halves.values() for episode in half.unknown]
    solved = Counter(episode.solver for episode in kept)
    header = {
        "suite": home_suite(cell),
        "cell": cell.name,
        "seeds": f"from {seed} on, in each half",
        "first_seed": seed,
        "halves": {name: half.counts() for name, half in halves.items()},
        "solvers": {name: solved[name] for name in (REFERENCE, *present)},
        "solver_settings": {name: dict(SOLVERS[name][1]) for name in present},
        "left_out": [name for name in SOLVERS if name not in present],
        "versions": {
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in _PACKAGES},
            **({"ompl": metadata.version("ompl")} if "ompl" in present else {}),
        },
    }
    write_episodes(path, header, kept, unknown)
    return header


def make_lists(
    out: Path,
    cells: Sequence[Cell],
    episodes: int,
    jobs: int,
    *,
    seed: int = EVALUATION_RANGE_START,
    on_kept: Callable[[int], None] = lambda kept: None,
) -> Iterator[tuple[Cell, dict[str, Any], bool]]:
    """Make and write lists, one after another; those that are there are left as they are.

    Args:
        out: folder of the lists, made if there is none.
        cells: of suites; those that differ in their sensing alone have one list.
        episodes: of each list.
        jobs: worker processes.
        seed: from which on scenes are drawn, in each half.
        on_kept: called with the number of episodes that a list has gained.

    Yields:
        Cell and header of a list, and whether it was made now.

    Raises:
        ValueError: an odd number of episodes, no suite holds a cell, or a file that is there is of
            an older format or other settings.
        RuntimeError: as `make_list`.
    """
    if episodes < 2 or episodes % 2:
        raise ValueError(f"episodes must be even and at least 2, got {episodes}")
    unsensed = list(dict.fromkeys(cell.unsensed for cell in cells))
    paths = {cell: list_path(cell, out) for cell in unsensed}
    there = {cell: read_header(cell, out) for cell in unsensed if paths[cell].is_file()}
    for cell, header in there.items():
        found = header.get("episodes"), header.get("first_seed")
        if found != (episodes, seed):
            raise ValueError(
                f"{paths[cell]} holds {found[0]} episodes from seed {found[1]}, asked are "
                f"{episodes} from {seed}: choose another folder, or remove it"
            )
        on_kept(episodes)
        yield cell, header, False
    with workers(jobs) as pool:
        for cell in unsensed:
            if cell not in there:
                yield (
                    cell,
                    make_list(
                        paths[cell],
                        cell,
                        episodes,
                        pool,
                        jobs,
                        seed=seed,
                        on_kept=lambda: on_kept(1),
                    ),
                    True,
                )
