"""Films of episodes: the physics in pictures, with what was planned, a caption and the contact."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from smp_gym.arrays import FloatArray
from smp_gym.observation import CONTROL_PERIOD
from smp_gym.physics.lines import Line
from smp_gym.rollout import FrameRecorder, Moment
from smp_planner.benchmark.episodes import (
    EpisodeRow,
    PlayedEpisode,
    contact_in_words,
    environment_id,
)

__all__ = ["ActionRecorder", "film", "outcome"]

_SHAPE = (720, 1280)
_CAPTION_SHARE = 7 / 90
_CAMERA = {"target": (0.32, 0.0, 0.36), "distance": 1.65}
_PLANNED, _PLANNED_WIDTH = (0.96, 0.62, 0.04), 0.009
_CONTACT, _CONTACT_WIDTH, _CONTACT_RADIUS = (0.77, 0.10, 0.10), 0.006, 0.035
_GROUND, _INK = "#1f2937", "#f9fafb"
_VERDICTS = {True: "#86efac", False: "#fca5a5"}
_BORDER, _RED = 1 / 90, (196, 43, 43)


class ActionRecorder:
    """Records the actions of an episode, so that it can be played again."""

    def __init__(self) -> None:
        self._actions: list[NDArray[np.float32]] = []

    def __call__(self, moment: Moment) -> None:
        """Take the action that led here."""
        if moment.action is not None:
            self._actions.append(np.array(moment.action))

    @property
    def actions(self) -> list[NDArray[np.float32]]:
        """The actions (7,) in their order."""
        return list(self._actions)


def outcome(row: EpisodeRow) -> str:
    """Return how an episode ended, and after how long, in words."""
    seconds = f"{row.steps * CONTROL_PERIOD:.1f} s"
    if row.success:
        return f"success after {seconds}"
    contact = f", {contact_in_words(row.contact)}" if row.contact else ""
    return f"{row.cause or 'unfinished'}{contact}, after {seconds}"


def film(
    played: PlayedEpisode,
    actions: list[NDArray[np.float32]],
    path: FloatArray | None,
    height: int = _SHAPE[0],
) -> list[NDArray[np.uint8]]:
    """Return the pictures of a played episode, one for each control step.

    Its actions are executed again. The planned path is drawn where no body hides it; below stand
    episode, method and time. The last picture says how the episode ended; after a failure it has a
    red border, and a forbidden contact is ringed.

    Args:
        played: the episode.
        actions: that were executed, from an `ActionRecorder`.
        path: (T, 3) m, planned; None of a method that plans nothing.
        height: of the pictures, pixels, of which 180 and its multiples give whole numbers; they are
            16:9.

    Returns:
        Pictures (height, 16 / 9 height, 3).

    Raises:
        RuntimeError: the actions lead elsewhere than they did, as on another machine.
    """
    row, width = played.row, height * _SHAPE[1] // _SHAPE[0]
    below = round(height * _CAPTION_SHARE)
    env = gym.make(
        environment_id(row.task),
        **row.key.cell.make_arguments(),
        render_mode="rgb_array",
        width=width,
        height=height - below,
        camera=_CAMERA,
    )
    recorder = FrameRecorder()
    bare: Any = env.unwrapped
    if path is not None:
        bare.overlay = (Line(path, _PLANNED, _PLANNED_WIDTH),)
    try:
        observation, info = env.reset(options={"scene": row.scene})
        recorder(Moment(env, 0, observation, info))
        for step, action in enumerate(actions, 1):
            observation, _, _, _, info = env.step(action)
            if bare.collision_point is not None:
                bare.overlay = (*bare.overlay, *_ring(bare.collision_point))
            recorder(Moment(env, step, observation, info))
    finally:
        env.close()
    if bool(info["is_success"]) != row.success or len(actions) != row.steps:
        raise RuntimeError(f"the actions of {row.key} lead elsewhere when they are executed again")
    planned = path is not None
    pictures = [
        np.concatenate([frame, _caption(row, step, planned, (below, width))])
        for step, frame in enumerate(recorder.frames)
    ]
    if not row.success:
        pictures[-1] = _framed(pictures[-1])
    return pictures


def _ring(point: FloatArray) -> tuple[Line, ...]:
    """Return three circles about a point, which no body hides."""
    angles = np.linspace(0.0, 2.0 * np.pi, 25)
    circle = _CONTACT_RADIUS * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    return tuple(
        Line(point + np.roll(circle, axis, axis=1), _CONTACT, _CONTACT_WIDTH, hidden=False)
        for axis in range(3)
    )


def _caption(
    row: EpisodeRow, step: int, planned: bool, shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """Return the strip (H, W, 3) below a picture."""
    height, width = shape
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor=_GROUND)
    canvas = FigureCanvasAgg(figure)
    size = 0.36 * height * 72 / 100
    half = f"{row.half} " if row.half else ""
    title = f"{row.key.cell.name.replace('_', ', ')}, {half}seed {row.seed}: {row.method}"
    figure.text(0.012, 0.5, title, color=_INK, size=size, weight="bold", va="center")
    over = step == row.steps
    said = outcome(row) if over else f"{step * CONTROL_PERIOD:.1f} s"
    color = _VERDICTS[row.success] if over else _INK
    figure.text(0.988, 0.5, said, color=color, size=size, ha="right", va="center")
    if planned and not over:
        figure.add_artist(Line2D([0.60, 0.635], [0.5, 0.5], color=_PLANNED, lw=0.06 * height))
        figure.text(0.645, 0.5, "planned", color=_INK, size=size, va="center")
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def _framed(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture with a red border."""
    framed, border = picture.copy(), round(_BORDER * len(picture))
    for side in (np.s_[:border], np.s_[-border:], np.s_[:, :border], np.s_[:, -border:]):
        framed[side] = _RED
    return framed
