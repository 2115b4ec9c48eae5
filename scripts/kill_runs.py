"""Kill runs, tables, trainings and saving at random moments, and print what came of it."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script("rl", "dev")

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import torch
import typer
from rich.console import Console

from smp_planner.benchmark import worker_pool
from smp_planner.benchmark.options import Jobs, Names, chosen_names, run_command
from smp_planner.experiments.kills import repeated_saves, resumed_results, resumed_trainings
from smp_planner.experiments.kills.killing import FAULTS, KILLS, Work, killed_at_random
from smp_planner.experiments.outcomes import print_outcomes

Make = Callable[[Path, int], Work]

WORKS: dict[str, Make] = {
    "run": lambda folder, jobs: resumed_results.run(jobs),
    "table": lambda folder, jobs: resumed_results.table(jobs),
    "kept": lambda folder, jobs: resumed_results.kept_scenes(jobs),
    "sac": lambda folder, jobs: resumed_trainings.reinforcement_learning(),
    "mp_rl": lambda folder, jobs: resumed_trainings.policy_search(),
    "saving": lambda folder, jobs: repeated_saves.saving(folder),
}
"""Kinds of work, each made in a folder of its own for a number of worker processes."""


def main(
    kills: Annotated[int, typer.Option(min=1, help="How many, over all kinds.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Of the moments and of what is killed.")] = 0,
    kinds: Names = "",
    jobs: Jobs = 2,
) -> None:
    """Kill work of each kind (SIGKILL), itself or one of its workers, go on in its folder, repeat.

    Counted are kills, and faults: going on fails, a file is half-written, what was kept is lost,
    the end is another than that of undisturbed work, a process outlives its work by 5 s. The exit
    status is 1 if there is one. Work is forked from this process, which has all modules and kernels
    already, so that most kills come while it computes and writes.

    Example: python scripts/kill_runs.py --kills 100 --kinds run,saving --jobs 2
    """
    chosen = chosen_names(kinds, tuple(WORKS), "--kinds")
    console = Console(highlight=False)
    report = partial(console.print, markup=False)
    # A process that is forked has no other threads.
    torch.set_num_threads(1)
    worker_pool.START = "fork"
    outcomes = {}
    with TemporaryDirectory() as name:
        for number, kind in enumerate(chosen):
            share = kills // len(chosen) + (number < kills % len(chosen))
            folder = Path(name, kind)
            folder.mkdir()
            rng = np.random.default_rng([seed, list(WORKS).index(kind)])
            work = WORKS[kind](folder / "given", jobs)
            outcomes[work.kind] = killed_at_random(work, folder, share, rng, report)
            console.print(f"{work.kind}: {dict(outcomes[work.kind])}")
    total = print_outcomes(console, outcomes, (KILLS, *FAULTS), "kind", f"{kills} kills")
    if sum(total[fault] for fault in FAULTS):
        raise typer.Exit(1)


if __name__ == "__main__":
    run_command(main)
