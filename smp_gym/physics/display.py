"""Asking the display whether it answers: PyBullet ends the process with one that does not."""

from __future__ import annotations

import os
import subprocess
import sys

__all__ = ["check_display"]

_PATIENCE = 10.0
"""Seconds that a display has for its answer."""

_ASK = """
import ctypes, sys
library = ctypes.CDLL("libX11.so.6")
library.XOpenDisplay.restype = ctypes.c_void_p
sys.exit(0 if library.XOpenDisplay(None) else 3)
"""


def check_display() -> None:
    """Raise a RuntimeError if no X server answers where PyBullet needs one.

    It is asked by a process of its own: a server that takes the call and never answers keeps the
    caller for good.
    """
    if not sys.platform.startswith("linux"):
        return
    name = os.environ.get("DISPLAY")
    if not name:
        complaint = "DISPLAY is not set"
    else:
        try:
            answer = subprocess.run(
                [sys.executable, "-I", "-c", _ASK], capture_output=True, timeout=_PATIENCE
            )
            if answer.returncode == 0:
                return
            complaint = f"DISPLAY={name!r} cannot be opened"
        except subprocess.TimeoutExpired:
            complaint = f"DISPLAY={name!r} does not answer within {_PATIENCE:.0f} s"
    raise RuntimeError(
        f"a window needs a display, but {complaint}: use render_mode='rgb_array', or run under an "
        "X server (for example xvfb-run)"
    )
