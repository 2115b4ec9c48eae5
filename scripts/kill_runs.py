"""Kill runs of the benchmark at random moments, and compare their rows with undisturbed ones."""

from __future__ import annotations

import os
import signal
import time
import traceback
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import psutil
import typer
from rich.console import Console

from smp_gym.suites import Cell
from smp_planner.benchmark import runner, worker_pool
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import Manifest, make_manifest, read_results
from smp_planner.benchmark.options import run_command, split_names
from smp_planner.benchmark.results_folder import ResultsError

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
    episodes: Annotated[int, typer.Option(min=1, help="Of a run, of seeds from 0 on.")] = 12,
    methods: Annotated[str, typer.Option(help="Separated by commas.")] = "promp",
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes of a run.")] = 2,
) -> None:
    """Kill a run's main process or one of its workers (SIGKILL), go on in the same folder, repeat.

    A run that is complete is compared, and begun anew until there have been so many kills. The exit
    status is 1 if a row differs, is lost or is doubled, or a process outlives its run by 5 s. Main
    process and workers are forked from this process, which has all modules and kernels already, so
    that most kills come while episodes are played and kept.

    Example: python scripts/kill_runs.py --kills 50 --jobs 2
    """
    rng = np.random.default_rng(seed)
    console = Console(highlight=False)
    manifest = make_manifest([Cell("Placement", "none")], split_names(methods), 0, episodes)
    for key in manifest.first_keys():
        manifest.player(key)
    worker_pool.START = "fork"
    with TemporaryDirectory() as name:
        began = time.monotonic()
        _wait(_start(manifest, Path(name, "whole"), jobs))
        longest = time.monotonic() - began
        wanted = _rows(Path(name, "whole"))
        console.print(f"undisturbed: {len(wanted)} rows in {longest:.1f} s")
        if len(wanted) != len(manifest.episode_keys()):
            raise SystemExit(1)
        done = runs = left = 0
        kept: list[EpisodeRow] = []
        while done < kills:
            out = Path(name, str(runs))
            run = _start(manifest, out, jobs)
            rest = longest * (1.0 - len(kept) / len(wanted))
            victim, workers = _kill_after(run, float(rng.uniform(0.0, rest)), rng)
            done += bool(victim)
            left += len(psutil.wait_procs(workers, _PATIENCE)[1])
            before, kept = kept, _rows(out)
            if [row for row in before if row not in kept]:
                raise SystemExit(f"after {done} kills: {len(before)} rows before, {len(kept)} now")
            console.print(f"{done}: {victim or 'ended by itself'}, {len(kept)} rows")
            if len(kept) == len(wanted) or done == kills:
                _wait(_start(manifest, out, jobs))
                if _rows(out) != wanted:
                    raise SystemExit(f"after {done} kills: {out} has other rows")
                runs, kept = runs + 1, []
        console.print(f"{done} kills, {runs} runs with equal rows, {left} left over")
    if left:
        raise SystemExit(1)


def _start(manifest: Manifest, out: Path, jobs: int) -> int:
    """Begin a run, or go on with it, in a process of its own, and return that."""
    child = os.fork()
    if child:
        return child
    # As a spawned worker has it: a pool ends the rest of its workers in this manner.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        runner.run(manifest, out, jobs=jobs)
    except runner.WorkerDiedError:
        os._exit(2)
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


def _wait(run: int, seconds: float = float("inf")) -> bool:
    """Wait for a run and return whether it has ended in time.

    Raises:
        SystemExit: by another error than the death of a worker.
    """
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        ended, status = os.waitpid(run, os.WNOHANG)
        if ended:
            if os.waitstatus_to_exitcode(status) == 1:
                raise SystemExit("a run failed")
            return True
        time.sleep(0.005)
    return False


def _kill_after(
    run: int, seconds: float, rng: np.random.Generator
) -> tuple[str, list[psutil.Process]]:
    """Kill a run or a worker of it after a time.

    Returns:
        Which was killed, or nothing if the run ended before; and the workers.
    """
    if _wait(run, seconds):
        return "", []
    workers = psutil.Process(run).children(recursive=True)
    victim = run
    if workers and rng.random() < 0.5:
        victim = workers[int(rng.integers(len(workers)))].pid
    os.kill(victim, signal.SIGKILL)
    _wait(run)
    name = "the main process" if victim == run else "a worker"
    return f"{name} killed after {seconds:.2f} s", workers


def _rows(folder: Path) -> list[EpisodeRow]:
    """Return the rows of a folder without times, sorted; none where nothing was written yet."""
    try:
        rows = read_results(folder)[1]
    except ResultsError as error:
        if "holds no results" not in str(error):
            raise
        rows = []
    return sorted((replace(row, **_TIMES) for row in rows), key=lambda row: row.key)


if __name__ == "__main__":
    run_command(main)
