"""Files of trained agents: a JSON card, and weights as fp16 safetensors beside it; neither is code.

The card holds the SHA-256 of its weights; those of before hold none.

Both are read with torch and safetensors alone. The shipped ones are in ``envs_assets/agents``, as
``AGENT_TASK.json``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar, cast

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save

from smp_gym.arrays import shown
from smp_gym.assets import asset_path
from smp_gym.atomic_files import replacing, write_text
from smp_gym.untrusted_files import parse_json, read_file

_WEIGHTS = "weights_sha256"

__all__ = ["read_card", "read_network", "shipped_agent", "weights_path", "write_card"]

Card = TypeVar("Card")
Network = TypeVar("Network", bound=torch.nn.Module)


def shipped_agent(agent: str, task: str) -> Path:
    """Return the path of the card of a shipped agent; it need not exist."""
    return asset_path("agents", f"{agent}_{task}.json")


def weights_path(card: Path) -> Path:
    """Return the path of the weights that belong to a card."""
    return card.with_suffix(".safetensors")


def write_card(path: Path, card: Any, header: dict[str, Any], module: torch.nn.Module) -> None:
    """Write a card, and the weights beside it, in fp16.

    Args:
        path: of the card.
        card: what is known of the agent, a dataclass.
        header: what tells this kind of card and its version from others.
        module: whose weights they are.
    """
    weights = {name: value.half().contiguous() for name, value in module.state_dict().items()}
    content = save(weights)
    with replacing(weights_path(path)) as aside:
        aside.write_bytes(content)
    digest = {_WEIGHTS: hashlib.sha256(content).hexdigest()}
    write_text(path, json.dumps({**header, **asdict(card), **digest}, indent=2) + "\n")


def read_card(path: Path, kind: type[Card], header: dict[str, Any]) -> Card:
    """Return a card.

    Args:
        path: of the card.
        kind: dataclass of the card.
        header: with which it must begin.

    Raises:
        OSError: there is no such file.
        ValueError: it is damaged, or of another kind or version.
    """
    return _card(_entries(path), path, kind, header)


def _entries(path: Path) -> Any:
    return parse_json(read_file(path), str(path))


def _card(content: Any, path: Path, kind: type[Card], header: dict[str, Any]) -> Card:
    names = [field.name for field in fields(cast(Any, kind))]
    found = content if isinstance(content, dict) else {}
    if {name: found.get(name) for name in header} != header or not set(names) <= set(found):
        raise ValueError(f"{path} must be the card of an agent {header}, got {shown(content)}")
    return kind(**{name: found[name] for name in names})


def read_network(
    path: Path, kind: type[Card], header: dict[str, Any], make: Callable[[Card], Network]
) -> tuple[Network, Card]:
    """Return the network of an agent, which is not trained any further, and its card.

    Args:
        path: of the card.
        kind: dataclass of the card.
        header: with which it must begin.
        make: makes the network that a card names, without its weights.

    Raises:
        OSError: there is no such file.
        ValueError: a file is damaged, of another kind or version, or the weights are not those of
            the card, as where writing ended between the two, or not finite.
    """
    entries = _entries(path)
    card = _card(entries, path, kind, header)
    try:
        network = make(card)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{path} names no network: {error}") from None
    weights = weights_path(path)
    content = read_file(weights)
    if entries.get(_WEIGHTS) not in (None, hashlib.sha256(content).hexdigest()):
        raise ValueError(
            f"{weights} is not the weights of {path}, whose {_WEIGHTS} is {entries[_WEIGHTS]!r}"
        )
    try:
        state = load(content)
        network.load_state_dict({name: value.to(torch.float32) for name, value in state.items()})
    except (RuntimeError, SafetensorError) as error:
        raise ValueError(f"{weights} is not the weights of {path}: {error}") from None
    if not all(bool(torch.isfinite(value).all()) for value in network.state_dict().values()):
        raise ValueError(f"{weights} must hold finite numbers")
    network.requires_grad_(False)
    return network, card
