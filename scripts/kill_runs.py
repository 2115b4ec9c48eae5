"""Kill runs of the benchmark at random moments, and compare their rows with undisturbed ones."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import psutil
import typer
from rich.console import Console

from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import read_results
from smp_planner.benchmark.options import run_command
from smp_planner.benchmark.results_folder import RESULTS, ResultsError

_COMMAND = "from smp_planner.benchmark.cli import app; app()"
_TIMES: dict[str, Any] = {
    "replanning_time": 0.0,
    "planning_time": 0.0,
    "episode_time": 0.0,
    "stage_times": {},
}
_PATIENCE = 5.0


def main(
    kills: Annotated[int, typer.Option(min=1, help="How many.")] = 50,
    seed: Annotated[int, typer.Option(min=0, help="Of the moments and of what is killed.")] = 0,
    episodes: Annotated[int, typer.Option(min=1, help="Of the run, of seeds from 0 on.")] = 12,
    methods: Annotated[str, typer.Option(help="Separated by commas.")] = "promp",
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes of the run.")] = 1,
    backend: Annotated[str, typer.Option(help="Of the workers.")] = "",
) -> None:
    """Kill the command or one of its workers (SIGKILL), go on in the same folder, and so on.

    A run that is complete is compared, and begun anew until there have been so many kills. The exit
    status is 1 if a row differs, is lost or is doubled, or a process outlives its run by 5 s.

    Example: python scripts/kill_runs.py --kills 50 --jobs 2
    """
    rng = np.random.default_rng(seed)
    options = ["--methods", methods, "--episodes", str(episodes), "--jobs", str(jobs)]
    options += ["--difficulty", "none", "--no-figure", "--no-video"]
    options += ["--backend", backend] if backend else []
    console = Console(highlight=False)
    with TemporaryDirectory() as name:
        folder = Path(name)
        began = time.monotonic()
        _start(folder / "whole", options).wait()
        longest = time.monotonic() - began
        wanted = _rows(folder / "whole")
        console.print(f"undisturbed: {len(wanted)} rows in {longest:.0f} s")
        done = runs = left = 0
        kept: list[EpisodeRow] = []
        while done < kills:
            out = folder / f"run{runs}"
            process = _start(out, options)
            killed, workers = _kill_later(process, float(rng.uniform(0.0, longest)), rng)
            done += bool(killed)
            left += len(psutil.wait_procs(workers, _PATIENCE)[1])
            before, kept = kept, _rows(out)
            if [row for row in before if row not in kept]:
                raise SystemExit(f"after {done} kills: {len(before)} rows before, {len(kept)} now")
            complete = len(kept) == len(wanted)
            console.print(f"{done}: {killed or 'ended by itself'}, {len(kept)} rows")
            if complete or done == kills:
                _start(out, options).wait()
                if _rows(out) != wanted:
                    raise SystemExit(f"after {done} kills: {out} has other rows")
                runs, kept = runs + 1, []
        console.print(
            f"{done} kills, {runs} runs with the undisturbed one's rows, {left} left over"
        )
        if left:
            raise SystemExit(1)


def _start(out: Path, options: list[str]) -> subprocess.Popen[bytes]:
    arguments = [sys.executable, "-c", _COMMAND, "run", "--out", str(out), *options]
    return subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _kill_later(
    process: subprocess.Popen[bytes], seconds: float, rng: np.random.Generator
) -> tuple[str, list[psutil.Process]]:
    """Kill a run or a worker of it after a time.

    Returns:
        Which was killed, or nothing if the run ended before; and the workers.
    """
    try:
        process.wait(seconds)
        return "", []
    except subprocess.TimeoutExpired:
        pass
    command = psutil.Process(process.pid)
    workers = command.children(recursive=True)
    victim = command
    if workers and rng.random() < 0.5:
        victim = workers[int(rng.integers(len(workers)))]
    victim.send_signal(signal.SIGKILL)
    process.wait()
    name = "the command" if victim is command else "a worker"
    return f"{name} killed after {seconds:.1f} s", workers


def _rows(folder: Path) -> list[EpisodeRow]:
    """Return the rows of a folder without times, sorted; none where there is no file yet."""
    try:
        rows = read_results(folder)[1] if (folder / RESULTS).exists() else []
    except ResultsError as error:
        if "no results yet" not in str(error):
            raise
        rows = []
    return sorted((replace(row, **_TIMES) for row in rows), key=lambda row: row.key)


if __name__ == "__main__":
    run_command(main)
