"""One process at a time has a folder, and the kernel lets the next one have it after a kill."""

import os
import signal
from itertools import count
from pathlib import Path

import pytest

from smp_gym.folder_lock import FolderInUseError, FolderLock


def test_nobody_else_has_a_locked_folder(tmp_path: Path) -> None:
    first = FolderLock(tmp_path)
    for _ in range(2):
        with pytest.raises(FolderInUseError, match="another process") as told:
            FolderLock(tmp_path)
        assert told.value.filename == str(tmp_path)
    first.close()
    with FolderLock(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_forgotten_lock_is_open(tmp_path: Path) -> None:
    lock = FolderLock(tmp_path)
    del lock
    FolderLock(tmp_path).close()


def test_a_lock_on_nothing_is_an_error_of_the_system(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        FolderLock(tmp_path / "nowhere")
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError):
        FolderLock(tmp_path / "file")


def test_a_killed_process_locks_nobody_out(tmp_path: Path) -> None:
    told, telling = os.pipe()
    child = os.fork()
    if child == 0:
        lock = FolderLock(tmp_path)
        os.write(telling, b".")
        signal.pause()
        lock.close()
    assert os.read(told, 1) == b"."
    with pytest.raises(FolderInUseError):
        FolderLock(tmp_path)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    FolderLock(tmp_path).close()


def test_of_many_at_once_one_at_a_time_has_it(tmp_path: Path) -> None:
    """Also while each removes the file of its lock at the end."""
    written = tmp_path / "written"
    written.touch()
    children = []
    for _ in range(4):
        child = os.fork()
        if child == 0:
            for _ in range(25):
                _add_one(tmp_path, written)
            os._exit(0)
        children.append(child)
    assert [os.waitpid(child, 0)[1] for child in children] == [0] * 4
    assert written.stat().st_size == 100


def _add_one(folder: Path, written: Path) -> None:
    """Write a file one byte longer, which loses bytes if two do it at once."""
    for _ in count():
        try:
            with FolderLock(folder):
                written.write_bytes(written.read_bytes() + b".")
            return
        except FolderInUseError:
            pass
