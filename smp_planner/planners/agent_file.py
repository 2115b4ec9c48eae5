"""Files of agents that propose trajectories: a card, and the weights of a `BumpPolicy`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smp_planner.planners.bump_policy import BumpPolicy, NetworkShape
from smp_planner.planners.card_file import read_network, write_card

__all__ = ["AgentCard", "read_agent", "write_agent"]

_HEADER = {"format": "smp_planner.planners.agent_file", "version": 1}


@dataclass(frozen=True)
class AgentCard:
    """What there is to know of an agent beside its weights.

    Attributes:
        agent: name of the method.
        task: that it was trained for.
        bumps: on the mean of each joint, see `smp_planner.planning.bumps.bump_phases`.
        network: fields of its `NetworkShape`.
        training: difficulties and seeds of its scenes, settings, iterations, trajectories that were
            checked, and CPU seconds, the drawing of scenes included.
        scores: how it fares, with counts and intervals.
    """

    agent: str
    task: str
    bumps: int
    network: Mapping[str, Any]
    training: Mapping[str, Any]
    scores: Mapping[str, Any]


def write_agent(path: Path, policy: BumpPolicy, card: AgentCard) -> None:
    """Write a card, and the weights beside it; see `smp_planner.planners.card_file`.

    Args:
        path: of the card.
        policy: whose weights they are.
        card: what is known of it.
    """
    write_card(path, card, _HEADER, policy)


def read_agent(path: Path) -> tuple[BumpPolicy, AgentCard]:
    """Return the policy and the card of an agent.

    Args:
        path: of the card.

    Raises:
        OSError: there is no such file.
        ValueError: a file is damaged, of another version, or the weights are not those of the
            network that the card names.
    """
    return read_network(
        path, AgentCard, _HEADER, lambda card: BumpPolicy(NetworkShape(**card.network))
    )
