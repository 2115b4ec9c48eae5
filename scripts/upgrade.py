"""Upgrade an installed wheel, and check that no compiled code of the old one runs on.

Wheel A is this checkout; wheel B has another size in the kernels of a box, which are in another
file than the function that is asked. Several processes at once ask it after each step: on an empty
cache, on the stale one that A has left, and on a torn one. All must say what their wheel says.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer
from rich.console import Console

from smp_planner.benchmark.options import run_command

_ROOT = Path(__file__).parents[1]

_ASK = """
import numpy as np
from smp_gym.sampling.kernels import point_distances
box = np.array([[0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.1, 0.1, 0.1]])
print(float(point_distances(np.array([[0.5, 0.0, 0.0]]), box)[0, 0]))
"""
"""Prints the distance of a point to a box, 0.4 m, by a kernel that calls one of another file."""

_CHANGED = Path("smp_gym/geometry/box.py")
_BEFORE, _AFTER = "abs(a) - size[0]", "abs(a) - 0.5 * size[0]"
_DISTANCES = {"A": 0.4, "B": 0.45}


def _pip(*arguments: str) -> None:
    command = [sys.executable, "-m", "pip", "-q", "--disable-pip-version-check", *arguments]
    subprocess.run(command, check=True, capture_output=True)


def _wheel(tree: Path, out: Path) -> Path:
    """Build the wheel of a source tree."""
    _pip("wheel", "--no-deps", "--no-build-isolation", "-w", str(out), str(tree))
    return next(out.glob("*.whl"))


def _answers(site: Path, cache: Path, processes: int) -> list[float]:
    """Return the distances that processes at once find."""
    variables = {"PYTHONPATH": str(site), "NUMBA_CACHE_DIR": str(cache)}
    running = [
        subprocess.Popen(
            [sys.executable, "-c", _ASK],
            env=os.environ | variables,
            cwd=site,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        for _ in range(processes)
    ]
    ended = [process.communicate() for process in running]
    if any(process.returncode for process in running):
        raise RuntimeError("\n".join(errors for _, errors in ended))
    return [float(output.split()[-1]) for output, _ in ended]


def _tear(cache: Path) -> int:
    """Cut every entry of a cache to half, and return how many there are."""
    entries = [path for path in cache.rglob("*.nb*") if path.is_file()]
    for path in entries:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return len(entries)


def main(
    processes: Annotated[int, typer.Option(min=1, help="That ask at once.")] = 4,
) -> None:
    """Build both wheels, install one after the other, and ask; status 1 if an answer is wrong.

    Example: python scripts/upgrade.py --processes 4
    """
    console, wrong = Console(highlight=False), 0
    with TemporaryDirectory() as folder:
        work = Path(folder)
        site, cache = work / "site", work / "cache"
        for version in _DISTANCES:
            tree = work / f"tree_{version}"
            shutil.copytree(
                _ROOT,
                tree,
                ignore=shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "results"),
            )
            if version == "B":
                text = (tree / _CHANGED).read_text()
                if _BEFORE not in text:
                    raise ValueError(f"{_CHANGED} must hold {_BEFORE!r}")
                (tree / _CHANGED).write_text(text.replace(_BEFORE, _AFTER))
            wheel = _wheel(tree, work / f"wheel_{version}")
            _pip("install", "--no-deps", "--upgrade", "--target", str(site), str(wheel))
            caches = ("empty", "kept") if version == "A" else ("stale", "torn", "kept")
            for state in caches:
                if state == "torn" and not _tear(cache):
                    raise RuntimeError(f"no entries of a cache in {cache}")
                found = _answers(site, cache, processes)
                answers = sorted(set(found))
                right = answers == [_DISTANCES[version]]
                wrong += not right
                console.print(
                    f"wheel {version}, {state} cache, {processes} processes: {answers} m, "
                    f"{'right' if right else f'must be {_DISTANCES[version]}'}"
                )
    raise typer.Exit(code=1 if wrong else 0)


if __name__ == "__main__":
    run_command(main)
