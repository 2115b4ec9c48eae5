"""Files and folders that are whole at every moment: written aside, then put in their place."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["replacing", "write_text"]


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a path beside `path`; what is written there takes the place of `path` at the end.

    Whoever reads `path` meanwhile, or after a kill or a loss of power at any moment, finds the old
    content or the new, whole and nothing in between. After an error the old content stays. What is
    no file, such as a pipe, is written to directly.

    Args:
        path: of a file, or of a folder that does not exist yet.

    Yields:
        The path to write to, in the same folder and with the same suffix.

    Raises:
        OSError: it cannot be written; the error names `path`, also where the system names none.
    """
    path = Path(os.path.realpath(path))
    if path.exists() and not path.is_file():
        with _named(path, path):
            yield path
        return
    aside = path.with_name(f".{path.stem}-{secrets.token_hex(4)}{path.suffix}")
    with _named(path, aside), _put_in_place(path, aside):
        yield aside


@contextmanager
def _named(path: Path, aside: Path) -> Iterator[None]:
    """Have errors of the system name the path that was asked for, not the one beside it."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename in (None, str(aside)):
            error.filename = str(path)
        raise


@contextmanager
def _put_in_place(path: Path, aside: Path) -> Iterator[None]:
    """Put what is written aside in its place, or take it away after an error."""
    try:
        yield
        for part in (*aside.rglob("*"), aside):
            _sync(part)
        os.replace(aside, path)
        _sync(path.parent)
    finally:
        if aside.is_dir():
            shutil.rmtree(aside, ignore_errors=True)
        else:
            aside.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a text file as `replacing` does."""
    with replacing(path) as aside:
        aside.write_text(text, encoding="utf-8")


def _sync(path: Path) -> None:
    """Have the system write a file or the names in a folder to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
