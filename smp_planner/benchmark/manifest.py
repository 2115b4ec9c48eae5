"""Manifest of a benchmark run: its episodes and methods, and the versions that it ran under."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from smp_gym.datasets.frozen import load_episodes
from smp_gym.sampling import CROWDED
from smp_gym.scene import DIFFICULTIES, FAMILIES, TASKS
from smp_gym.tasks.registry import task_families
from smp_planner.benchmark.episodes import EpisodeKey, EpisodeRow
from smp_planner.benchmark.results_folder import ResultsFolder, read_manifest, read_rows
from smp_planner.planners.registry import resolve

__all__ = [
    "EpisodeStore",
    "Manifest",
    "code_digest",
    "make_manifest",
    "read_results",
    "versions",
]

_ROWS = "episodes.jsonl"

_PACKAGES = ("smp-gym", "gymnasium", "numba", "numpy", "pybullet", "scipy", "torch")
_SOURCES = ("smp_gym", "smp_planner", "envs_assets")
_SOURCE_SUFFIXES = (".py", ".json", ".npz", ".urdf", ".obj", ".safetensors", ".gz")


@dataclass(frozen=True)
class Manifest:
    """Description of a folder of results.

    Attributes:
        tasks: names of the tasks.
        methods: names of the methods.
        difficulty: of all episodes.
        seed: of the first episode; episode k has seed + k.
        episodes: how many for each task and method; the only entry that may grow later.
        versions: of Python and of the packages that decide the rows.
        code: digest of the source and data files of this project.
        frozen: whether the episodes are the first of the frozen lists, instead of being drawn from
            seeds; `seed` is then 0.
        family: of all scenes.
        specs: of the methods by name; see `smp_planner.planners.registry.resolve`.
        method_codes: digests of the source files of the methods, wherever they live, by name.
    """

    tasks: tuple[str, ...]
    methods: tuple[str, ...]
    difficulty: str
    seed: int
    episodes: int
    versions: Mapping[str, str]
    code: str
    frozen: bool = False
    family: str = FAMILIES[0]
    specs: Mapping[str, str] = field(default_factory=dict)
    method_codes: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Manifest:
        """Return the manifest that JSON holds.

        Raises:
            KeyError, TypeError: entries are missing or not known.
        """
        names = {name: tuple(content[name]) for name in ("tasks", "methods")}
        return cls(**{**content, **names})

    def _names(self, task: str) -> list[tuple[int, str]]:
        """Return seed and half of the episodes of a task."""
        if self.frozen:
            episodes = load_episodes(task, self.difficulty)[: self.episodes]
            return [(episode.seed, episode.half) for episode in episodes]
        return [(self.seed + k, "") for k in range(self.episodes)]

    def episode_keys(self) -> list[EpisodeKey]:
        """Return all episodes, in the order in which they are played: one of each in turn."""
        names = [self._names(task) for task in self.tasks]
        return [
            EpisodeKey(task, method, self.difficulty, seed, half, self.family)
            for together in zip(*names, strict=True)
            for task, (seed, half) in zip(self.tasks, together, strict=True)
            for method in self.methods
        ]

    def first_keys(self) -> list[EpisodeKey]:
        """Return the first episode of each task and method."""
        return self.episode_keys()[: len(self.tasks) * len(self.methods)]


def versions() -> dict[str, str]:
    """Return the versions of Python, the processor architecture and the deciding packages."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def code_digest() -> str:
    """Return a digest of all source and data files of the three packages."""
    digest = hashlib.sha256()
    for package in _SOURCES:
        root = Path(str(resources.files(package)))
        for path in sorted(root.rglob("*")):
            if path.suffix in _SOURCE_SUFFIXES and path.is_file():
                digest.update(f"{package}/{path.relative_to(root).as_posix()}\0".encode())
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def make_manifest(
    tasks: Sequence[str],
    methods: Sequence[str],
    difficulty: str,
    seed: int,
    episodes: int,
    *,
    frozen: bool = False,
    family: str = FAMILIES[0],
) -> Manifest:
    """Return the manifest of a run with the versions that are installed.

    Methods are given by their specs, and their modules are imported. With `frozen` the episodes are
    the first ones of the frozen lists, and `seed` must be 0. A `family` needs tasks that have it.

    Raises:
        ValueError: a name that does not exist or is given twice, or a number out of range; the
            message names the value and what exists.
    """
    unknown = [name for name in tasks if name not in TASKS]
    if unknown:
        raise ValueError(f"unknown task {unknown[0]!r}; there are: {', '.join(TASKS)}")
    resolved = [resolve(spec) for spec in methods]
    for kind, names in (("task", tasks), ("method", [method.name for method in resolved])):
        if not names or len(set(names)) < len(names):
            raise ValueError(f"name each {kind} once and at least one, got {', '.join(names)!r}")
    if difficulty not in DIFFICULTIES:
        raise ValueError(f"unknown difficulty {difficulty!r}; there are: {', '.join(DIFFICULTIES)}")
    for task in tasks:
        if family not in task_families(task):
            there = ", ".join(task_families(task))
            raise ValueError(f"unknown family {family!r} of {task}; there are: {there}")
    if family != FAMILIES[0] and difficulty not in CROWDED:
        raise ValueError(
            f"difficulty of family {family} must be one of {', '.join(CROWDED)}; got {difficulty!r}"
        )
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, got {episodes}")
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    if frozen:
        if seed:
            raise ValueError(f"frozen lists have seeds of their own: seed must be 0, got {seed}")
        least = min(len(load_episodes(task, difficulty)) for task in tasks)
        if episodes > least:
            raise ValueError(f"the frozen lists hold {least} episodes, got episodes {episodes}")
    return Manifest(
        tuple(tasks),
        tuple(method.name for method in resolved),
        difficulty,
        seed,
        episodes,
        versions(),
        code_digest(),
        frozen,
        family,
        {method.name: method.spec for method in resolved},
        {method.name: method.digest for method in resolved},
    )


class EpisodeStore(ResultsFolder[EpisodeRow]):
    """The rows of a run of the benchmark, open for more; see `ResultsFolder`.

    Args:
        folder: made if it does not exist.
        manifest: what is to be measured.
        restart: drop the rows of a folder that was made for something else, instead of refusing.
    """

    def __init__(self, folder: Path, manifest: Manifest, *, restart: bool = False) -> None:
        super().__init__(
            folder,
            _ROWS,
            _row,
            asdict(manifest),
            parse_manifest=Manifest.from_json,
            restart=restart,
        )


def _row(content: Mapping[str, Any]) -> EpisodeRow:
    return EpisodeRow(**content)


def read_results(folder: Path) -> tuple[Manifest, list[EpisodeRow]]:
    """Return manifest and rows of a folder of results, finished or not.

    Raises:
        ResultsError: no results there, or damaged ones.
    """
    return read_manifest(folder, Manifest.from_json), read_rows(folder / _ROWS, _row)[0]
