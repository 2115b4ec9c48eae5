"""The file format of a saved policy: a zip of a JSON header and the demonstrations; runs no code.

The header names format, version, method, settings and seed; the demonstrations follow as the file
that `Demonstrations.save` writes. The planner learns from them again on loading, which takes
milliseconds and keeps file and code from drifting apart.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smp_gym.arrays import shown
from smp_gym.atomic_files import replacing
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.untrusted_files import parse_json, read_file, read_members

__all__ = ["FORMAT", "VERSION", "SavedPolicy", "read_policy", "write_policy"]

FORMAT = "smp_planner.policy.planner_policy"
VERSION = 1

_HEADER_FILE = "policy.json"
_DEMONSTRATIONS = "demonstrations.npz"


@dataclass(frozen=True)
class SavedPolicy:
    """Contents of a policy file.

    Attributes:
        method: spec of its method; see `smp_planner.planners.registry.resolve`.
        settings: of the method by name.
        seed: of the policy.
        demonstrations: that its planner learned from.
    """

    method: str
    settings: Mapping[str, Any]
    seed: int
    demonstrations: Demonstrations


def write_policy(path: Path, policy: SavedPolicy) -> None:
    """Write a policy; an existing file is replaced only once the new one is complete."""
    header = {
        "format": FORMAT,
        "version": VERSION,
        "method": policy.method,
        "settings": dict(policy.settings),
        "seed": policy.seed,
    }
    members = {
        _HEADER_FILE: json.dumps(header, indent=1).encode(),
        _DEMONSTRATIONS: policy.demonstrations.to_bytes(),
    }
    with replacing(path) as aside, zipfile.ZipFile(aside, "w") as archive:
        for name, content in members.items():
            # Without the time of day: the same policy gives the same bytes.
            archive.writestr(zipfile.ZipInfo(name), content)


def read_policy(path: Path) -> SavedPolicy:
    """Return the contents of a policy file.

    Raises:
        FileNotFoundError: no such file.
        ValueError: damaged, not a policy, or of another version.
    """
    members = read_members(read_file(path), str(path))
    missing = {_HEADER_FILE, _DEMONSTRATIONS} - set(members)
    if missing:
        raise ValueError(f"{path} is not a saved policy: it has no {', '.join(sorted(missing))}")
    header = parse_json(members[_HEADER_FILE], f"{path}, {_HEADER_FILE},")
    expected = {"format": FORMAT, "version": VERSION}
    found = {name: header.get(name) for name in expected} if isinstance(header, dict) else header
    if found != expected:
        raise ValueError(f"{path} must be a saved policy {expected}, got {shown(found)}")
    kinds = {"method": str, "settings": dict, "seed": int}
    for name, kind in kinds.items():
        if not isinstance(header.get(name), kind):
            raise ValueError(
                f"{path} is not a saved policy: its {name} must be a {kind.__name__}, "
                f"got {shown(header.get(name))}"
            )
    demonstrations = Demonstrations.parse(members[_DEMONSTRATIONS], f"{path}, {_DEMONSTRATIONS},")
    return SavedPolicy(header["method"], header["settings"], header["seed"], demonstrations)
