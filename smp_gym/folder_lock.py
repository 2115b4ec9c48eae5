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
    """The right to write to a folder, until it is closed, forgotten, or the process ends anyhow.

    Args:
        folder: must exist.

    Raises:
        FolderInUseError: somebody else has it.
        OSError: the folder does not exist or cannot be written to.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / _NAME
        self._handle: int | None = None
        while self._handle is None:
            handle = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # Whoever had it before may have removed the file in between.
                if self._is(handle):
                    self._handle = handle
            except BlockingIOError:
                raise FolderInUseError(
                    errno.EWOULDBLOCK, "another process is writing to the folder", str(folder)
                ) from None
            finally:
                if self._handle is None:
                    os.close(handle)

    def _is(self, handle: int) -> bool:
        """Return whether an open file is the one that others would lock."""
        try:
            return os.path.samestat(os.fstat(handle), os.stat(self._path))
        except (FileNotFoundError, NotADirectoryError):
            return False

    def close(self) -> None:
        """Let others have the folder."""
        if self._handle is not None:
            if self._is(self._handle):
                self._path.unlink(missing_ok=True)
            os.close(self._handle)
            self._handle = None

    def __del__(self) -> None:
        self.close()

    def __enter__(self) -> FolderLock:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
