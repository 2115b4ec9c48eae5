"""The experiments on LASA handwriting: figures and tables in the manner of Sec. V-A, on any shape.

compare draws Fig. 1 and measures it, modulate draws Fig. 2, boxes fills Table I, and tune finds the
settings of the methods.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track

from smp_planner.adaptation import Stein
from smp_planner.experiments import boxes, comparison, modulation, tuning
from smp_planner.experiments.figures import draw_side_by_side
from smp_planner.experiments.lasa_scenes import (
    FIGURE_1,
    FIGURE_2A,
    FIGURE_2B,
    METHODS,
    TUNING_SCENES,
    LasaScene,
    Method,
    learn,
    settings,
)
from smp_planner.experiments.tables import Column, Row, print_table, summarise, write_tables
from smp_planner.library.smp import AnyOf, Circle, ViaPoint

app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, help=__doc__
)

_TITLES = {
    "promp": "ProMP",
    "smp": "SMP",
    "promp_diff": "ProMPs-Diff",
    "cpromp": "CProMPs",
    "prompt_o": "ProMPT-O",
}

_Particles = Annotated[int, typer.Option(min=1, help="Of each plan.")]
_Repetitions = Annotated[int, typer.Option(min=1, help="With seeds from 0.")]
_Out = Annotated[Path, typer.Option(help="Folder to write.")]
_Obstacles = Annotated[list[str] | None, typer.Option(help="Circle x,y,r in mm; repeatable.")]
_Vias = Annotated[
    list[str] | None,
    typer.Option(help="Via-point phase,x,y; repeatable, several of one phase are a choice."),
]
_Goal = Annotated[str | None, typer.Option(help="New end x,y in mm; by default as demonstrated.")]
_Modes = Annotated[
    int | None,
    typer.Option(min=1, help="Ways that were demonstrated; by default as the data has it."),
]


@app.command()
def compare(
    shape: Annotated[str, typer.Option(help="Of LASA, or several joined by '+'.")] = "Sshape",
    obstacle: _Obstacles = None,
    via: _Vias = None,
    goal: _Goal = None,
    modes: _Modes = None,
    method: Annotated[str, typer.Option(help="Methods, by comma.")] = ",".join(METHODS),
    particles: _Particles = 42,
    repetitions: _Repetitions = 20,
    out: _Out = Path("results/lasa/fig1"),
) -> None:
    """Adapt a shape by several methods and measure them; without options, Fig. 1.

    With the S and nothing else given, the obstacles are those of Fig. 1.
    """
    names = method.split(",")
    for name in names:
        if name not in METHODS:
            raise typer.BadParameter(f"method must be one of {', '.join(METHODS)}; got {name!r}")
    scene = _scene(shape, obstacle, via, goal, FIGURE_1)
    primitive = learn(scene.shape, modes=modes)
    reference = comparison.reference_of(primitive)
    rows: list[Row] = []
    panels = {}
    for seed in track(range(repetitions), "repetitions"):
        plans = {
            name: comparison.adapted(primitive, scene, METHODS[name], particles, seed)
            for name in names
        }
        rows.append(comparison.noise_floor_row(primitive, scene, reference, particles, seed))
        for name, plan in plans.items():
            measured = comparison.measure(plan.trajectories, primitive, scene, reference)
            rows.append({"method": name, "seed": seed, **measured})
            if seed == 0:
                panels[f"{_TITLES[name]}: {measured['free']:.0f} of {particles} free"] = (
                    plan.trajectories
                )
    draw_side_by_side(panels, primitive.demonstrations, scene, out / "paths.png")
    note = f"{particles} particles, {repetitions} repetitions; {_described(scene)}."
    _report(rows, ["method"], comparison.COLUMNS, out, "comparison", note)


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
    """
    scenes = {"a": FIGURE_2A, "b": FIGURE_2B}
    if shape:
        scenes = {shape: _scene(shape, obstacle, via, goal)}
    exact = settings()
    ways = {
        "exact": Method(Stein(), exact),
        "soft": Method(
            Stein(iterations=200), exact.model_copy(update={"modulation": "likelihood"})
        ),
    }
    rows: list[Row] = []
    panels, drawn = {}, []
    for name, scene in scenes.items():
        primitive = learn(scene.shape, modes=modes)
        for seed in track(range(repetitions), name):
            for way, method in ways.items():
                plan = comparison.adapted(primitive, scene, method, particles, seed)
                rows.append(modulation.modulation_row(name, way, scene, plan, seed))
                if seed == 0 and way == "exact":
                    panels[f"({name})"] = plan.trajectories
                    drawn.append(scene)
    draw_side_by_side(panels, primitive.demonstrations, drawn, out / "paths.png")
    scenes_text = "; ".join(f"{name}: {_described(scene)}" for name, scene in scenes.items())
    note = (
        f"{particles} particles, {repetitions} repetitions; within {modulation.TOLERANCE} mm a "
        f"via-point is passed and an end reached. {scenes_text}."
    )
    _report(rows, ["scene", "method"], modulation.COLUMNS, out, "modulation", note)


@app.command("boxes")
def boxes_command(
    particles: _Particles = 42,
    repetitions: _Repetitions = 20,
    out: _Out = Path("results/lasa/table1"),
) -> None:
    """Count starts and ends in their regions with and without the smooth box prior: Table I."""
    rows: list[Row] = []
    for scene in (FIGURE_1, FIGURE_2B):
        primitive, method = learn(scene.shape), Method(Stein(), settings())
        for seed in track(range(repetitions), scene.shape):
            rows += [
                boxes.box_row(prior, primitive, scene, method, particles, seed)
                for prior in boxes.PRIORS
            ]
    note = f"{particles} particles, {repetitions} repetitions."
    _report(rows, ["shape", "prior", "paper"], boxes.COLUMNS, out, "boxes", note)


@app.command()
def tune(
    method: Annotated[str, typer.Option(help="Methods, by comma.")] = ",".join(tuning.CANDIDATES),
    particles: _Particles = 42,
    repetitions: Annotated[int, typer.Option(min=1, help="In each tuning scene.")] = 3,
    out: _Out = Path("results/lasa/tuning"),
) -> None:
    """Try settings of each method on other scenes and seeds, and name the best."""
    console = Console()
    primitive = learn(TUNING_SCENES[0].shape)
    reference = comparison.reference_of(primitive)
    for name in method.split(","):
        if name not in tuning.CANDIDATES:
            known = ", ".join(tuning.CANDIDATES)
            raise typer.BadParameter(f"method must be one of {known}; got {name!r}")
        rows = [
            tuning.tuning_row(name, index, primitive, scene, reference, particles, seed)
            for index in track(range(len(tuning.CANDIDATES[name])), name)
            for scene in TUNING_SCENES
            for seed in range(tuning.FIRST_SEED, tuning.FIRST_SEED + repetitions)
        ]
        _report(rows, ["method", "candidate"], tuning.COLUMNS, out, name)
        summaries = summarise(rows, ["method", "candidate"])
        console.print(f"best: {summaries[tuning.best(summaries)]['candidate']}")


def main() -> None:
    """Run the commands; what they refuse is said in one line, with exit code 2."""
    try:
        app()
    except (ValueError, ModuleNotFoundError) as error:
        Console(stderr=True).print(f"error: {error}", style="bold red", markup=False)
        sys.exit(2)


def _scene(
    shape: str,
    obstacles: Sequence[str] | None,
    vias: Sequence[str] | None,
    goal: str | None,
    default: LasaScene | None = None,
) -> LasaScene:
    """Return the scene that options describe."""
    if default is not None and shape == default.shape and not (obstacles or vias or goal):
        return default
    choices: dict[float, list[ViaPoint]] = {}
    for phase, x, y in (_numbers("via", text, 3) for text in vias or ()):
        choices.setdefault(phase, []).append(ViaPoint(phase, np.array([x, y])))
    end = None if goal is None else _numbers("goal", goal, 2)
    return LasaScene(
        shape,
        tuple(
            Circle((x, y), radius)
            for x, y, radius in (_numbers("obstacle", text, 3) for text in obstacles or ())
        ),
        tuple(AnyOf(points) if len(points) > 1 else points[0] for points in choices.values()),
        None if end is None else (end[0], end[1]),
    )


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise typer.BadParameter(f"{option} must be {count} numbers joined by ',', got {text!r}")
    return numbers


def _described(scene: LasaScene) -> str:
    circles = [f"({o.center[0]:g}, {o.center[1]:g}) radius {o.radius:g}" for o in scene.obstacles]
    text = f"{scene.shape}, obstacles {', '.join(circles) or 'none'}"
    for wanted in scene.via_points:
        options = wanted.options if isinstance(wanted, AnyOf) else (wanted,)
        places = [
            f"({o.position[0]:g}, {o.position[1]:g}) at phase {o.phase:g}"
            for o in options
            if isinstance(o, ViaPoint)
        ]
        text += f", via-point {' or '.join(places)}"
    if scene.goal is not None:
        text += f", end ({scene.goal[0]:g}, {scene.goal[1]:g})"
    return text + "; mm"


def _report(
    rows: Sequence[Row],
    by: Sequence[str],
    columns: Sequence[Column],
    out: Path,
    name: str,
    note: str = "",
) -> None:
    console = Console()
    summaries = summarise(rows, by)
    print_table(console, summaries, columns)
    if note:
        console.print(note)
    write_tables(rows, summaries, columns, out, name, note)
    console.print(f"wrote {out}")


if __name__ == "__main__":
    main()
