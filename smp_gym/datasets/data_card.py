"""The data card: frozen episode lists and demonstrations described as Croissant, read by machines.

Croissant (https://docs.mlcommons.org/croissant/docs/croissant-spec.html) is JSON-LD: files with
their digests, and the fields of what is in them.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, NamedTuple

from smp_gym.arrays import shown
from smp_gym.assets import asset_path
from smp_gym.atomic_files import write_text
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.datasets.frozen import frozen_lists, list_path, read_header
from smp_gym.suites import home_suite
from smp_gym.untrusted_files import parse_json, read_file

__all__ = ["CARD", "data_card", "read_data_card", "write_data_card"]

CARD = "croissant.json"
"""Name of the card, in the folder of the data."""

_VERSION = "0.1.0"
_SCHEMA, _CROISSANT = "https://schema.org/", "http://mlcommons.org/croissant/"
_CONTEXT = {
    "@language": "en",
    "@vocab": _SCHEMA,
    "sc": _SCHEMA,
    "cr": _CROISSANT,
    "dct": "http://purl.org/dc/terms/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
_LINES, _ARRAYS = "application/jsonlines", "application/x-npz"
_LICENCE = "https://spdx.org/licenses/MIT.html"
_CITED = (
    "@misc{yin_stein_movement_primitives, title = {Stein Movement Primitives for Adaptive "
    "Multi-Modal Trajectory Generation}, author = {Yin, Zeya and Lai, Tin and Khan, Subhan and "
    "Jacob, Jayadeep and Li, Yonghui and Ramos, Fabio}, note = {Preprint}}"
)
_ABOUT = (
    "Randomised manipulation tasks of a Kinova JACO arm among obstacles: frozen lists of episodes, "
    "each certified by a solver in the physics, and demonstrations in joint space from which "
    "movement primitives are learned. Positions are in m in the arm's base frame, angles in rad, "
    "times in s, quaternions (x, y, z, w)."
)


class _Field(NamedTuple):
    """A field of a record: where it stands, and what it is.

    Attributes:
        name: of the field.
        kind: of its values, of schema.org.
        about: what it says.
        column: that holds it; empty where that has the field's name.
        repeated: whether there are several values.
    """

    name: str
    kind: str
    about: str
    column: str = ""
    repeated: bool = False


_EPISODE_FIELDS = (
    _Field("half", "sc:Text", "witness: drawn around a reference trajectory; placed: without."),
    _Field("seed", "sc:Integer", "From which the scene was drawn in its half."),
    _Field("solver", "sc:Text", "The first that solved it in the physics; empty if none did."),
    _Field("task", "sc:Text", "Name of the task.", "scene"),
    _Field("family", "sc:Text", "Kind of scenes.", "scene"),
    _Field("difficulty", "sc:Text", "How much stands in the scene.", "scene"),
    _Field("start", "sc:Float", "Joint angles at the start, 6 of them, rad.", "scene", True),
)
_EPISODES = (
    "A line for each episode, after a first line that is the list's header. The column scene also "
    "holds the manipulated object, the goals and the obstacles: kind or shape, position, "
    "quaternion, half-extents (size) and motion of each."
)
_DEMONSTRATION_FIELDS = (
    _Field("configurations", "sc:Float", "Joint angles (N, T, 6), rad, at equal steps of phase."),
    _Field("gripper", "sc:Float", "Commanded gripper reference (N, T), 0 open to 1 closed."),
    _Field("durations", "sc:Float", "Time from phase 0 to phase 1 (N,), s."),
    _Field("header", "sc:Text", "JSON: version, task, scene of each demonstration, metadata."),
)


def _file(name: str, path: Path, root: Path, format: str, about: str) -> dict[str, Any]:
    content = read_file(path)
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "description": about,
        "contentUrl": path.relative_to(root).as_posix(),
        "contentSize": f"{len(content)} B",
        "encodingFormat": format,
        "sha256": hashlib.sha256(content).hexdigest(),
    }


def _lists(root: Path) -> list[dict[str, Any]]:
    folder = root / "benchmark"
    files = []
    for cell in frozen_lists(folder):
        header = read_header(cell, folder)
        about = (
            f"Frozen list of {cell.name}, suite {home_suite(cell)}: {header['episodes']} episodes, "
            f"then {header['unknown']} that no solver has solved; the first line is the header."
        )
        path = list_path(cell, folder)
        files.append(_file(cell.name, path, root, _LINES, about))
    return files


def _demonstrations(root: Path) -> list[dict[str, Any]]:
    files = []
    for path in sorted((root / "demonstrations").glob("*.npz")):
        count, samples, joints = Demonstrations.load(path).configurations.shape
        about = f"{count} demonstrations of {path.stem}, {samples} samples of {joints} joints."
        name = f"{path.stem}_demonstrations"
        files.append(_file(name, path, root, _ARRAYS, about))
    return files


def _file_set(name: str, pattern: str, format: str, about: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileSet",
        "@id": name,
        "name": name,
        "description": about,
        "includes": pattern,
        "encodingFormat": format,
    }


def _record_set(name: str, fields: tuple[_Field, ...], source: str, about: str) -> dict[str, Any]:
    described = []
    for field in fields:
        taken: dict[str, Any] = {"column": field.column or field.name}
        origin: dict[str, Any] = {"fileSet": {"@id": source}, "extract": taken}
        if field.column:
            origin["transform"] = {"jsonPath": field.name}
        described.append(
            {
                "@type": "cr:Field",
                "@id": f"{name}/{field.name}",
                "name": field.name,
                "description": field.about,
                "dataType": field.kind,
                **({"repeated": True} if field.repeated else {}),
                "source": origin,
            }
        )
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": about,
        "field": described,
    }


def data_card(root: Path | None = None, *, url: str = "", published: str = "") -> dict[str, Any]:
    """Return the card of the frozen lists and the demonstrations, as JSON holds it.

    Args:
        root: folder with ``benchmark`` and ``demonstrations``; by default that of the package.
        url: page of the data; left out if empty.
        published: date of publication, as in ``2026-01-31``; left out if empty.

    Raises:
        ValueError: a file is damaged, or there are none; the message names it.
    """
    root = asset_path() if root is None else root
    lists, demonstrations = _lists(root), _demonstrations(root)
    if not lists or not demonstrations:
        raise ValueError(f"root must hold benchmark and demonstrations, got {str(root)!r}")
    given = {"url": url, "datePublished": published}
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": f"{_CROISSANT}1.0",
        "name": "smp-gym",
        "description": _ABOUT,
        "license": _LICENCE,
        "version": _VERSION,
        "creator": {"@type": "sc:Organization", "name": "Stein Movement Primitives contributors"},
        "keywords": ["robotics", "manipulation", "motion planning", "movement primitives"],
        "citeAs": _CITED,
        **{name: value for name, value in given.items() if value},
        "distribution": [
            _file_set("lists", "benchmark/*/*.jsonl.gz", _LINES, "All frozen lists."),
            _file_set("archives", "demonstrations/*.npz", _ARRAYS, "All demonstrations."),
            *lists,
            *demonstrations,
        ],
        "recordSet": [
            _record_set("episodes", _EPISODE_FIELDS, "lists", _EPISODES),
            _record_set(
                "demonstrations",
                _DEMONSTRATION_FIELDS,
                "archives",
                "The arrays of each archive by their names; no pickle is needed to read them.",
            ),
        ],
    }


def read_data_card(path: Path) -> dict[str, Any]:
    """Return a card, as JSON holds it.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no JSON object; the message names the file.
    """
    content = parse_json(read_file(path).decode("utf-8"), str(path))
    if not isinstance(content, dict):
        raise ValueError(f"{path} must hold a JSON object, got {shown(content)}")
    return content


def write_data_card(root: Path | None = None, *, url: str = "", published: str = "") -> Path:
    """Write the card of a folder into it, and return its path.

    Args:
        root: see `data_card`.
        url: of the data; if empty, what a card that is there says.
        published: date of publication, likewise.

    Raises:
        ValueError: as `data_card`, or the card that is there is damaged.
    """
    root = asset_path() if root is None else root
    path = root / CARD
    before = read_data_card(path) if path.exists() else {}
    card = data_card(
        root,
        url=url or before.get("url", ""),
        published=published or before.get("datePublished", ""),
    )
    write_text(path, json.dumps(card, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    return path
