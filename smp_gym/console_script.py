"""Beginnings of commands: what they import, or the one line that says by which extra it comes.

Of ``smp-bench`` the whole command, of scripts, which are run as ``python scripts/NAME.py``, the
line before their other imports.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

from smp_gym.optional_packages import EXTRAS, require

__all__ = ["require_for_script", "smp_bench"]

_COMMAND = "smp_planner.benchmark.cli"
"""Module of the command; its room is imported only where what it needs is installed."""


def smp_bench() -> None:
    """Run ``smp-bench``; where a package is missing, say by which extra it comes, with status 2."""
    try:
        _require_command("smp-bench")
        app = import_module(_COMMAND).app
    except ImportError as error:
        raise _ended(error) from None
    app()


def require_for_script(*extras: str) -> None:
    """Do nothing where what the running script imports is installed.

    Args:
        extras: of `EXTRAS`, whose modules it imports beside those of planner and bench.

    Raises:
        SystemExit: a module is not installed; a line says by which extra it comes, with status 2.
    """
    name = Path(sys.argv[0]).name
    try:
        _require_command(name)
        for extra in extras:
            require(extra, name)
    except ImportError as error:
        raise _ended(error) from None


def _require_command(name: str) -> None:
    """Do nothing where command lines, and the planner that they need, are installed."""
    require("bench", name, *EXTRAS["planner"], *EXTRAS["bench"])


def _ended(error: ImportError) -> SystemExit:
    """Print an error, and return the end of the process."""
    print(f"error: {error}", file=sys.stderr)
    return SystemExit(2)
