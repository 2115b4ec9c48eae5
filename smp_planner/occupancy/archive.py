"""Files of our own: `.npz` archives of plain arrays with a header, which run no code when read."""

from __future__ import annotations

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.atomic_files import replacing

__all__ = ["read_archive", "write_archive"]


def write_archive(
    path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
) -> None:
    """Write arrays and a header of JSON values; `read_archive` gives the arrays back exactly."""
    named: dict[str, Any] = {"header": np.array(json.dumps(header)), **arrays}
    # To a file that is open: numpy adds a suffix to a name without one.
    with replacing(path) as aside, open(aside, "wb") as file:
        np.savez_compressed(file, **named)


def read_archive(content: bytes, source: str, header: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return the arrays of an archive by name.

    Args:
        content: the whole file.
        source: its name, for errors.
        header: what its header has to be.

    Raises:
        ValueError: it is damaged, is no such archive, or has another header.
    """
    try:
        if not zipfile.is_zipfile(io.BytesIO(content)):
            raise ValueError("not a zip archive")
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        found = json.loads(str(arrays.pop("header")))
    except (
        AttributeError,
        EOFError,
        KeyError,
        NotImplementedError,
        OSError,
        RuntimeError,
        SyntaxError,
        TypeError,
        ValueError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise ValueError(f"{source} is damaged or of another kind: {error!r}") from error
    if found != dict(header):
        raise ValueError(f"{source} must have the header {dict(header)}, got {found}")
    return arrays
