"""Compare rules for the width of the prior: left-out likelihood, and what plans come to."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.benchmark.options import (
    Jobs,
    Names,
    chosen_names,
    one_of,
    pooled,
    run_command,
    tuning_seeds,
)
from smp_planner.experiments.prior_rules import COLUMNS, RULES, cells_of, measure_rule
from smp_planner.experiments.tables import report


def main(
    out: Annotated[Path, typer.Option(help="Folder of the tables.", file_okay=False)] = Path(
        "results/prior_rules"
    ),
    tasks: Names = "",
    rules: Annotated[
        str, typer.Option(help=f"Of {', '.join(RULES)}, separated by commas. Default: all.")
    ] = "",
    difficulty: Annotated[str, typer.Option(help="Of the scenes.")] = "medium",
    scenes: Annotated[int, typer.Option(min=2, help="Of each task.")] = 12,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 79_400,
    jobs: Jobs = 1,
) -> None:
    """Plan with priors of several widths, in the same scenes, and write CSV, JSON and Markdown.

    Each demonstration is foretold from the others, too. Nothing is executed.

    Example: python scripts/prior_rules.py --tasks DrawS --rules "as set,Student-t" --jobs 2
    """
    one_of(difficulty, DIFFICULTIES, "--difficulty")
    cells = cells_of(
        chosen_names(tasks, TASKS, "--tasks"),
        chosen_names(rules, tuple(RULES), "--rules"),
        difficulty,
        tuning_seeds(seed, scenes),
    )
    rows = pooled(measure_rule, cells, "plans", Console(), jobs=jobs, chunk=scenes)
    note = (
        f"Mean ± standard deviation over {scenes} unselected scenes of difficulty {difficulty}, "
        f"seeds from {seed} on; one plan each without another try."
    )
    report(rows, ("task", "rule"), COLUMNS, out, "prior_rules", note)


if __name__ == "__main__":
    run_command(main)
