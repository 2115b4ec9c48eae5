"""Files of shipped agents: a JSON card, and weights as fp16 safetensors beside it; neither is code.

Both are read with torch and safetensors alone. The shipped ones are in ``envs_assets/agents``, as
``AGENT_TASK.json``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save

from smp_gym.arrays import shown
from smp_gym.assets import asset_path
from smp_gym.atomic_files import replacing, write_text
from smp_gym.untrusted_files import parse_json, read_file
from smp_planner.planners.bump_policy import BumpPolicy, NetworkShape

__all__ = ["AgentCard", "read_agent", "shipped_agent", "write_agent"]

FORMAT = "smp_planner.planners.agent_file"
VERSION = 1


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


def shipped_agent(agent: str, task: str) -> Path:
    """Return the path of the card of a shipped agent; it need not exist."""
    return asset_path("agents", f"{agent}_{task}.json")


def write_agent(path: Path, policy: BumpPolicy, card: AgentCard) -> None:
    """Write a card, and the weights beside it, in fp16, with the ending ``.safetensors``.

    Args:
        path: of the card.
        policy: whose weights they are.
        card: what is known of it.
    """
    weights = {name: value.half().contiguous() for name, value in policy.state_dict().items()}
    with replacing(path.with_suffix(".safetensors")) as aside:
        aside.write_bytes(save(weights))
    header = {"format": FORMAT, "version": VERSION}
    write_text(path, json.dumps({**header, **asdict(card)}, indent=2) + "\n")


def read_agent(path: Path) -> tuple[BumpPolicy, AgentCard]:
    """Return the policy and the card of an agent.

    Args:
        path: of the card.

    Raises:
        OSError: there is no such file.
        ValueError: a file is damaged, of another version, or the weights are not those of the
            network that the card names.
    """
    content = parse_json(read_file(path), str(path))
    expected = {"format": FORMAT, "version": VERSION}
    names = [field.name for field in fields(AgentCard)]
    found = content if isinstance(content, dict) else {}
    if {name: found.get(name) for name in expected} != expected or not set(names) <= set(found):
        raise ValueError(f"{path} must be the card of an agent {expected}, got {shown(content)}")
    card = AgentCard(**{name: found[name] for name in names})
    weights = path.with_suffix(".safetensors")
    try:
        policy = BumpPolicy(NetworkShape(**card.network))
        state = load(read_file(weights))
        policy.load_state_dict({name: value.to(torch.float32) for name, value in state.items()})
    except (TypeError, RuntimeError, SafetensorError) as error:
        raise ValueError(f"{weights} is not the weights of {path}: {error}") from None
    if not all(bool(torch.isfinite(value).all()) for value in policy.state_dict().values()):
        raise ValueError(f"{weights} must hold finite numbers")
    policy.requires_grad_(False)
    return policy, card
