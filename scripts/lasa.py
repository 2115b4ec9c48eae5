"""The experiments on LASA handwriting: figures and tables in the manner of Sec. V-A, on any shape.

compare draws Fig. 1 and measures it, modulate draws Fig. 2, boxes fills Table I, and tune finds the
settings of the methods. shapes puts large obstacles before all shapes. posterior holds settings of
SVGD against the exact posterior.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from smp_gym.datasets import lasa
from smp_planner.benchmark.options import CommandLine, Names, chosen_names
from smp_planner.experiments import boxes, comparison, lasa_modulation, lasa_shapes, tuning
from smp_planner.experiments.lasa_posterior import (
    VARIANTS,
    Ground,
    settings_columns,
    settings_rows,
)
from smp_planner.experiments.lasa_scenes import (
    FIGURE_1,
    FIGURE_2A,
    FIGURE_2B,
    LASA_METHODS,
    described,
    scene_of,
)
from smp_planner.experiments.tables import report
from smp_planner.inference import SETTINGS
from smp_planner.inference.smc import SMCSettings

app = CommandLine(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, help=__doc__
)

_Particles = Annotated[int, typer.Option(min=1, help="Of each plan.")]
_Repetitions = Annotated[int, typer.Option(min=1, help="With seeds from 0.")]
_Out = Annotated[Path, typer.Option(help="Folder to write.", file_okay=False)]
_Obstacles = Annotated[list[str] | None, typer.Option(help="Circle x,y,r in mm; repeatable.")]
_Vias = Annotated[
    list[str] | None,
    typer.Option(help="Via-point phase,x,y; repeatable, several of one phase are a choice."),
]
_Goal = Annotated[str | None, typer.Option(help="New end x,y in mm; by default as demonstrated.")]
_Modes = Annotated[
    int | None,
    typer.Option(min=1, help="Number of demonstrated modes; by default as the data has it."),
]


@app.command()
def compare(
    shape: Annotated[str, typer.Option(help="Of LASA, or several joined by '+'.")] = "Sshape",
    obstacle: _Obstacles = None,
    via: _Vias = None,
    goal: _Goal = None,
    modes: _Modes = None,
    method: Names = "",
    particles: _Particles = 42,
    repetitions: _Repetitions = 20,
    out: _Out = Path("results/lasa/fig1"),
) -> None:
    """Adapt a shape by several methods and measure them; without options, Fig. 1.

    With the S and nothing else given, the obstacles are those of Fig. 1.

    Example: python scripts/lasa.py compare --shape GShape --obstacle=-20,0,2 --method smp,cpromp
    """
    scene = scene_of(shape, obstacle, via, goal, FIGURE_1)
    methods = {
        name: LASA_METHODS[name] for name in chosen_names(method, tuple(LASA_METHODS), "--method")
    }
    rows = comparison.compare(scene, methods, particles, repetitions, out / "paths.png", modes)
    note = f"{particles} particles, {repetitions} repetitions; {described(scene)}."
    report(rows, ["method"], comparison.COLUMNS, out, "comparison", note)


@app.command()
def modulate(
    shape: Annotated[str, typer.Option(help="Of LASA, or several joined by '+'.")] = "",
    obstacle: _Obstacles = None,
    via: _Vias = None,
    goal: _Goal = None,
    modes: _Modes = None,
    particles: _Particles = 42,
    repetitions: _Repetitions = 20,
    out: _Out = Path("results/lasa/fig2"),
) -> None:
    """Adapt a shape to a new end, via-points and obstacles by SMP; without options, Fig. 2.

    Ends and via-points are conditioned on ("exact"), or left to their costs as in the paper
    ("soft"), which takes twice the iterations.

    Example: python scripts/lasa.py modulate --shape Sshape --via 0.5,20,25 --goal 5,-5
    """
    if not shape and (obstacle or via or goal):
        raise typer.BadParameter(
            f"--obstacle, --via and --goal need it, got {obstacle or via or goal!r} without",
            param_hint="--shape",
        )
    scenes = {"a": FIGURE_2A, "b": FIGURE_2B}
    if shape:
        scenes = {shape: scene_of(shape, obstacle, via, goal)}
    rows = lasa_modulation.modulate(scenes, particles, repetitions, out / "paths.png", modes)
    scenes_text = "; ".join(f"{name}: {described(scene)}" for name, scene in scenes.items())
    note = (
        f"{particles} particles, {repetitions} repetitions; "
        f"within {lasa_modulation.POINT_TOLERANCE} mm "
        f"a via-point is passed and an end reached. {scenes_text}."
    )
    report(rows, ["scene", "method"], lasa_modulation.COLUMNS, out, "modulation", note)


@app.command("boxes")
def boxes_command(
    particles: _Particles = 42,
    repetitions: _Repetitions = 20,
    out: _Out = Path("results/lasa/table1"),
) -> None:
    """Count starts and ends in their regions with and without the smooth box prior: Table I.

    Example: python scripts/lasa.py boxes --repetitions 5
    """
    rows = boxes.box_rows(particles, repetitions)
    note = f"{particles} particles, {repetitions} repetitions."
    report(rows, ["shape", "prior", "paper"], boxes.COLUMNS, out, "boxes", note)


@app.command()
def tune(
    method: Names = "",
    particles: _Particles = 42,
    repetitions: Annotated[int, typer.Option(min=1, help="In each tuning scene.")] = 3,
    out: _Out = Path("results/lasa/tuning"),
) -> None:
    """Try settings of each method on other scenes and seeds, and name the best.

    Example: python scripts/lasa.py tune --method smp --repetitions 1
    """
    for name in chosen_names(method, tuple(tuning.CANDIDATES), "--method"):
        rows = tuning.tuning_rows(name, particles, repetitions)
        summaries = report(rows, ["method", "candidate"], tuning.COLUMNS, out, name)
        Console().print(f"best: {summaries[tuning.best(summaries)]['candidate']}")


@app.command()
def shapes(
    shape: Annotated[str, typer.Option(help="Of LASA, with commas between. Default: all.")] = "",
    method: Annotated[
        str, typer.Option(help=f"Of {', '.join(lasa_shapes.METHODS)}. Default: all.")
    ] = "",
    scenes: Annotated[int, typer.Option(min=1, help="Of each shape, with seeds from 0.")] = 3,
    particles: _Particles = 42,
    out: _Out = Path("results/lasa/shapes"),
) -> None:
    """Put two circles of 5 to 8 mm across every shape, and adapt it by each method.

    Methods have the library's settings, or those that "tune" found on the S.

    Example: python scripts/lasa.py shapes --shape GShape,Worm --method smp,cpromp
    """
    chosen = chosen_names(method, tuple(lasa_shapes.METHODS), "--method")
    rows = lasa_shapes.shapes_rows(
        chosen_names(shape, lasa.shape_names(), "--shape"),
        {name: lasa_shapes.METHODS[name] for name in chosen},
        scenes,
        particles,
    )
    note = f"{particles} particles, {scenes} scenes of each shape, none left out."
    report(rows, ["method"], lasa_shapes.COLUMNS, out, "shapes", note)


@app.command()
def posterior(
    variant: Annotated[
        str, typer.Option(help=f"Scenes, of {', '.join(VARIANTS)}. Default: all.")
    ] = "",
    settings: Annotated[
        str, typer.Option(help=f"Settings, of {', '.join(SETTINGS)}. Default: all.")
    ] = "",
    particles: Annotated[int, typer.Option(min=2, help="Of each set.")] = 42,
    repetitions: Annotated[int, typer.Option(min=1, help="Of each setting.")] = 20,
    reference_particles: Annotated[int, typer.Option(min=2, help="Of each reference run.")] = 2000,
    reference_runs: Annotated[int, typer.Option(min=1, help="Of the reference.")] = 10,
    out: _Out = Path("results/lasa/posterior"),
) -> None:
    """Hold settings of SVGD against the exact posterior, which sequential Monte Carlo draws from.

    Written is a table for each scene: CSV of all rows, JSON and Markdown of means and spreads.

    All scenes together take about ten minutes of one core.

    Example: python scripts/lasa.py posterior --variant fig1 --settings tempered,paper
    """
    chosen = chosen_names(settings, tuple(SETTINGS), "--settings")
    for name in chosen_names(variant, tuple(VARIANTS), "--variant"):
        with Console().status(f"{name}: drawing from the exact posterior"):
            ground = Ground.of(
                VARIANTS[name], reference_runs, SMCSettings(reference_particles, last_moves=100)
            )
        rows = settings_rows(ground, chosen, particles, repetitions, name)
        note = (
            f"{particles} particles, {repetitions} repetitions; the posterior by {reference_runs} "
            f"runs of {reference_particles} particles."
        )
        report(rows, ["setting"], settings_columns(ground), out, name, note, name)


if __name__ == "__main__":
    app()
