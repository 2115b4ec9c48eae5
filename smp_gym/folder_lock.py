"""A lock on a folder, for the one process that writes there; the kernel releases it on death."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path
from types import TracebackType

__all__ = ["FolderInUseError", "FolderLock"]

_NAME = ".lock"


class FolderInUseError(BlockingIOError):
    """Another process, or another part of this one, is writing to a folder."""


class FolderLock:
    """The right to write to a folder, until it is closed or the process ends in any manner.

    Args:
        folder: must exist.

    Raises:
        FolderInUseError: somebody else has it.
        OSError: the folder does not exist or cannot be written to.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / _NAME
        while True:
            self._handle = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(self._handle)
                raise FolderInUseError(
                    errno.EWOULDBLOCK, "another process is writing to the folder", str(folder)
                ) from None
            # Whoever had it before may have removed the file in between.
            if self._in_place():
                return
            os.close(self._handle)

    def _in_place(self) -> bool:
        """Return whether the locked file is the one that others would lock."""
        try:
            return os.path.samestat(os.fstat(self._handle), os.stat(self._path))
        except FileNotFoundError:
            return False

    def close(self) -> None:
        """Let others have the folder."""
        if self._handle < 0:
            return
        if self._in_place():
            self._path.unlink(missing_ok=True)
        os.close(self._handle)
        self._handle = -1

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
