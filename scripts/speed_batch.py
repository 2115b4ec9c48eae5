"""Measure planning of many scenes at once on one device.

First `prepare` writes problems where the environments are; `run` times them on a device, which
needs neither PyBullet nor the environments; `verify` checks the particles exactly.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

import itertools
import json
from pathlib import Path
from typing import Annotated

import torch
import typer
from rich.console import Console

from smp_gym.atomic_files import write_text
from smp_gym.scene import DIFFICULTIES, TASKS
from smp_planner.benchmark import batch_speed
from smp_planner.benchmark.options import CommandLine, one_of, tell, whole_numbers
from smp_planner.planners.primitive_planner import PrimitivePlanner

app = CommandLine(add_completion=False, help=__doc__)
Problems = Annotated[
    Path, typer.Option(help="File of problems, made by `prepare`.", exists=True, dir_okay=False)
]
_PROBLEMS = Path("results/problems.npz")


@app.command()
def prepare(
    out: Annotated[Path, typer.Option(help="File to write.", dir_okay=False)] = _PROBLEMS,
    task: Annotated[str, typer.Option(help="Name of the task.")] = "Placement",
    difficulty: Annotated[str, typer.Option(help="Of its scenes.")] = "hard",
    count: Annotated[int, typer.Option(min=1, help="Number of scenes.")] = 1024,
    seed: Annotated[int, typer.Option(min=0, help="Of the first scene.")] = 70_000,
) -> None:
    """Write the first observations of scenes.

    Example: python scripts/speed_batch.py prepare --count 64 --out results/problems.npz
    """
    one_of(task, TASKS, "--task")
    one_of(difficulty, DIFFICULTIES, "--difficulty")
    batch_speed.prepare(task, difficulty, count, seed, out)
    tell(f"{count} scenes of {task} in {out}, {out.stat().st_size / 1e6:.1f} MB")


@app.command()
def run(
    problems: Problems = _PROBLEMS,
    device: Annotated[str, typer.Option(help="cuda or cpu.")] = "cuda",
    sizes: Annotated[str, typer.Option(help="Numbers of scenes.")] = "1,16,64,256,1024",
    repeats: Annotated[int, typer.Option(min=1, help="Of each measurement.")] = 5,
    naive: Annotated[int, typer.Option(min=0, help="Most scenes of naive autograd.")] = 16,
    plans: Annotated[int, typer.Option(min=0, help="Most scenes of whole plans.")] = 64,
    keep: Annotated[int, typer.Option(min=1, help="Scenes whose particles are kept.")] = 256,
    out: Annotated[
        Path, typer.Option(help="Folder of rows and particles.", file_okay=False)
    ] = Path("results"),
) -> None:
    """Time descents, plans and gradients, and write rows and particles.

    Each row is printed as soon as it is measured. Times are medians of warm repeats, and beside
    them that of the first call, which compiles kernels and records the graph.

    Example: python scripts/speed_batch.py run --device cpu --sizes 1 --repeats 1 --out results
    """
    if not _is_here(device):
        raise typer.BadParameter(
            f"must be a device that is here, cpu or cuda; got {device!r}", param_hint="--device"
        )
    console, numbers = Console(width=200), whole_numbers(sizes, "--sizes")
    policy, given = batch_speed.read_problems(problems, max(*numbers, keep))
    planner = policy.planner
    assert isinstance(planner, PrimitivePlanner)
    batch = batch_speed.make_batch(planner, given)
    numbers = [size for size in numbers if size <= len(given)]
    name = torch.cuda.get_device_name(device) if device.startswith("cuda") else "processor"
    console.print(f"{name}, torch {torch.__version__}, {policy.task}, {len(given)} scenes")
    out.mkdir(parents=True, exist_ok=True)
    kept = min(keep, len(given))
    shares = batch_speed.write_particles(batch, device, kept, out / "particles.npz")
    first = {"measured": "particles", "scenes": kept, "good": float(shares.mean())}
    rows = itertools.chain(
        [first],
        batch_speed.plan_rows(batch, device, numbers, repeats, plans),
        batch_speed.iteration_rows(batch, device, numbers, naive, repeats),
    )
    text = ""
    for row in rows:
        console.print(row)
        text += json.dumps(row) + "\n"
        write_text(out / "speed_batch.jsonl", text)


def _is_here(device: str) -> bool:
    try:
        kind = torch.device(device).type
    except RuntimeError:
        return False
    return kind == "cpu" or (kind == "cuda" and torch.cuda.is_available())


@app.command()
def verify(
    problems: Problems = _PROBLEMS,
    particles: Annotated[
        Path, typer.Option(help="What `run` wrote.", exists=True, dir_okay=False)
    ] = Path("results/particles.npz"),
    count: Annotated[int, typer.Option(min=1, help="Number of scenes.")] = 256,
) -> None:
    """Check particles exactly, and compare with the device's check.

    Example: python scripts/speed_batch.py verify --count 16
    """
    policy, given = batch_speed.read_problems(problems, count)
    assert isinstance(policy.planner, PrimitivePlanner)
    exact, on_device = batch_speed.exact_shares(policy.planner, given, particles)
    Console().print(
        f"{len(exact)} scenes: good by the exact check {exact.mean():.4f}, by the device's "
        f"{on_device.mean():.4f}; equal {(exact == on_device).mean():.5f}; called good by the "
        f"device alone {(on_device & ~exact).mean():.5f}; scenes without a good one "
        f"{(~exact.any(axis=1)).sum()}"
    )


if __name__ == "__main__":
    app()
