"""Time and quality of whole plans, of several versions and settings side by side.

Every variant plans every scene in a process of its own, in turns: what else the machine does meets
all of them alike, so ratios hold on a busy machine too.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.registration import environment_id
from smp_gym.robot import kinematics
from smp_gym.robot.kinematics import SphereSet
from smp_gym.sampling import sample_scene
from smp_planner.benchmark import plan_worker
from smp_planner.benchmark.cost_speed import SPHERE_MARGIN, make_scene, make_trajectories
from smp_planner.benchmark.timing import median_time, timed
from smp_planner.collision.costs import CollisionCost, SelfCollisionCost
from smp_planner.collision.robot_model import RobotModel, jaco_model
from smp_planner.occupancy.grid import bake_analytic
from smp_planner.planners.primitive_planner import PrimitivePlanner
from smp_planner.planning.clock import Clock
from smp_planner.planning.replanning import resumed
from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = [
    "Measurement",
    "Variant",
    "busy_neighbours",
    "compared",
    "growth",
    "measure",
    "replans",
    "stages_table",
]

_RATE = 0.1
"""1/s, rate of the phase of an arm whose rest is planned anew."""


@dataclass(frozen=True)
class Variant:
    """One way to plan.

    Attributes:
        name: in tables.
        threads: of a plan.
        settings: of the planner by name, on top of the task's own; "method" is its name.
        path: folder of another version of the packages; None measures this one.
        busy: processes that compute besides.
    """

    name: str
    threads: int = 1
    settings: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None
    busy: int = 0


@dataclass(frozen=True)
class Measurement:
    """One plan.

    Attributes:
        variant: its name.
        task: of the scene.
        seed: of the scene.
        wall: s by the clock.
        cpu: s of all threads of the process.
        stages: s by the clock of each stage.
        good: share of the particles.
        solved: whether any particle is good.
        prior: mean over the good particles of half the squared distance to the prior; None if no
            particle is good, or there is no prior.
        modes: homotopy classes of the good particles.
    """

    variant: str
    task: str
    seed: int
    wall: float
    cpu: float
    stages: dict[str, float]
    good: float
    solved: bool
    prior: float | None
    modes: int


@contextmanager
def _process(path: Path | None) -> Iterator[subprocess.Popen[str]]:
    here = Path(__file__).resolve().parents[2] if path is None else path.resolve()
    environment = dict(os.environ, PYTHONPATH=str(here), OMP_NUM_THREADS="1")
    code = "import runpy, sys; runpy.run_path(sys.argv[1], run_name='__main__')"
    command = [sys.executable, "-c", code, str(Path(plan_worker.__file__).resolve())]
    process = subprocess.Popen(
        command,
        env=environment,
        cwd=here,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@contextmanager
def busy_neighbours(count: int) -> Iterator[None]:
    """Keep processes computing meanwhile."""
    code = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"
    processes = [subprocess.Popen([sys.executable, "-c", code]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _asked(process: subprocess.Popen[str], request: Mapping[str, Any]) -> dict[str, Any]:
    assert process.stdin is not None
    assert process.stdout is not None
    print(json.dumps(request), file=process.stdin, flush=True)
    line = process.stdout.readline()
    if not line:
        raise RuntimeError(f"the process that plans ended with {process.wait()} on {request}")
    return dict(json.loads(line))


def measure(
    task: str, difficulty: str, seeds: Sequence[int], variants: Sequence[Variant]
) -> list[Measurement]:
    """Return a measurement of each scene by each variant.

    Args:
        task: its name.
        difficulty: of the scenes.
        seeds: of the scenes.
        variants: of different names; each plans the first scene once more before, to warm up.

    Raises:
        RuntimeError: a process failed, for example because a version does not know the task.
    """
    found = []
    with ExitStack() as stack:
        by_path = {
            variant.path: stack.enter_context(_process(variant.path)) for variant in variants
        }
        for number, seed in enumerate([seeds[0], *seeds]):
            scene = sample_scene(task, difficulty, seed).to_json()
            for variant in variants:
                request = {
                    "task": task,
                    "scene": scene,
                    "settings": dict(variant.settings),
                    "threads": variant.threads,
                }
                with busy_neighbours(variant.busy):
                    answer = _asked(by_path[variant.path], request)
                if number:
                    answer.pop("chosen")
                    found.append(Measurement(variant.name, task, seed, **answer))
    return found


def _interval(differences: Sequence[float]) -> str:
    """Return the mean of paired differences with its 95 % interval."""
    values = np.asarray(differences, np.float64)
    if len(values) < 2:
        return "–"
    half = 1.96 * values.std(ddof=1) / np.sqrt(len(values))
    return f"{values.mean():+.3f} ± {half:.3f}"


def compared(found: Sequence[Measurement], reference: str) -> list[list[str]]:
    """Return rows of a table of variants against one of them, for each task.

    Times are medians with quartiles; ratios are medians over the scenes of this time over the
    reference's in the same scene.

    Args:
        found: of all variants in the same scenes.
        reference: name of a variant.
    """
    rows = [
        [
            "task",
            "variant",
            "scenes",
            "ms (quartiles)",
            "CPU ms",
            "of the reference",
            "CPU of the reference",
            "good",
            "paired difference",
            "½ d²",
            "paired difference",
            "solved",
        ]
    ]
    for task in dict.fromkeys(m.task for m in found):
        of_task = [m for m in found if m.task == task]
        base = {m.seed: m for m in of_task if m.variant == reference}
        for name in dict.fromkeys(m.variant for m in of_task):
            own = [m for m in of_task if m.variant == name]
            wall = 1e3 * np.array([m.wall for m in own])
            low, middle, high = np.percentile(wall, [25, 50, 75])
            pairs = [(m, base[m.seed]) for m in own if m.seed in base]
            ratio = np.median([m.wall / b.wall for m, b in pairs]) if pairs else np.nan
            cpu = np.median([m.cpu / b.cpu for m, b in pairs]) if pairs else np.nan
            priors = [m.prior for m in own if m.prior is not None]
            both = [
                m.prior - b.prior for m, b in pairs if m.prior is not None and b.prior is not None
            ]
            rows.append(
                [
                    task,
                    name,
                    str(len(own)),
                    f"{middle:.0f} ({low:.0f}–{high:.0f})",
                    f"{1e3 * np.median([m.cpu for m in own]):.0f}",
                    f"{ratio:.3f}",
                    f"{cpu:.3f}",
                    f"{np.mean([m.good for m in own]):.3f}",
                    _interval([m.good - b.good for m, b in pairs]),
                    f"{np.mean(priors):.2f}" if priors else "–",
                    _interval(both),
                    f"{sum(m.solved for m in own)}",
                ]
            )
    return rows


def stages_table(found: Sequence[Measurement]) -> list[list[str]]:
    """Return rows of a table of the median milliseconds of each stage."""
    stages = list(dict.fromkeys(stage for m in found for stage in m.stages))
    rows = [["task", "variant", *stages, "all"]]
    for task, name in dict.fromkeys((m.task, m.variant) for m in found):
        own = [m for m in found if (m.task, m.variant) == (task, name)]
        medians = [np.median([m.stages.get(stage, 0.0) for m in own]) for stage in stages]
        total = np.median([m.wall for m in own])
        rows.append([task, name, *(f"{1e3 * value:.0f}" for value in (*medians, total))])
    return rows


def replans(tasks: Iterable[str], difficulty: str, seeds: Sequence[int]) -> list[list[str]]:
    """Return rows of a table of what planning anew takes beside the first plan, on one thread.

    In the middle of the best trajectory of each scene the rest is planned anew, the arm in motion
    and the obstacles, which stand, where they were. Their map is kept, as during an execution.

    Args:
        tasks: names.
        difficulty: of the scenes.
        seeds: of the scenes of each task.
    """
    rows = [["task", "scenes", "plan, ms", "anew, ms", "ratio"]]
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        for task in tasks:
            policy = PlannerPolicy.make("smp", task)
            planner = policy.planner
            assert isinstance(planner, PrimitivePlanner)
            environment = gymnasium.make(environment_id(task), difficulty=difficulty)
            first, anew = [], []
            for seed in seeds:
                problem = policy.problem(environment.reset(seed=seed)[0])
                seconds, (plan,) = timed(planner.plan, [problem])
                first.append(seconds)
                clock = Clock(phase=0.5, rate=_RATE)
                rest = resumed(problem, plan.best, clock, problem.movable)
                planner.replan(plan, rest)
                anew.append(timed(planner.replan, plan, rest)[0])
            environment.close()
            # The first scene may compile.
            times = 1e3 * np.array([first, anew])[:, 1:]
            ratio = np.median(times[1] / times[0])
            shown = (f"{value:.0f}" for value in np.median(times, axis=1))
            rows.append([task, str(times.shape[1]), *shown, f"{ratio:.2f}"])
    finally:
        torch.set_num_threads(before)
    return rows


def growth(repeats: int = 20, seed: int = 0) -> list[list[str]]:
    """Return rows of a table of the time of all costs of a set, on one thread.

    From 42 particles, 50 steps, the arm's own spheres and six boxes, one number at a time is
    changed.

    Args:
        repeats: calls of which the median is taken.
        seed: of scene and trajectories.
    """
    usual = {"particles": 42, "steps": 50, "spheres": 1, "obstacles": 6}
    changes = {
        "particles": (10, 42, 100, 300, 1000),
        "steps": (25, 50, 100, 200),
        "spheres": (1, 2, 4),
        "obstacles": (1, 6, 16),
    }
    rows = [["what grows", "to", "map, ms", "the arm itself, ms"]]
    for name, values in changes.items():
        for value in values:
            numbers = {**usual, name: value}
            rng = np.random.default_rng(seed)
            scene = make_scene(numbers["obstacles"], rng)
            robot = _finer(jaco_model(kinematics.finger_spheres(np.zeros(4))), numbers["spheres"])
            q = make_trajectories(robot, numbers["particles"], numbers["steps"], rng)
            collision, own = CollisionCost(robot, bake_analytic(scene)), SelfCollisionCost(robot)
            shown = str(len(robot.link)) if name == "spheres" else str(value)
            times = (
                median_time(partial(collision, q, 0.02, SPHERE_MARGIN), repeats),
                median_time(partial(own, q), repeats),
            )
            rows.append([name, shown, *(f"{1e3 * seconds:.2f}" for seconds in times)])
    return rows


def _finer(robot: RobotModel, times: int) -> RobotModel:
    """Return a robot with each sphere so many times over, and the pairs of all copies."""
    count, copies = len(robot.link), np.arange(times)
    spheres = SphereSet(
        np.tile(robot.link, times), np.tile(robot.center, (times, 1)), np.tile(robot.radius, times)
    )
    offsets = count * np.stack(np.meshgrid(copies, copies), axis=-1).reshape(-1, 1, 2)
    pairs = (robot.collision_pairs[None] + offsets).reshape(-1, 2)
    return replace(robot, spheres=spheres, collision_pairs=pairs)
