"""The file format of a saved policy: a zip of a JSON header and the demonstrations; runs no code.

The header names format, version, method, settings and seed; the demonstrations follow as the file
that `Demonstrations.save` writes. The primitive is fitted again on loading, which takes
milliseconds and keeps file and code from drifting apart.
"""

from __future__ import annotations

import io
import json
import os
import tempfile
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

from smp_gym.demonstrations import Demonstrations

if TYPE_CHECKING:
    from smp_planner.planners import PlannerModel

__all__ = ["FORMAT", "VERSION", "read_policy", "write_policy"]

FORMAT = "smp_planner.policy"
VERSION = 1


def write_policy(path: Path, planner: PlannerModel, seed: int) -> None:
    """Write a policy; an existing file is replaced only once the new one is complete."""
    header = {
        "format": FORMAT,
        "version": VERSION,
        "method": planner.name,
        "settings": planner.settings.model_dump(mode="json"),
        "seed": seed,
    }
    demonstrations = io.BytesIO()
    planner.demonstrations.save(demonstrations)
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file, zipfile.ZipFile(file, "w") as archive:
            archive.writestr("policy.json", json.dumps(header, indent=1))
            archive.writestr("demonstrations.npz", demonstrations.getvalue())
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def read_policy(path: Path) -> tuple[PlannerModel, int]:
    """Return planner and seed of a saved policy.

    Raises:
        FileNotFoundError: no such file.
        ValueError: damaged, not a policy, or of another version.
    """
    from smp_planner.planners import make_planner

    try:
        with zipfile.ZipFile(path) as archive:
            header = json.loads(archive.read("policy.json"))
            content = archive.read("demonstrations.npz")
    except (zipfile.BadZipFile, KeyError, json.JSONDecodeError) as error:
        raise ValueError(f"{path} is not a saved policy or is damaged: {error}") from error
    if header.get("format") != FORMAT or header.get("version") != VERSION:
        raise ValueError(
            f"{path} holds {header.get('format')!r} version {header.get('version')!r}; "
            f"this package reads {FORMAT!r} version {VERSION}"
        )
    demonstrations = Demonstrations.load(io.BytesIO(content))
    planner = make_planner(
        header["method"], demonstrations=demonstrations, settings=header["settings"]
    )
    return planner, int(header["seed"])
