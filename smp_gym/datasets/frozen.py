"""Frozen episode lists: the episodes that methods are compared on, stored as scenes.

The list of a cell of a suite (`smp_gym.suites`) is a gzipped text file: a header and then one
episode a line, all JSON. Where a task can place scenes without a feasible reference trajectory
(witness), half of the episodes were sampled around one and half placed without; they alternate, so
that the first 2 n episodes hold n of each. All were certified: some solver has solved them in the
physics. Those that none has solved follow in the same file, as a list of their own.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium

from smp_gym.arrays import checked_count, shown
from smp_gym.assets import asset_path
from smp_gym.atomic_files import replacing
from smp_gym.scene import Scene
from smp_gym.suites import SUITES, Cell, home_suite
from smp_gym.untrusted_files import LARGEST_TEXT, parse_json, read_file, unzipped

__all__ = [
    "HALVES",
    "FrozenEpisode",
    "FrozenEpisodes",
    "frozen_lists",
    "list_path",
    "load_episodes",
    "load_unknown",
    "read_header",
    "write_episodes",
]

HALVES = ("witness", "placed")
"""Halves of a list: episodes sampled around a witness, or placed without one."""

_FORMAT = "smp_gym.episodes"
_FORMAT_VERSION = 2
_FOLDER = "benchmark"
_SUFFIX = ".jsonl.gz"


@dataclass(frozen=True)
class FrozenEpisode:
    """One episode of a list.

    Attributes:
        half: one of `HALVES`.
        seed: from which the scene was drawn in its half; names the episode there.
        scene: what is played.
        solver: the first that solved it in the physics; empty if none did.
    """

    half: str
    seed: int
    scene: Scene
    solver: str = ""

    def __post_init__(self) -> None:
        if self.half not in HALVES:
            raise ValueError(f"half must be one of {', '.join(HALVES)}; got {self.half!r}")


def _folder(folder: Path | None) -> Path:
    return asset_path(_FOLDER) if folder is None else folder


def list_path(cell: Cell, folder: Path | None = None) -> Path:
    """Return where the list of a cell is, or would be: ``FOLDER/SUITE/CELL.jsonl.gz``.

    Cells that differ in their sensing alone have one list.

    Args:
        cell: of a suite.
        folder: of the lists; by default that of the package.

    Raises:
        ValueError: no suite holds the cell.
    """
    suite = home_suite(cell)
    if suite is None:
        raise ValueError(
            f"there is no frozen list of {cell.name}: no suite holds it; suites are: "
            f"{', '.join(SUITES)}"
        )
    return _folder(folder) / suite / f"{cell.unsensed.name}{_SUFFIX}"


def frozen_lists(folder: Path | None = None) -> tuple[Cell, ...]:
    """Return the cells whose lists there are, sensed exactly.

    Args:
        folder: of the lists; by default that of the package.
    """
    held = (cell for cells in SUITES.values() for cell in cells if cell == cell.unsensed)
    return tuple(cell for cell in held if list_path(cell, folder).is_file())


def _read(cell: Cell, folder: Path | None) -> tuple[Path, dict[str, Any], list[str]]:
    path = list_path(cell, folder)
    if not path.is_file():
        there = ", ".join(each.name for each in frozen_lists(folder))
        raise ValueError(
            f"there is no frozen list of {cell.name}, no file {path}; there are: {there or 'none'}"
        )
    try:
        text = unzipped(read_file(path), "the file", LARGEST_TEXT).decode("utf-8")
        header, *lines = text.splitlines()
        content = parse_json(header, "line 1")
        if not isinstance(content, dict):
            raise ValueError(f"its header must be an object, got {shown(content)}")
        found = (content["format"], content["version"])
        if found != (_FORMAT, _FORMAT_VERSION):
            raise ValueError(
                f"its format is {found[0]} {found[1]}, allowed is {_FORMAT} {_FORMAT_VERSION}; "
                "scripts/make_benchmark.py makes lists"
            )
        announced = tuple(
            checked_count(name, content[name], least=0) for name in ("episodes", "unknown")
        )
        if sum(announced) != len(lines):
            raise ValueError(
                f"{announced[0]} episodes and {announced[1]} unknown announced, {len(lines)} there"
            )
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{path} is not a list of episodes: {error}") from error
    return path, content, lines


def read_header(cell: Cell, folder: Path | None = None) -> dict[str, Any]:
    """Return the header of a cell's list: how it was made, and with which versions.

    Raises:
        ValueError: there is no such list, or it is damaged or of an older format.
    """
    return _read(cell, folder)[1]


@lru_cache(maxsize=64)
def _load(cell: Cell, folder: Path | None) -> tuple[tuple[FrozenEpisode, ...], int]:
    path, header, lines = _read(cell, folder)
    identity = (cell.task, cell.difficulty, cell.family)
    kept = header["episodes"]
    episodes = []
    for number, line in enumerate(lines):
        try:
            entry = parse_json(line, "it")
            scene = Scene.model_validate(entry["scene"])
            if (scene.task, scene.difficulty, scene.family) != identity:
                raise ValueError(f"scene of {scene.task}, {scene.difficulty}, {scene.family}")
            seed = checked_count("seed", entry["seed"], least=0)
            if not isinstance(entry["solver"], str):
                raise ValueError(f"solver must be a name, got {shown(entry['solver'])}")
            episode = FrozenEpisode(entry["half"], seed, scene, entry["solver"])
            if bool(episode.solver) != (number < kept):
                raise ValueError(f"number {number + 1} of {kept}, solved by {episode.solver!r}")
            episodes.append(episode)
        except (ValueError, TypeError, KeyError) as error:
            raise ValueError(f"{path}, line {number + 2}, is not an episode: {error}") from error
    return tuple(episodes), kept


def load_episodes(cell: Cell, folder: Path | None = None) -> tuple[FrozenEpisode, ...]:
    """Return the list of a cell.

    Args:
        cell: of a suite.
        folder: of the lists; by default that of the package.

    Raises:
        ValueError: there is no such list, or it is damaged or of an older format.
    """
    episodes, kept = _load(cell, folder)
    return episodes[:kept]


def load_unknown(cell: Cell, folder: Path | None = None) -> tuple[FrozenEpisode, ...]:
    """Return the episodes that were drawn for a cell's list and that no solver has solved.

    Raises:
        ValueError: as `load_episodes`.
    """
    episodes, kept = _load(cell, folder)
    return episodes[kept:]


def write_episodes(
    path: Path,
    header: Mapping[str, Any],
    episodes: Sequence[FrozenEpisode],
    unknown: Sequence[FrozenEpisode] = (),
) -> None:
    """Write a list, whole or not at all; equal content gives equal bytes.

    Args:
        path: of the file; folders are made if there are none.
        header: how the list was made; format and numbers of episodes are added.
        episodes: in the order in which they are played, each with its solver.
        unknown: episodes without a solver.
    """
    about = {
        "format": _FORMAT,
        "version": _FORMAT_VERSION,
        **header,
        "episodes": len(episodes),
        "unknown": len(unknown),
    }
    lines = [json.dumps(about, allow_nan=False)]
    for episode in (*episodes, *unknown):
        scene = json.loads(episode.scene.to_json())
        entry = {
            "half": episode.half,
            "seed": episode.seed,
            "solver": episode.solver,
            "scene": scene,
        }
        lines.append(json.dumps(entry, separators=(",", ":"), allow_nan=False))
    text = "\n".join(lines) + "\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as aside:
        aside.write_bytes(gzip.compress(text.encode("utf-8"), mtime=0))


class FrozenEpisodes(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Plays the episodes of a list, in order.

    A reset after an episode has ended plays the next one, and after the last the first again. Any
    other reset begins the list anew: so each call of stable-baselines3's `evaluate_policy`, and
    each evaluation of an `EvalCallback`, plays the same episodes.
    ``reset(options={"episode": k})`` plays the k-th of the list. A seed given to `reset` seeds
    ``np_random`` and chooses nothing.

    ``info`` holds ``frozen_episode``, the episode's index in the list, and ``half``.

    To share a list among n environments, give number i ``start=n - 1 - i, stride=n``: as
    `evaluate_policy` deals them out (the last environments play one more where it does not come
    out even), each episode is then played once.

    Args:
        env: what plays them, with its `TimeLimit` inside (as `gymnasium.make` returns it): the
            wrapper must see when an episode is cut off.
        episodes: at least one; for example from `load_episodes`.
        start: index of the first to play.
        stride: how many of the list one reset advances.

    Raises:
        ValueError: no episodes, or `start` or `stride` out of range.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        episodes: Sequence[FrozenEpisode],
        *,
        start: int = 0,
        stride: int = 1,
    ) -> None:
        super().__init__(env)
        self._episodes = tuple(episodes)
        if not self._episodes:
            raise ValueError("episodes must hold at least one, got none")
        if not 0 <= start < len(self._episodes):
            raise ValueError(f"start must be from 0 to {len(self._episodes) - 1}, got {start}")
        if stride < 1:
            raise ValueError(f"stride must be at least 1, got {stride}")
        self._start, self._stride = start, stride
        self._index = start
        self._ended = False

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start the next episode of the list; see the class.

        Raises:
            ValueError: an option is unknown, or the index out of range.
        """
        options = dict(options or {})
        following = self._index + self._stride if self._ended else self._start
        index = options.pop("episode", following % len(self._episodes))
        if options:
            raise ValueError(f"options may hold 'episode' only, got {sorted(map(str, options))}")
        if not (isinstance(index, int) and 0 <= index < len(self._episodes)):
            raise ValueError(
                f"options['episode'] must be from 0 to {len(self._episodes) - 1}, got {index!r}"
            )
        observation, info = self.env.reset(
            seed=seed, options={"scene": self._episodes[index].scene}
        )
        self._index, self._ended = index, False
        return observation, self._labelled(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Advance the episode."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._ended = self._ended or terminated or truncated
        return observation, reward, terminated, truncated, self._labelled(info)

    def _labelled(self, info: Mapping[str, Any]) -> dict[str, Any]:
        half = self._episodes[self._index].half
        return {**info, "frozen_episode": self._index, "half": half}
