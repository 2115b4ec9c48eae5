"""Worker processes that do not outlive the process that started them."""

from __future__ import annotations

import multiprocessing
import os
import threading

__all__ = ["end_with_parent"]


def end_with_parent() -> None:
    """End this process once the one that started it has ended, in whatever manner that was.

    For processes of `multiprocessing`; without effect in others. A thread waits on the pipe that
    the system closes with the parent, so that it holds for ``kill -9``, too.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
