"""Kills at chosen moments, in a copy of this process."""

import os
import resource
import shutil
import signal
import traceback
from collections.abc import Callable
from typing import Any

MID_WRITE = 0


def killed(action: Callable[[], Any], moment: int, size: int = 100) -> bool:
    """Run an action in a forked process that dies on the way, and return whether it did.

    Args:
        action: what to run.
        moment: `MID_WRITE`, where the system kills it as a file outgrows `size`; from 1 on, before
            so many calls that sync, rename or remove.
        size: in bytes.
    """
    child = os.fork()
    if child == 0:
        _die_at(moment, size)
        try:
            action()
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status != 1, "the action failed"
    return status != 0


def _die_at(moment: int, size: int) -> None:
    if moment == MID_WRITE:
        # Python disregards the signal that ends a process here.
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        return
    left = moment

    def counted(call: Callable[..., Any]) -> Callable[..., Any]:
        def counting(*arguments: Any, **options: Any) -> Any:
            nonlocal left
            left -= 1
            if left == 0:
                os._exit(9)
            return call(*arguments, **options)

        return counting

    for module, name in ((os, "fsync"), (os, "replace"), (shutil, "rmtree")):
        setattr(module, name, counted(getattr(module, name)))
