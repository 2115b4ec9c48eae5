"""Manifest of a benchmark run: its episodes and methods, and the versions that it ran under."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from smp_gym.datasets.frozen import load_episodes
from smp_gym.suites import Cell
from smp_planner.benchmark.episodes import EpisodeKey, EpisodeRow, PlayMethods
from smp_planner.benchmark.methods import resolve_method
from smp_planner.benchmark.results_folder import ResultsFolder, ResultsKind, read_folder
from smp_planner.benchmark.row_table import RowTable, checked
from smp_planner.policy.replanned_execution import LATENCY

__all__ = [
    "EpisodeStore",
    "Manifest",
    "code_digest",
    "make_manifest",
    "read_results",
    "versions",
]

_PACKAGES = ("smp-gym", "gymnasium", "numba", "numpy", "pybullet", "scipy", "torch")
_SOURCES = ("smp_gym", "smp_planner", "envs_assets")
# What is derived from results and data decides no row.
_DERIVED = ("results/", "croissant.json")
_SOURCE_SUFFIXES = (".py", ".json", ".npz", ".urdf", ".obj", ".safetensors", ".gz")


@dataclass(frozen=True)
class Manifest:
    """Description of a folder of results.

    Attributes:
        cells: what is played; see `smp_gym.suites`.
        methods: names of the methods.
        seed: of the first episode; episode k has seed + k.
        episodes: how many for each cell and method; the only entry that may grow later.
        versions: of Python and of the packages that decide the rows.
        code: digest of the source and data files of this project.
        frozen: whether the episodes are the first of the frozen lists, instead of being drawn from
            seeds; `seed` is then 0.
        suite: whose cells these are; empty if they were named one by one.
        lists: folder of the frozen lists; empty for that of the package.
        specs: of the methods by name; see `smp_planner.benchmark.methods.resolve_method`.
        replan_every: control steps after which plans are made anew at the latest; 0 where methods
            plan once.
        latency: control steps from asking for a plan to its taking effect; 0 where methods plan
            once.
        method_codes: digests of the source files of the methods, wherever they live, or of an
            agent's zip, by name.
    """

    cells: tuple[Cell, ...]
    methods: tuple[str, ...]
    seed: int
    episodes: int
    versions: Mapping[str, str]
    code: str
    frozen: bool = False
    suite: str = ""
    lists: str = ""
    specs: Mapping[str, str] = field(default_factory=dict)
    method_codes: Mapping[str, str] = field(default_factory=dict)
    replan_every: int = 0
    latency: int = 0

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Manifest:
        """Return the manifest that `to_json` gave.

        Raises:
            KeyError, TypeError, ValueError: entries are missing, not known, or of other types.
        """
        listed = {**content, "cells": list(content["cells"].values())}
        manifest: Manifest = checked(cls, json.dumps(listed))
        if json.loads(json.dumps(manifest.to_json())) != content:
            raise ValueError("entries are missing or not known, or cells have other names")
        return manifest

    def to_json(self) -> dict[str, Any]:
        """Return the manifest as JSON holds it, the cells by their names."""
        content = {each.name: getattr(self, each.name) for each in fields(self)}
        return {**content, "cells": {cell.name: asdict(cell) for cell in self.cells}}

    @property
    def player(self) -> PlayMethods:
        """Player of the episodes."""
        if not self.replan_every:
            return PlayMethods(self.specs, self.lists_folder)
        return PlayMethods(self.specs, self.lists_folder, self.replan_every, self.latency)

    @property
    def lists_folder(self) -> Path | None:
        """Folder of the frozen lists; None for that of the package."""
        return Path(self.lists) if self.lists else None

    def _names(self, cell: Cell) -> list[tuple[int, str]]:
        """Return seed and half of the episodes of a cell."""
        if self.frozen:
            episodes = load_episodes(cell, self.lists_folder)[: self.episodes]
            return [(episode.seed, episode.half) for episode in episodes]
        return [(self.seed + k, "") for k in range(self.episodes)]

    def episode_keys(self) -> list[EpisodeKey]:
        """Return all episodes, in the order in which they are played: one of each in turn."""
        names = [self._names(cell) for cell in self.cells]
        return [
            EpisodeKey.of(cell, method, seed, half)
            for together in zip(*names, strict=True)
            for cell, (seed, half) in zip(self.cells, together, strict=True)
            for method in self.methods
        ]

    def first_keys(self) -> list[EpisodeKey]:
        """Return the first episode of each cell and method."""
        return self.episode_keys()[: len(self.cells) * len(self.methods)]


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
    """Return a digest of all source and data files of the three packages.

    The leaderboard and the data card, derived from other files, are left out.
    """
    digest = hashlib.sha256()
    for package in _SOURCES:
        root = Path(str(resources.files(package)))
        for path in sorted(root.rglob("*")):
            name = path.relative_to(root).as_posix()
            if name.startswith(_DERIVED):
                continue
            if path.suffix in _SOURCE_SUFFIXES and path.is_file():
                digest.update(f"{package}/{name}\0".encode())
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def make_manifest(
    cells: Sequence[Cell],
    methods: Sequence[str],
    seed: int,
    episodes: int,
    *,
    frozen: bool = False,
    suite: str = "",
    lists: Path | None = None,
    replan_every: int | None = None,
    latency: int = LATENCY,
) -> Manifest:
    """Return the manifest of a run with the versions that are installed.

    Args:
        cells: what is played.
        methods: by their specs; the modules of planners are imported, the zips of agents loaded.
        seed: of the first episode; 0 with `frozen`.
        episodes: of each cell and method.
        frozen: play the first episodes of the frozen lists.
        suite: whose cells these are, if it was named.
        lists: folder of the frozen lists; by default that of the package.
        replan_every: control steps after which plans are made anew at the latest; None plans once.
        latency: control steps from asking for a plan to its taking effect.

    Raises:
        ValueError: a name that does not exist or is given twice, a cell without a list, or a number
            out of range; the message names the value and what exists.
    """
    resolved = [resolve_method(spec) for spec in methods]
    names = {"cell": [c.name for c in cells], "method": [m.name for m in resolved]}
    for kind, given in names.items():
        if not given or len(set(given)) < len(given):
            raise ValueError(f"name each {kind} once and at least one, got {', '.join(given)!r}")
    if episodes < 1:
        raise ValueError(f"episodes must be at least 1, got {episodes}")
    for method in resolved:
        method.check(cells, replan_every, latency)
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    if frozen:
        if seed:
            raise ValueError(f"frozen lists have seeds of their own: seed must be 0, got {seed}")
        least = min(len(load_episodes(cell, lists)) for cell in cells)
        if episodes > least:
            raise ValueError(f"the frozen lists hold {least} episodes, got episodes {episodes}")
    return Manifest(
        tuple(cells),
        tuple(method.name for method in resolved),
        seed,
        episodes,
        versions(),
        code_digest(),
        frozen,
        suite,
        "" if lists is None else str(lists),
        {method.name: method.spec for method in resolved},
        {method.name: method.digest for method in resolved},
        replan_every or 0,
        latency if replan_every else 0,
    )


_EPISODES: ResultsKind[Manifest, EpisodeRow] = ResultsKind(
    RowTable("episodes", EpisodeRow, EpisodeKey),
    Manifest.from_json,
    lambda manifest: set(manifest.episode_keys()).__contains__,
)


class EpisodeStore(ResultsFolder[Manifest, EpisodeRow]):
    """The rows of a run of the benchmark, open for more; see `ResultsFolder`.

    Args:
        folder: made if it does not exist.
        manifest: what is to be measured.
        restart: drop the rows of a folder that was made for something else, instead of refusing.
    """

    def __init__(self, folder: Path, manifest: Manifest, *, restart: bool = False) -> None:
        super().__init__(folder, _EPISODES, manifest.to_json(), restart=restart)


def read_results(folder: Path) -> tuple[Manifest, list[EpisodeRow]]:
    """Return manifest and rows of a folder of results, finished or not.

    Raises:
        ResultsError: no results there, or damaged ones.
    """
    return read_folder(folder, _EPISODES)
