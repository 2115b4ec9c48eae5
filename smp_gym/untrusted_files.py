"""Reading of files that may be damaged or made to harm: archives, JSON, YAML.

What a file says of its own size is checked before memory is taken for it, whatever is wrong with
it is a ValueError that names it, and no reader runs code.
"""

from __future__ import annotations

import io
import json
import math
import os
import stat
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "LARGEST_ARCHIVE",
    "LARGEST_TEXT",
    "parse_json",
    "parse_yaml",
    "read_arrays",
    "read_file",
    "read_members",
    "unzipped",
]

LARGEST_ARCHIVE = 256 * 2**20
"""Bytes that an archive holds at most, unpacked."""

LARGEST_TEXT = 64 * 2**20
"""Bytes of a text."""

_LARGEST_YAML = 2**20
"""Bytes of a text in YAML, which is read slowly."""

_DEEPEST = 64
"""Levels of lists and mappings in each other."""

_LONGEST_HEADER = 10_000
"""Bytes of the header of an array."""


def read_file(path: str | Path, largest: int = LARGEST_ARCHIVE) -> bytes:
    """Return the content of a file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is larger than `largest` bytes.
    """
    with open(path, "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise ValueError(f"{path} must be a plain file, got a device or pipe")
        if status.st_size > largest:
            raise ValueError(f"{path} must not be larger than {largest} bytes")
        return file.read(status.st_size)


def read_members(content: bytes, source: str, largest: int = LARGEST_ARCHIVE) -> dict[str, bytes]:
    """Return the members of a zip archive by name.

    Args:
        content: of the whole file.
        source: its name, for errors.
        largest: bytes of all members together.

    Raises:
        ValueError: no such archive, damaged, or too large.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            entries = archive.infolist()
            names = [entry.filename for entry in entries]
            if len(set(names)) != len(names):
                raise ValueError("two members have one name")
            announced = sum(entry.file_size for entry in entries)
            if announced > largest:
                raise ValueError(f"{announced} bytes unpacked, at most {largest} are allowed")
            members = {}
            for entry in entries:
                with archive.open(entry) as file:
                    # With a bound: only so nothing is unpacked beyond what was announced.
                    members[entry.filename] = file.read(entry.file_size + 1)
            return members
    except Exception as error:
        # Damaged bytes make zipfile and zlib raise almost anything.
        raise ValueError(f"{source} is damaged or no such archive: {error}") from error


def read_arrays(
    content: bytes, source: str, largest: int = LARGEST_ARCHIVE
) -> dict[str, NDArray[Any]]:
    """Return the arrays of an `.npz` archive by name: numbers, truth values and texts only.

    Args:
        content: of the whole file.
        source: its name, for errors.
        largest: bytes of all arrays together.

    Raises:
        ValueError: no such archive, damaged, too large, or holding something else.
    """
    arrays = {}
    for name, member in read_members(content, source, largest).items():
        try:
            arrays[name.removesuffix(".npy")] = _array(member)
        except Exception as error:
            # So does numpy.
            raise ValueError(f"{source}, member {name!r}, is damaged: {error}") from error
    return arrays


def _array(member: bytes) -> NDArray[Any]:
    file = io.BytesIO(member)
    version = np.lib.format.read_magic(file)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    shape, _, dtype = read[version](file, max_header_size=_LONGEST_HEADER)
    if dtype.kind not in "biufU":
        raise ValueError(f"arrays must hold numbers or texts, got {dtype}")
    announced, there = math.prod(shape) * dtype.itemsize, len(member) - file.tell()
    if announced != there:
        raise ValueError(f"{announced} bytes announced, {there} there")
    return np.load(io.BytesIO(member), allow_pickle=False, max_header_size=_LONGEST_HEADER)


def unzipped(content: bytes, source: str, largest: int = LARGEST_ARCHIVE) -> bytes:
    """Return what a gzipped file holds.

    Args:
        content: of the whole file.
        source: its name, for errors.
        largest: bytes that it holds at most.

    Raises:
        ValueError: no such file, damaged, or too large.
    """
    parts, left = [], largest
    try:
        while content:
            unpacker = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)
            part = unpacker.decompress(content, left + 1)
            left -= len(part)
            if left < 0:
                raise ValueError(f"more than {largest} bytes unpacked")
            if not unpacker.eof:
                raise ValueError("it ends too early")
            parts.append(part)
            content = unpacker.unused_data
    except (zlib.error, ValueError) as error:
        raise ValueError(f"{source} is damaged or no gzipped file: {error}") from error
    return b"".join(parts)


def parse_json(text: str | bytes, source: str) -> Any:
    """Return what a JSON text says.

    Raises:
        ValueError: not JSON, a number that is not finite, one name twice in an object, or too
            large or too deep; the message names the source.
    """
    try:
        if len(text) > LARGEST_TEXT:
            raise ValueError(f"longer than {LARGEST_TEXT} characters")
        content = json.loads(
            text, parse_constant=_not_finite, parse_float=_finite, object_pairs_hook=_distinct
        )
        _check_depth(content)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{source} is not JSON that can be read: {error}") from error
    return content


def _not_finite(text: str) -> float:
    raise ValueError(f"numbers must be finite, got {text}")


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _not_finite(text)


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the name {twice!r} stands twice in one object")
    return content


def _check_depth(content: Any) -> None:
    level, depth = [content], 0
    while level:
        depth += 1
        if depth > _DEEPEST:
            raise ValueError(f"lists and objects in each other beyond {_DEEPEST} levels")
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner += value.values()
            elif isinstance(value, list):
                inner += value
        level = [value for value in inner if isinstance(value, dict | list)]


def parse_yaml(content: bytes, source: str) -> Any:
    """Return what a YAML text of plain values, lists and mappings says.

    Raises:
        ImportError: PyYAML is not installed.
        ValueError: not YAML, aliases, or too large or too deep; the message names the source.
    """
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        if len(content) > _LARGEST_YAML:
            raise ValueError(f"larger than {_LARGEST_YAML} bytes")
        text, depth = content.decode("utf-8-sig"), 0
        for event in yaml.parse(text, Loader=loader):
            if isinstance(event, yaml.AliasEvent):
                raise ValueError("aliases are not allowed")
            depth += isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent)
            depth -= isinstance(event, yaml.MappingEndEvent | yaml.SequenceEndEvent)
            if depth > _DEEPEST:
                raise ValueError(f"lists and mappings in each other beyond {_DEEPEST} levels")
        return yaml.load(text, Loader=loader)
    except Exception as error:
        # Values that look like dates or numbers make yaml raise almost anything.
        raise ValueError(f"{source} is not YAML that can be read: {error}") from error
