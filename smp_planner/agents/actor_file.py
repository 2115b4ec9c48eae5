"""Actors of goal-conditioned agents: a network that acts, read with torch alone, and its card."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from smp_gym.untrusted_files import parse_json, read_file
from smp_planner.agents.decisions import ACTION_REPEAT
from smp_planner.agents.goal_view import GoalView
from smp_planner.planners.card_file import read_network, write_card
from smp_planner.torch_threads import one_thread

__all__ = ["Actor", "ActorCard", "is_actor", "read_actor", "write_actor"]

_HEADER = {"format": "smp_planner.agents.actor_file", "version": 1}
_ACTIONS = 7


@dataclass(frozen=True)
class ActorCard:
    """The description of an actor: what it sees, its layers, its training and its scores.

    Attributes:
        agent: name of the method.
        task: that it was trained for.
        entries: of an observation that it sees.
        hidden: fields of the desired goal that it does not see.
        action_repeat: environment steps that a decision lasts.
        layers: widths of the hidden layers.
        training: difficulty, seed, environment steps, hyper-parameters and CPU seconds.
        scores: how it fares, with counts and intervals.
    """

    agent: str
    task: str
    entries: Sequence[str]
    hidden: Sequence[str]
    action_repeat: int
    layers: Sequence[int]
    training: Mapping[str, Any]
    scores: Mapping[str, Any]


class Actor(nn.Module):
    """The mean action of a squashed Gaussian policy, in the interface of agents.

    Args:
        card: says what it sees and how wide its layers are.

    Raises:
        ValueError: the card names entries or fields that the task's observations have not.
    """

    def __init__(self, card: ActorCard) -> None:
        super().__init__()
        self._view = GoalView(card.task, card.entries, card.hidden)
        setattr(self, ACTION_REPEAT, card.action_repeat)
        widths = [self._view.width, *card.layers]
        hidden = [part for sizes in pairwise(widths) for part in (nn.Linear(*sizes), nn.ReLU())]
        self.layers = nn.Sequential(*hidden, nn.Linear(widths[-1], _ACTIONS))

    def forward(self, observations: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Return actions (B, 7) in [-1, 1] for observations (B, ...)."""
        return torch.tanh(self.layers(self._view(observations)))

    def predict(
        self,
        observation: Mapping[str, NDArray[Any]],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], None]:
        """Return the action (7,) for one observation; it is always the mean."""
        batch = {key: torch.from_numpy(np.array(value))[None] for key, value in observation.items()}
        with torch.no_grad(), one_thread():
            return self(batch)[0].numpy(), None


def is_actor(path: Path) -> bool:
    """Return whether a card is that of an actor.

    Raises:
        OSError: there is no such file.
        ValueError: it is not JSON.
    """
    content = parse_json(read_file(path), str(path))
    return isinstance(content, dict) and content.get("format") == _HEADER["format"]


def write_actor(path: Path, actor: Actor, card: ActorCard) -> None:
    """Write a card, and the weights beside it; see `smp_planner.planners.card_file`."""
    write_card(path, card, _HEADER, actor)


def read_actor(path: Path) -> tuple[Actor, ActorCard]:
    """Return an actor and its card.

    Args:
        path: of the card.

    Raises:
        OSError: there is no such file.
        ValueError: a file is damaged, of another version, or the weights are not those of the
            network that the card names.
    """
    return read_network(path, ActorCard, _HEADER, Actor)
