"""Compare SMP with RRT-Connect in narrow places, on the same spheres of public arms."""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.atomic_files import write_text
from smp_planner.benchmark.options import chosen_names, run_command, tell
from smp_planner.experiments.narrow_places import (
    FAMILIES,
    METHODS,
    narrow_markdown,
    narrow_table,
    solve_narrow_places,
)
from smp_planner.experiments.public_arms import PUBLIC_ARMS


def main(
    arms: Annotated[str, typer.Option(help="Names, with commas between.")] = "ur5,panda",
    families: Annotated[str, typer.Option(help="Names, with commas between.")] = ",".join(FAMILIES),
    methods: Annotated[str, typer.Option(help="Names, with commas between.")] = ",".join(METHODS),
    problems: Annotated[int, typer.Option(min=1, max=1000, help="Of each family and arm.")] = 10,
    out: Annotated[Path, typer.Option(help="File of results.", dir_okay=False)] = Path(
        "results/narrow_places.json"
    ),
    jobs: Annotated[int, typer.Option(min=1, max=64, help="Worker processes.")] = 1,
) -> None:
    """Solve problems in shelves, cages, boxes, under tables and in a kitchen, and print a table.

    Beside the file of results, a table of all methods is written in Markdown, with the ending .md.
    The same command continues where it was ended. URDFs of ur5 and panda come with the extra
    `meshes`.

    Example: python scripts/narrow_places.py --arms ur5 --families cage,box --problems 5
    """
    written = out.with_suffix(".md")
    if written == out:
        raise typer.BadParameter(
            f"must not end in .md, which the table beside it does; got {str(out)!r}",
            param_hint="--out",
        )
    console = Console()
    chosen = chosen_names(arms, tuple(PUBLIC_ARMS), "--arms")
    places = chosen_names(families, tuple(FAMILIES), "--families")
    compared = chosen_names(methods, METHODS, "--methods")
    results = solve_narrow_places(chosen, places, compared, problems, out, console, jobs)
    console.print(narrow_table(results))
    write_text(written, narrow_markdown(results) + "\n")
    tell(f"wrote {written}")


if __name__ == "__main__":
    run_command(main)
