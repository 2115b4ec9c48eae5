"""Reading folders of results as older versions wrote them: a manifest, and a line of JSON a row."""

from __future__ import annotations

import json
from dataclasses import MISSING, fields
from pathlib import Path

from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import EpisodeStore, Manifest
from smp_planner.benchmark.results_folder import ResultsError
from smp_planner.benchmark.row_table import checked

__all__ = ["import_results", "read_old_results"]

_MANIFEST, _ROWS = "manifest.json", "episodes.jsonl"
_FORMAT = 1


def import_results(old: Path, new: Path) -> tuple[Manifest, list[EpisodeRow]]:
    """Copy the rows of an older version's folder into a new one; the old one is left as it is.

    Rows that the new folder holds already are not added again, so that an import that was
    interrupted goes on. Scenes were not kept, and stay empty.

    Args:
        old: folder that holds ``manifest.json`` and ``episodes.jsonl``.
        new: folder; made if there is none.

    Returns:
        The manifest, and all rows of the new folder.

    Raises:
        ResultsError: there are no such results, they are damaged, or the new folder is of other
            settings or damaged.
        OSError: the new folder is in use, or cannot be written to.
    """
    manifest, rows = read_old_results(old)
    by_key = {row.key: row for row in rows}
    with EpisodeStore(new, manifest) as store:
        for key in store.missing(by_key):
            store.append(by_key[key])
        return manifest, store.rows


def read_old_results(folder: Path) -> tuple[Manifest, list[EpisodeRow]]:
    """Return manifest and rows of an older version's folder; fields of today have their defaults.

    A last line without an end was torn by a crash, and is left out.

    Raises:
        ResultsError: there are no such results, or they are damaged; the message names file and
            line.
    """
    manifest = _manifest(folder / _MANIFEST)
    belongs, path, rows = set(manifest.episode_keys()), folder / _ROWS, {}
    content = path.read_bytes() if path.exists() else b""
    for number, line in enumerate(content.split(b"\n")[:-1], start=1):
        try:
            row: EpisodeRow = checked(EpisodeRow, line)
            if row.key not in belongs or row.key in rows:
                raise ValueError(f"it does not belong to this run, or is there twice: {row.key}")
        except ValueError as error:
            raise ResultsError(f"{path}, line {number}, is not a row of it: {error}") from error
        rows[row.key] = row
    return manifest, list(rows.values())


def _manifest(path: Path) -> Manifest:
    if not path.is_file():
        raise ResultsError(f"{str(path.parent)!r} holds no results of an older version: no {path}")
    defaults = {
        each.name: each.default if each.default is not MISSING else {}
        for each in fields(Manifest)
        if each.default is not MISSING or each.default_factory is not MISSING
    }
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        version = content.pop("format")
        if version != _FORMAT:
            raise ValueError(f"format must be {_FORMAT}, got {version!r}")
        return Manifest.from_json({**defaults, **content})
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ResultsError(f"{path} is not a manifest of results: {error}") from error
