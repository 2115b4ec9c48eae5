"""Ship a trained agent: write it where its method looks for it, and put its scores on its card."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer

from smp_planner.agents.shipping import ship_agent
from smp_planner.benchmark.options import run_command, tell


def main(
    source: Annotated[
        Path,
        typer.Argument(
            help="Card of a trained or a shipped agent, or the folder of scripts/train_agent.py, "
            "whose final.zip is read: it runs what that holds, pickled.",
            exists=True,
        ),
    ],
    results: Annotated[
        Path | None,
        typer.Option(
            help="Folder of smp-bench run with its episodes.", exists=True, file_okay=False
        ),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(help="To write into. Default: envs_assets/agents/.", file_okay=False),
    ] = None,
) -> None:
    """Write card and weights of SOURCE into the package, with the success that RESULTS hold.

    Example: python scripts/ship_agent.py results/agents/mp_rl-Placement-medium-0/agent.json
    """
    try:
        written = ship_agent(source, results, folder)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    tell(f"wrote {written}")


if __name__ == "__main__":
    run_command(main)
