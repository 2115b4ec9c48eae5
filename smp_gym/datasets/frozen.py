"""Frozen episode lists: the episodes that methods are compared on, stored as scenes.

The list of a task and a difficulty is a gzipped text file of the packaged data: a header and then
one episode a line, all JSON. Half of the episodes were sampled around a witness (see
`smp_gym.sampling`), half were placed without one and certified by a planner; they alternate,
so that the first 2 n episodes hold n of each.
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

from smp_gym.assets import asset_path
from smp_gym.scene import Scene

__all__ = [
    "HALVES",
    "FrozenEpisode",
    "FrozenEpisodes",
    "frozen_lists",
    "load_episodes",
    "read_header",
    "write_episodes",
]

HALVES = ("witness", "certified")
"""Halves of a list: episodes sampled around a witness, or placed without one and certified."""

_FORMAT = "smp_gym.episodes"
_FORMAT_VERSION = 1
_FOLDER = "benchmark"
_SUFFIX = ".jsonl.gz"


@dataclass(frozen=True)
class FrozenEpisode:
    """One episode of a list.

    Attributes:
        half: one of `HALVES`.
        seed: from which the scene was drawn in its half; names the episode there.
        scene: what is played.
    """

    half: str
    seed: int
    scene: Scene

    def __post_init__(self) -> None:
        if self.half not in HALVES:
            raise ValueError(f"half must be one of {', '.join(HALVES)}; got {self.half!r}")


def frozen_lists() -> tuple[tuple[str, str], ...]:
    """Return task and difficulty of every list there is."""
    files = asset_path(_FOLDER).glob(f"*{_SUFFIX}")
    names = [path.name.removesuffix(_SUFFIX).rpartition("_") for path in files]
    return tuple(sorted((task, difficulty) for task, _, difficulty in names))


def _path(task: str, difficulty: str) -> Path:
    path = asset_path(_FOLDER, f"{task}_{difficulty}{_SUFFIX}")
    if (task, difficulty) not in frozen_lists():
        there = ", ".join(" ".join(names) for names in frozen_lists())
        raise ValueError(
            f"there is no frozen list of task {task!r} and difficulty {difficulty!r}; there are: "
            f"{there or 'none'}"
        )
    return path


def _read(path: Path) -> tuple[dict[str, Any], list[str]]:
    try:
        header, *lines = gzip.decompress(path.read_bytes()).decode("utf-8").splitlines()
        content = dict(json.loads(header))
        if (content["format"], content["version"]) != (_FORMAT, _FORMAT_VERSION):
            raise ValueError(f"format must be {_FORMAT} {_FORMAT_VERSION}, got {header[:80]}")
        if content["episodes"] != len(lines):
            raise ValueError(f"{content['episodes']} episodes announced, {len(lines)} there")
    except (OSError, EOFError, ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{path} is not a list of episodes: {error}") from error
    return content, lines


def read_header(task: str, difficulty: str) -> dict[str, Any]:
    """Return the header of a list: how it was made, and with which versions.

    Raises:
        ValueError: there is no such list, or it is damaged.
    """
    return _read(_path(task, difficulty))[0]


@lru_cache(maxsize=16)
def load_episodes(task: str, difficulty: str) -> tuple[FrozenEpisode, ...]:
    """Return the list of a task and a difficulty.

    Raises:
        ValueError: there is no such list, or it is damaged.
    """
    path = _path(task, difficulty)
    _, lines = _read(path)
    episodes = []
    for number, line in enumerate(lines, start=2):
        try:
            entry = json.loads(line)
            scene = Scene.model_validate(entry["scene"])
            if (scene.task, scene.difficulty) != (task, difficulty):
                raise ValueError(f"scene of {scene.task}, {scene.difficulty}")
            episodes.append(FrozenEpisode(entry["half"], int(entry["seed"]), scene))
        except (ValueError, TypeError, KeyError) as error:
            raise ValueError(f"{path}, line {number}, is not an episode: {error}") from error
    return tuple(episodes)


def write_episodes(
    path: Path, header: Mapping[str, Any], episodes: Sequence[FrozenEpisode]
) -> None:
    """Write a list; equal content gives equal bytes.

    Args:
        path: of the file.
        header: how the list was made; format and number of episodes are added.
        episodes: in the order in which they are played.
    """
    about = {
        "format": _FORMAT,
        "version": _FORMAT_VERSION,
        **header,
        "episodes": len(episodes),
    }
    lines = [json.dumps(about, allow_nan=False)]
    for episode in episodes:
        scene = json.loads(episode.scene.to_json())
        entry = {"half": episode.half, "seed": episode.seed, "scene": scene}
        lines.append(json.dumps(entry, separators=(",", ":"), allow_nan=False))
    text = "\n".join(lines) + "\n"
    path.write_bytes(gzip.compress(text.encode("utf-8"), mtime=0))


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
