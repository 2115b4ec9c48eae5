"""The command ``smp-bench report``: results as one page of HTML, or as tables in Markdown."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from smp_planner.benchmark.cell_options import find_own_modules
from smp_planner.benchmark.options import Jobs, one_of, split_names

__all__ = ["report"]


def report(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER...",
            help="Folders that `run` wrote.",
            file_okay=False,
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="File to write. Default: standard output.", dir_okay=False)
    ] = None,
    form: Annotated[
        str,
        typer.Option("--format", help="html, or markdown: its tables, as for a README."),
    ] = "html",
    methods: Annotated[
        str,
        typer.Option(
            metavar="NAMES", help="Methods that it is of, separated by commas. Default: all."
        ),
    ] = "",
    pictures: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="Draw the particle sets of all methods on the first N scenes, played again.",
        ),
    ] = 0,
    videos: Annotated[
        int,
        typer.Option(
            min=0,
            metavar="N",
            help="Film the first success and the first N failures of each method, played again.",
        ),
    ] = 0,
    jobs: Jobs = 1,
) -> None:
    """Write what results say: the answer, tables with intervals, charts, failures.

    The page is one file that needs no network, for any width, in light and dark. Its first three
    sentences say which method succeeds most often, what is certain and what cannot be told.

    Example: [green]smp-bench report results/medium results/hard --out report.html[/green]
    """
    one_of(form, ("html", "markdown"), "--format")
    from smp_gym.atomic_files import write_text
    from smp_planner.benchmark.joined_results import join_results
    from smp_planner.benchmark.report.findings import find
    from smp_planner.benchmark.report.markdown import markdown
    from smp_planner.benchmark.report.media import take_media
    from smp_planner.benchmark.report.page import page
    from smp_planner.benchmark.report.training_costs import training_costs

    results = join_results(folders)
    findings = find(results, split_names(methods))
    if form == "markdown":
        if pictures or videos:
            raise typer.BadParameter("pictures and videos are of the format html")
        text = markdown(findings)
    else:
        find_own_modules()
        with Console(stderr=True).status("drawing pictures and videos"):
            taken = take_media(findings, results, pictures=pictures, videos=videos, jobs=jobs)
        tasks = list(dict.fromkeys(found.cell.task for found in findings.cells))
        training = training_costs([method.name for method in findings.methods], tasks)
        text = page(findings, taken, training)
    if out is None:
        typer.echo(text, nl=False)
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, text)
    Console(highlight=False).print(f"wrote {escape(str(out))}", soft_wrap=True)
