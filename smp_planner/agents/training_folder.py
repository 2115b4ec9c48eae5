"""Folders of the trainings of our own agents: description, settings, checkpoint."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from smp_gym.arrays import shown
from smp_gym.atomic_files import replacing, write_text
from smp_gym.folder_lock import FolderLock
from smp_gym.untrusted_files import parse_json, read_file

__all__ = ["claimed", "named_settings", "read_checkpoint", "write_checkpoint"]

_CHECKPOINT = "checkpoint.pt"


def claimed(folder: Path, description: Mapping[str, Any]) -> FolderLock:
    """Return the lock of a training's folder, with its ``run.json`` written.

    Args:
        folder: made if there is none.
        description: of the training, as JSON holds it.

    Raises:
        ValueError: the folder holds another training, or a damaged one.
        OSError: somebody else trains there (`FolderInUseError`), or it cannot be written to.
    """
    text = json.dumps(description, indent=2) + "\n"
    begun = folder / "run.json"
    folder.mkdir(parents=True, exist_ok=True)
    lock = FolderLock(folder)
    if begun.exists() and begun.read_text() != text:
        lock.close()
        raise ValueError(f"{folder} holds another training, or a damaged one, see {begun}")
    write_text(begun, text)
    return lock


def named_settings(path: Path, *names: str) -> dict[str, Any]:
    """Return the settings that a JSON file has for names, later ones on top of earlier ones.

    Raises:
        OSError: there is no such file.
        ValueError: it is not JSON, or no object of objects.
    """
    content = parse_json(read_file(path), str(path))
    if not isinstance(content, dict):
        raise ValueError(f"{path} must hold settings by name, got {shown(content)}")
    chosen: dict[str, Any] = {}
    for name in names:
        own = content.get(name, {})
        if not isinstance(own, dict):
            raise ValueError(f"{path} must hold settings for {name!r}, got {shown(own)}")
        chosen |= own
    return chosen


def write_checkpoint(folder: Path, content: Mapping[str, Any]) -> None:
    """Write tensors and numbers by name, whole or not at all."""
    with replacing(folder / _CHECKPOINT) as aside:
        torch.save(dict(content), aside)


def read_checkpoint(folder: Path) -> dict[str, Any] | None:
    """Return what `write_checkpoint` wrote, None if nothing; no code in it is run."""
    path = folder / _CHECKPOINT
    if not path.exists():
        return None
    content: dict[str, Any] = torch.load(path, weights_only=True)
    return content
