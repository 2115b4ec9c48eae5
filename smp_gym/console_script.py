"""The console script ``smp-bench``: the command, or the one line that says what it needs."""

from __future__ import annotations

import sys
from importlib import import_module

from smp_gym.optional_packages import EXTRAS, require

__all__ = ["smp_bench"]

_COMMAND = "smp_planner.benchmark.cli"
"""Module of the command; its room is imported only where what it needs is installed."""


def smp_bench() -> None:
    """Run ``smp-bench``; where a package is missing, say by which extra it comes, with status 2."""
    try:
        require("bench", "smp-bench", *EXTRAS["planner"], *EXTRAS["bench"])
        app = import_module(_COMMAND).app
    except ImportError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    app()
