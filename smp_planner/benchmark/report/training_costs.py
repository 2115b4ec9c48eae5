"""Training costs of methods, from the cards of shipped agents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smp_gym.assets import asset_path
from smp_gym.untrusted_files import parse_json, read_file

__all__ = ["TrainingCost", "training_costs"]


@dataclass(frozen=True)
class TrainingCost:
    """Training cost of a method on a task.

    Attributes:
        method: its name.
        task: that it was trained for.
        cpu_seconds: of all processes.
        trajectories: that were checked or executed for it; None where the card does not say.
    """

    method: str
    task: str
    cpu_seconds: float
    trajectories: int | None


def training_costs(
    methods: Sequence[str], tasks: Sequence[str], folder: Path | None = None
) -> list[TrainingCost]:
    """Return what training methods has cost, of those that have a card ``METHOD_TASK.json``.

    Args:
        methods: names; one of two folders, ``NAME@FOLDER``, has the card of NAME.
        tasks: names.
        folder: of the cards; by default that of the package.

    Raises:
        ValueError: a card is damaged; the message names it.
    """
    found = []
    for method in methods:
        for task in tasks:
            path = (folder or asset_path("agents")) / f"{method.partition('@')[0]}_{task}.json"
            if path.is_file():
                found += _cost(method, task, parse_json(read_file(path), str(path)), path)
    return found


def _cost(method: str, task: str, card: Any, path: Path) -> list[TrainingCost]:
    training = card.get("training") if isinstance(card, dict) else None
    if not isinstance(training, dict):
        raise ValueError(f"{path} must be a card with an entry training, got {card!r:.60}")
    seconds, trajectories = training.get("cpu_seconds"), training.get("trajectories")
    if not isinstance(seconds, float | int) or not isinstance(trajectories, int | None):
        raise ValueError(
            f"{path} must give cpu_seconds and trajectories as numbers, got {seconds!r:.60} and "
            f"{trajectories!r:.60}"
        )
    return [TrainingCost(method, task, float(seconds), trajectories)]
