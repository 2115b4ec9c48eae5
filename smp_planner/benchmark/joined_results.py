"""The results of one or several runs together: rows by cell, method and episode, to be compared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from smp_gym.observation import CONTROL_PERIOD
from smp_gym.suites import SUITES, Cell, home_suite
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import Manifest, read_results
from smp_planner.benchmark.results_folder import ResultsError

__all__ = [
    "Episode",
    "JoinedResults",
    "Source",
    "completion_time",
    "join_results",
    "motion_time",
    "suite_of",
]

SINGLE_CELLS = "single cells"
"""Name of the suite of a cell that is in none."""


class Episode(NamedTuple):
    """Identifier of an episode whoever plays it; equal ones are equal scenes.

    Attributes:
        cell: of which the scene is drawn.
        half: of the frozen list that it is from; empty if it is drawn from its seed.
        seed: of the scene.
    """

    cell: Cell
    half: str
    seed: int


@dataclass(frozen=True)
class Source:
    """One folder of results.

    Attributes:
        name: of the folder, as short as tells it from the others.
        manifest: of the run.
        played: how many episodes it holds, of all methods.
        planned: how many it is to hold.
    """

    name: str
    manifest: Manifest
    played: int
    planned: int


@dataclass(frozen=True)
class JoinedResults:
    """The rows of several folders.

    Attributes:
        sources: the folders.
        cells: of all of them, in order of appearance.
        methods: of all of them, in order of appearance. A method that two folders hold of the same
            episodes, or of other settings, is two methods, ``NAME@FOLDER``; so is one that
            `join_results` is to keep apart.
        rows: by method and episode, in the order of the cells and then of seeds.
        origins: number in `sources` of the folder of each row.
    """

    sources: tuple[Source, ...]
    cells: tuple[Cell, ...]
    methods: tuple[str, ...]
    rows: Mapping[str, Mapping[Episode, EpisodeRow]]
    origins: Mapping[str, Mapping[Episode, int]]

    def common(self, methods: Sequence[str] = ()) -> list[Episode]:
        """Return the episodes that some methods have all played, all methods by default."""
        first, *others = [self.rows[method] for method in methods or self.methods]
        return [episode for episode in first if all(episode in rows for rows in others)]

    def source(self, method: str, episode: Episode) -> Source:
        """Return the folder that holds a row."""
        return self.sources[self.origins[method][episode]]

    def cautions(self) -> list[str]:
        """Return what speaks against comparing the folders, a sentence each."""
        found = [
            f"{source.name} is unfinished: {source.played} of {source.planned} episodes."
            for source in self.sources
            if source.played < source.planned
        ]
        manifests = [source.manifest for source in self.sources]
        if len({manifest.code for manifest in manifests}) > 1:
            found.append("Rows of different versions of the code are taken together.")
            if any(not row.scene for rows in self.rows.values() for row in rows.values()):
                found.append(
                    "Not all rows hold their scene: whether equal seeds were equal scenes is not "
                    "known."
                )
        versions = [dict(manifest.versions) for manifest in manifests]
        names = sorted({name for each in versions for name in each})
        if other := [name for name in names if len({each.get(name) for each in versions}) > 1]:
            found.append(f"The folders were written with different versions of {', '.join(other)}.")
        return found


def motion_time(row: EpisodeRow) -> float:
    """Return the time from the first action of an episode to its end, s."""
    return row.steps * CONTROL_PERIOD


def completion_time(row: EpisodeRow) -> float:
    """Return the time of planning and motion of an episode, s; infinite unless it succeeded."""
    return row.planning_time + motion_time(row) if row.success else float("inf")


def suite_of(cell: Cell) -> str:
    """Return the name of the suite that a cell is of; `SINGLE_CELLS` if none has it."""
    own = next((name for name, cells in SUITES.items() if cell in cells), None)
    return own or home_suite(cell) or SINGLE_CELLS


def join_results(folders: Sequence[Path], apart: Collection[str] = ()) -> JoinedResults:
    """Read folders of results, finished or not, and join their rows.

    Args:
        folders: at least one.
        apart: methods that are another one in each folder, whatever the folders hold.

    Raises:
        ResultsError: a folder is given twice or cannot be read, frozen lists are of different
            folders, rows of equal seeds are of different scenes, or there is no row.
    """
    if not folders or len({folder.resolve() for folder in folders}) < len(folders):
        raise ResultsError(f"name each folder once and at least one, got {_listed(folders)}")
    read = [read_results(folder) for folder in folders]
    if not any(rows for _, rows in read):
        raise ResultsError(f"{_listed(folders)} holds no episodes yet")
    if len(lists := {manifest.lists for manifest, _ in read if manifest.frozen}) > 1:
        raise ResultsError(
            "frozen episodes can be joined of one folder of lists only, got "
            f"{', '.join(repr(each or 'that of the package') for each in sorted(lists))}"
        )
    names = _short_names(folders)
    sources = tuple(
        Source(name, manifest, len(rows), len(manifest.episode_keys()))
        for name, (manifest, rows) in zip(names, read, strict=True)
    )
    _check_scenes(zip(names, (rows for _, rows in read), strict=True))
    split = {
        method
        for manifest, _ in read
        for method in manifest.methods
        if method in apart
        or _differs(method, [(m, rows) for m, rows in read if method in m.methods])
    }
    joined: dict[str, dict[Episode, EpisodeRow]] = {}
    origins: dict[str, dict[Episode, int]] = {}
    for number, (name, (manifest, rows)) in enumerate(zip(names, read, strict=True)):
        for method in manifest.methods:
            label = f"{method}@{name}" if method in split else method
            own = {_episode(row): row for row in rows if row.method == method}
            if own:
                joined.setdefault(label, {}).update(own)
                origins.setdefault(label, {}).update(dict.fromkeys(own, number))
    cells = tuple(dict.fromkeys(cell for manifest, _ in read for cell in manifest.cells))
    order = {cell: number for number, cell in enumerate(cells)}
    ordered = {
        label: dict(sorted(rows.items(), key=lambda item: (order[item[0].cell], *item[0][1:])))
        for label, rows in joined.items()
    }
    return JoinedResults(sources, cells, tuple(joined), ordered, origins)


def _episode(row: EpisodeRow) -> Episode:
    return Episode(row.key.cell, row.half, row.seed)


def _check_scenes(read: Iterable[tuple[str, Sequence[EpisodeRow]]]) -> None:
    """Raise ResultsError if an episode is one scene in one row and another in another.

    Args:
        read: names and rows of folders; rows of older versions hold no scene and are passed over.
    """
    seen: dict[Episode, tuple[str, str]] = {}
    for name, rows in read:
        for row in rows:
            if not row.scene:
                continue
            scene, before = seen.setdefault(_episode(row), (row.scene, name))
            if scene != row.scene:
                raise ResultsError(
                    f"episode {row.seed} of {row.key.cell.name} is one scene in {before!r} and "
                    f"another in {name!r}, drawn by different versions of the code: play one of "
                    "them anew"
                )


def _listed(folders: Iterable[Path]) -> str:
    return ", ".join(repr(str(folder)) for folder in folders) or "none"


def _short_names(folders: Sequence[Path]) -> list[str]:
    """Return the last parts of paths, as many as tell them apart."""
    parts = [folder.resolve().parts for folder in folders]
    length = next(
        n for n in range(1, max(map(len, parts)) + 1) if len({p[-n:] for p in parts}) == len(parts)
    )
    return ["/".join(each[-length:]) for each in parts]


def _differs(method: str, read: Sequence[tuple[Manifest, Sequence[EpisodeRow]]]) -> bool:
    """Return whether a method of several folders has to be taken as several methods."""
    settings = {(m.specs.get(method), m.replan_every, m.latency) for m, _ in read}
    played = Counter(_episode(row) for _, rows in read for row in rows if row.method == method)
    return len(settings) > 1 or any(times > 1 for times in played.values())
