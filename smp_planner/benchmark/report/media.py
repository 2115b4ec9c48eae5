"""Pictures of particle sets and videos of episodes, played again, as they stand in a page."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory

import gymnasium as gym
import imageio.v3 as imageio
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from smp_gym.suites import Cell
from smp_planner.benchmark.episode_pictures import (
    SceneLine,
    carried_point,
    object_paths,
    paint_scene,
    planned_path,
    write_video,
)
from smp_planner.benchmark.episodes import (
    EpisodeKey,
    EpisodeRow,
    PlayedEpisode,
    PlayMethods,
    environment_id,
    play_episode,
)
from smp_planner.benchmark.films import ActionRecorder, film, outcome
from smp_planner.benchmark.joined_results import Episode, JoinedResults
from smp_planner.benchmark.manifest import code_digest
from smp_planner.benchmark.report.findings import Findings, cell_title
from smp_planner.benchmark.report.page import Media, Picture
from smp_planner.benchmark.worker_pool import workers
from smp_planner.planning.plan import Plan

__all__ = ["Shot", "first_episodes", "take", "take_media"]

_CLASSES = ("#2f6db5", "#2e8b57", "#8e4fa8", "#1b9aaa", "#b8860b", "#c2557a")
"""Colours of the homotopy classes, the largest first."""

_OTHER_CLASS, _NOT_GOOD, _EXECUTED = "#7d8590", "#c9ccd1", "#f59e0b"
_INCHES, _DOTS = (5.4, 5.0), 130
_QUALITY = 82
_FILM_HEIGHT = 360


@dataclass(frozen=True)
class Shot:
    """An episode that is played again.

    Attributes:
        method: as the report names it.
        key: of the episode.
        player: plays it.
        filmed: whether its video is taken, in place of a picture.
    """

    method: str
    key: EpisodeKey
    player: PlayMethods
    filmed: bool


def take_media(
    findings: Findings, results: JoinedResults, *, pictures: int = 0, videos: int = 0, jobs: int = 1
) -> Media:
    """Play some episodes again and return their pictures and videos.

    Args:
        findings: of the report; its methods are shown.
        results: that hold the episodes.
        pictures: of how many episodes each method's particle set is drawn: the first scene of each
            cell in turn, then the second, whatever the outcome.
        videos: how many failures of each method are filmed, the first ones, beside its first
            success; 0 films nothing.
        jobs: number of worker processes.
    """
    names = [method.name for method in findings.methods]
    drawn = first_episodes(findings.episodes, pictures)
    shots = [_shot(results, name, episode, False) for episode in drawn for name in names]
    if videos:
        for name in names:
            shots += [_shot(results, name, e, True) for e in _filmed(results, name, videos)]
    if not shots:
        return Media()
    with workers(min(jobs, len(shots))) as pool:
        taken = list(pool.map(take, shots))
    still = taken[: len(drawn) * len(names)]
    return Media(
        tuple(
            (
                f"{cell_title(episode.cell)}, {episode.half} seed {episode.seed}".replace(
                    "  ", " "
                ),
                tuple(still[number * len(names) : (number + 1) * len(names)]),
            )
            for number, episode in enumerate(drawn)
        ),
        tuple(taken[len(still) :]),
        len(drawn),
        any(source.manifest.code != code_digest() for source in results.sources),
    )


def first_episodes(episodes: Sequence[Episode], count: int) -> list[Episode]:
    """Return the first episode of each cell in turn, then the second, up to a count of all."""
    cells: dict[Cell, list[Episode]] = {}
    for episode in episodes:
        cells.setdefault(episode.cell, []).append(episode)
    in_turn = [e for turn in zip_longest(*cells.values()) for e in turn if e is not None]
    return in_turn[:count]


def _episode_title(episode: Episode) -> str:
    half = f"{episode.half} " if episode.half else ""
    return f"{cell_title(episode.cell)}, {half}seed {episode.seed}"


def _filmed(results: JoinedResults, method: str, failures: int) -> Iterator[Episode]:
    """Yield the first episode that a method solved, and the first that it failed."""
    rows = results.rows[method]
    yield from [episode for episode, row in rows.items() if row.success][:1]
    yield from [episode for episode, row in rows.items() if not row.success][:failures]


def _shot(results: JoinedResults, method: str, episode: Episode, filmed: bool) -> Shot:
    row = results.rows[method][episode]
    return Shot(method, row.key, results.source(method, episode).manifest.player, filmed)


def take(shot: Shot) -> Picture:
    """Return the picture or the video of an episode, played in this process."""
    key = shot.key
    env = gym.make(environment_id(key.task), **key.cell.make_arguments())
    recorder = ActionRecorder()
    try:
        played = play_episode(key, env, shot.player.policy(key), (recorder,), shot.player.lists)
    finally:
        env.close()
    if shot.filmed:
        frames = film(played, recorder.actions, planned_path(played), _FILM_HEIGHT)
        return _video(shot.method, played.row, frames)
    return _picture(shot.method, played)


def _proposed(played: PlayedEpisode) -> tuple[list[SceneLine], str]:
    """Return the lines of a particle set, the executed one last, and how many are good."""
    plan: Plan | None = played.plan
    if plan is None:
        return [SceneLine(played.object_path, _EXECUTED, 3.5, rimmed=True)], "no plan"
    paths = object_paths(plan.trajectories, carried_point(played.scene))
    colours = [_NOT_GOOD] * len(paths)
    for index, label in zip(np.flatnonzero(plan.good), plan.modes.labels, strict=True):
        colours[index] = _CLASSES[label] if label < len(_CLASSES) else _OTHER_CLASS
    good_last = sorted(range(len(paths)), key=lambda index: bool(plan.good[index]))
    lines = [SceneLine(paths[index], colours[index]) for index in good_last]
    lines.append(SceneLine(paths[plan.chosen], _EXECUTED, 3.5, rimmed=True))
    good = int(plan.good.sum())
    classes = f", in {plan.modes.count} class{'es' if plan.modes.count > 1 else ''}" if good else ""
    return lines, f"{good} of {len(paths)} trajectories good{classes}"


def _picture(method: str, played: PlayedEpisode) -> Picture:
    lines, proposed = _proposed(played)
    caption = f"{proposed}; {outcome(played.row)}"
    figure = Figure(figsize=_INCHES, dpi=_DOTS, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    paint_scene(figure.add_axes((0.0, 0.0, 1.0, 1.0)), played.scene, lines)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    return Picture(
        method,
        _uri("image/webp", imageio.imwrite("<bytes>", pixels, extension=".webp", quality=_QUALITY)),
        pixels.shape[1],
        pixels.shape[0],
        caption,
        f"{method} on {cell_title(played.row.key.cell)}, seed {played.row.seed}: the scene in "
        f"perspective with the arm at its start, the obstacles and {caption}.",
    )


def _video(method: str, row: EpisodeRow, frames: Sequence[NDArray[np.uint8]]) -> Picture:
    title = _episode_title(Episode(row.key.cell, row.half, row.seed))
    caption = f"{title}: {outcome(row)}"
    with TemporaryDirectory() as folder:
        path = Path(folder) / "episode.mp4"
        write_video(frames, path)
        content = path.read_bytes()
    height, width = frames[0].shape[:2]
    source = _uri("video/mp4", content)
    return Picture(method, source, width, height, caption, f"Video of {method} on {caption}.")


def _uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
