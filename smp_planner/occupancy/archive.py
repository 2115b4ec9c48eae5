"""Files of our own: `.npz` archives of plain arrays with a header, which run no code when read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.arrays import shown
from smp_gym.atomic_files import replacing
from smp_gym.untrusted_files import parse_json, read_arrays

__all__ = ["read_archive", "write_archive"]


def write_archive(
    path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write arrays and a header of JSON values; `read_archive` gives the arrays back exactly."""
    named: dict[str, Any] = {"header": np.array(json.dumps(header)), **arrays}
    # To a file that is open: numpy adds a suffix to a name without one.
    with replacing(path) as aside, open(aside, "wb") as file:
        np.savez_compressed(file, **named)


def read_archive(
    content: bytes, source: str, *headers: Mapping[str, Any]
) -> dict[str, NDArray[Any]]:
    """Return the arrays of an archive by name.

    Args:
        content: the whole file.
        source: its name, for errors.
        *headers: one of which its header has to be.

    Raises:
        ValueError: it is damaged, is no such archive, or has another header.
    """
    try:
        arrays = read_arrays(content, "the file")
        found = parse_json(str(arrays.pop("header")), "the header")
    except (KeyError, ValueError) as error:
        raise ValueError(f"{source} is damaged or of another kind: {error}") from error
    if found not in headers:
        allowed = " or ".join(str(dict(header)) for header in headers)
        raise ValueError(f"{source} must have the header {allowed}, got {shown(found)}")
    return arrays
