"""Results on disk: a manifest and an append-only file of rows, so that a run can be continued.

A folder of results holds ``manifest.json`` (what was asked, with which versions),
``episodes.jsonl`` (one line per episode, appended as it ends; a line torn by a crash is dropped),
and, once a run is complete, ``episodes.csv`` and ``summary.json``.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from importlib import metadata, resources
from pathlib import Path
from types import TracebackType
from typing import Any

from smp_gym.datasets.frozen import load_episodes
from smp_gym.scene import FAMILIES
from smp_planner.benchmark.episodes import EpisodeKey, EpisodeRow
from smp_planner.benchmark.row_file import ResultsError, RowFile, read_rows

__all__ = [
    "COLUMNS",
    "EpisodeStore",
    "Manifest",
    "ResultsError",
    "code_digest",
    "read_results",
    "versions",
    "write_atomically",
    "write_csv",
    "write_json",
]

FORMAT_VERSION = 1
"""Version of the layout of a folder of results."""

COLUMNS = tuple(f.name for f in fields(EpisodeRow) if f.name != "stage_times")
"""Columns of ``episodes.csv``; the last two are times and differ from run to run."""

_PACKAGES = ("smp-gym", "gymnasium", "numba", "numpy", "pybullet", "scipy", "torch")
_SOURCES = ("smp_gym", "smp_planner", "envs_assets")
_SOURCE_SUFFIXES = (".py", ".json", ".npz", ".urdf", ".obj", ".safetensors", ".gz")


@dataclass(frozen=True)
class Manifest:
    """What a folder of results answers.

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


def write_atomically(path: Path, text: str) -> None:
    """Write a text file so that a reader sees the old or the new content, never half of it."""
    temporary = path.with_name(path.name + ".tmp")
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)


def write_csv(path: Path, rows: Iterable[EpisodeRow]) -> None:
    """Write rows sorted by task, method, difficulty and seed; columns are `COLUMNS`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in sorted(rows, key=lambda row: row.key):
        writer.writerow([getattr(row, column) for column in COLUMNS])
    write_atomically(path, text.getvalue())


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file of one object; values that are not finite are an error."""
    write_atomically(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def _parse_row(line: str) -> EpisodeRow:
    return EpisodeRow(**json.loads(line))


def _read_manifest(path: Path) -> Manifest:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        version = content.pop("format")
        if version != FORMAT_VERSION:
            raise ValueError(f"format must be {FORMAT_VERSION}, got {version!r}")
        content["tasks"], content["methods"] = tuple(content["tasks"]), tuple(content["methods"])
        return Manifest(**content)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ResultsError(f"{path} is not a manifest of results: {error}") from error


def read_results(folder: Path) -> tuple[Manifest, list[EpisodeRow]]:
    """Return manifest and rows of a folder of results, finished or not.

    Raises:
        ResultsError: no results there, or damaged ones.
    """
    manifest = folder / "manifest.json"
    if not manifest.is_file():
        raise ResultsError(f"{str(folder)!r} holds no results: there is no manifest.json in it")
    return _read_manifest(manifest), read_rows(folder / "episodes.jsonl", _parse_row)[0]


def _differences(there: Manifest, here: Manifest) -> list[str]:
    lines = []
    for name in ("tasks", "methods", "difficulty", "family", "seed", "frozen", "code"):
        old, new = getattr(there, name), getattr(here, name)
        if old != new:
            lines.append(f"{name}: {old!r} there, {new!r} now")
    for package in sorted({*there.versions, *here.versions}):
        old, new = there.versions.get(package), here.versions.get(package)
        if old != new:
            lines.append(f"version of {package}: {old} there, {new} now")
    if here.episodes < there.episodes:
        lines.append(f"episodes: {there.episodes} there, only {here.episodes} now")
    return lines


class EpisodeStore:
    """The results of one folder, open for more rows.

    Args:
        folder: made if it does not exist.
        manifest: what is to be measured. A folder that exists is continued if it was made for the
            same; `Manifest.episodes` may have grown.
        restart: drop the rows of a folder that was made for something else, instead of refusing.

    Raises:
        ResultsError: the folder was made for something else, is damaged, or is in use.
    """

    def __init__(self, folder: Path, manifest: Manifest, *, restart: bool = False) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._file = RowFile(folder / "episodes.jsonl", _parse_row)
        try:
            self._adopt(folder, manifest, restart)
            self.rows = self._file.read()
        except BaseException:
            self._file.close()
            raise
        self.folder = folder

    def _adopt(self, folder: Path, manifest: Manifest, restart: bool) -> None:
        path = folder / "manifest.json"
        if path.exists():
            differences = _differences(_read_manifest(path), manifest)
            if differences and restart:
                self._file.clear()
            elif differences:
                raise ResultsError(
                    f"{str(folder)!r} holds results of other settings and is left as it is; "
                    f"choose another folder, or start anew. {'; '.join(differences)}"
                )
        elif not self._file.empty:
            raise ResultsError(f"{str(folder)!r} holds rows but no manifest.json: damaged")
        content = {"format": FORMAT_VERSION, **asdict(manifest)}
        write_json(path, content)

    def append(self, row: EpisodeRow) -> None:
        """Add one row; it is on disk when this returns."""
        self._file.append(asdict(row))
        self.rows.append(row)

    def missing(self, keys: Iterable[EpisodeKey]) -> list[EpisodeKey]:
        """Return those of `keys` that have no row yet, in their order."""
        present = {row.key for row in self.rows}
        return [key for key in keys if key not in present]

    def close(self) -> None:
        """Close the file and let other runs have the folder."""
        self._file.close()

    def __enter__(self) -> EpisodeStore:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
