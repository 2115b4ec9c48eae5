"""Run time of batches of problems on one device, and the check of what comes out.

Problems are prepared where the environments are, as a file of first observations; to plan them,
neither PyBullet nor the environments are needed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import BoolArray, FloatArray
from smp_gym.atomic_files import replacing
from smp_gym.untrusted_files import read_arrays, read_file
from smp_planner.adaptation.stein import SteinSettings
from smp_planner.batch.descent import PathRuns, Work
from smp_planner.batch.plain_costs import PlainCosts
from smp_planner.batch.planning import DevicePlanner, run_of
from smp_planner.batch.problem_tables import Tables
from smp_planner.planners.primitive_planner import PrimitivePlanner
from smp_planner.planning.assessment import assess
from smp_planner.planning.conditioning import conditioned_parts
from smp_planner.planning.problem import Problem
from smp_planner.policy.planner_policy import PlannerPolicy
from smp_planner.torch_threads import one_thread

__all__ = [
    "Batch",
    "exact_shares",
    "iteration_rows",
    "make_batch",
    "plan_rows",
    "prepare",
    "read_problems",
    "write_particles",
]


@dataclass(frozen=True, eq=False)
class Batch:
    """Problems with draws of their conditioned primitives, ready to be adapted on a device.

    Each problem has K parts with equally many draws, which are runs of their own.

    Attributes:
        planner: what learned the prior.
        problems: B problems.
        mean: (B*K, W) of the conditioned primitives' weights, problem by problem.
        factor: (B*K, W, r).
        latent: (B*K, N, r) draws in whitened coordinates.
        seconds: how long conditioning took, on the processor.
    """

    planner: PrimitivePlanner
    problems: list[Problem]
    mean: Tensor
    factor: Tensor
    latent: Tensor
    seconds: float

    @property
    def parts(self) -> int:
        """K."""
        return len(self.mean) // len(self.problems)

    @property
    def run(self) -> Work:
        """The run of particles that the planner's settings describe."""
        settings = self.planner.adaptation.settings
        assert isinstance(settings, SteinSettings)
        return run_of(settings, self.planner.plan_settings.particles // self.parts)

    def first(self, count: int) -> Batch:
        """Return the first problems."""
        runs = count * self.parts
        return Batch(
            self.planner,
            self.problems[:count],
            self.mean[:runs],
            self.factor[:runs],
            self.latent[:runs],
            self.seconds * count / len(self.problems),
        )

    def runs(self, steps: int, device: torch.device) -> PathRuns:
        """Return the runs on a device, in float32."""
        basis = self.planner.prior.single.basis
        mean, factor = self.mean.to(device), self.factor.to(device)
        return PathRuns.of_factors(basis, mean, factor, steps, torch.float32)

    def tables_of(self, tables: Tables) -> Tables:
        """Return the tables of each run, from those of the problems."""
        return tables.of_problems([n for n in range(len(self.problems)) for _ in range(self.parts)])

    def weights(self, latent: Tensor) -> Tensor:
        """Return the weights (B, P, W), float64, of whitened particles (B*K, P/K, r)."""
        device = latent.device
        factor = self.factor.to(device)
        weights = self.mean.to(device)[:, None] + latent.double() @ factor.mT
        return weights.unflatten(0, (-1, self.parts)).flatten(1, 2)


def prepare(task: str, difficulty: str, count: int, first_seed: int, path: Path) -> None:
    """Write the first observations of scenes, as arrays without pickle.

    Args:
        task: name of the task.
        difficulty: of its scenes.
        count: how many scenes.
        first_seed: of the first; the others follow.
        path: of the `.npz` file.
    """
    import gymnasium

    env = gymnasium.make(f"smp_gym/{task}-v0", difficulty=difficulty)
    seen = [env.reset(seed=first_seed + index)[0] for index in range(count)]
    env.close()
    columns: dict[str, Any] = {
        f"observation/{key}": np.stack([one[key] for one in seen]) for key in seen[0]
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as aside:
        np.savez_compressed(aside, task=np.array(task), **columns)


def read_problems(path: Path, count: int | None = None) -> tuple[PlannerPolicy, list[Problem]]:
    """Return the policy of a file's task, and the problems of its observations.

    Args:
        path: what `prepare` wrote.
        count: of problems; None reads all.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no such file.
    """
    data, prefix = read_arrays(read_file(path), str(path)), "observation/"
    columns = {k.removeprefix(prefix): data[k] for k in data if k.startswith(prefix)}
    if "task" not in data or not columns:
        raise ValueError(f"{path} must hold a task and observations, as `prepare` writes them")
    policy = PlannerPolicy.make("smp", str(data["task"]))
    number = len(next(iter(columns.values())))
    rows = range(number if count is None else min(count, number))
    return policy, [policy.problem({k: c[row] for k, c in columns.items()}) for row in rows]


def make_batch(planner: PrimitivePlanner, problems: Sequence[Problem]) -> Batch:
    """Return the batch of problems, whose draws must be shared out evenly among their parts."""
    settings, stein = planner.plan_settings, planner.adaptation.settings
    assert isinstance(stein, SteinSettings)
    drawn = settings.model_copy(update={"particles": stein.overdraw * settings.particles})
    begin = time.perf_counter()
    with one_thread():
        parts = [conditioned_parts(planner.prior, p, drawn) for p in problems]
    seconds = time.perf_counter() - begin
    count = len(parts[0])
    runs = [part for of_problem in parts for part in of_problem]
    if len({part.latent.shape for part in runs}) > 1 or settings.particles % count:
        raise ValueError("problems must be of a task whose parts have equally many particles")
    return Batch(
        planner,
        list(problems),
        torch.stack([part.primitive.mean for part in runs]),
        torch.stack([part.primitive.factor for part in runs]),
        torch.stack([part.latent for part in runs]),
        seconds,
    )


def _synchronized(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def _seconds(call: Callable[[], Any], device: torch.device, repeats: int) -> tuple[float, float]:
    """Return the seconds of the first call, and the median of later ones."""
    taken = []
    for _ in range(repeats + 1):
        _synchronized(device)
        begin = time.perf_counter()
        call()
        _synchronized(device)
        taken.append(time.perf_counter() - begin)
    return taken[0], float(np.median(taken[1:])) if repeats else taken[0]


def _peak(device: torch.device) -> float:
    return torch.cuda.max_memory_allocated(device) / 2**30 if device.type == "cuda" else 0.0


def plan_rows(
    batch: Batch, device: str, sizes: Sequence[int], repeats: int, plans: int
) -> Iterator[dict[str, Any]]:
    """Yield the run times of whole descents and plans, and the share of good particles.

    Args:
        batch: of as many problems as the largest size.
        device: name.
        sizes: B.
        repeats: of each warm measurement.
        plans: largest B for which whole plans are timed, conditioning and all.
    """
    settings = batch.planner.plan_settings
    where = DevicePlanner.of(device).device
    for graph in (True, False) if where.type == "cuda" else (False,):
        work = DevicePlanner.of(device)
        work.graph = graph
        for size in sizes:
            part = batch.first(size)
            begin = time.perf_counter()
            tables = work.tables(part.problems, settings, settings.planning_steps)
            _synchronized(where)
            packing = time.perf_counter() - begin
            runs, of_runs = part.runs(tables.steps, where), part.tables_of(tables)
            if where.type == "cuda":
                torch.cuda.reset_peak_memory_stats(where)
            found = [part.latent]

            def descend() -> None:
                found[0] = work.carry_out(part.run, runs, part.latent, of_runs, {})  # noqa: B023

            cold, warm = _seconds(descend, where, repeats)
            weights = part.weights(found[0])
            primitive = batch.planner.prior.single

            def finish() -> Any:
                return work.finish(part.problems, weights, primitive, settings, {}, tables)  # noqa: B023

            first_check, check = _seconds(finish, where, 1)
            good = np.array([one.verdict.good for one in finish()])
            row = {
                "measured": "descent",
                "how": "graph" if graph else "eager",
                "scenes": size,
                "first_s": cold,
                "warm_s": warm,
                "warm_ms_per_scene": 1e3 * warm / size,
                "tables_s": packing,
                "conditioning_s": part.seconds,
                "first_check_s": first_check,
                "check_s": check,
                "good_on_device": float(good.mean()),
                "scenes_without_good": int((~good.any(axis=1)).sum()),
                "peak_GiB": _peak(where),
            }
            yield row
            if graph is (where.type == "cuda") and size <= plans:

                def plan() -> Any:
                    return batch.planner.plan(part.problems, device)  # noqa: B023

                cold, warm = _seconds(plan, where, 2)
                timings = plan()[0].timings
                yield {
                    "measured": "plan",
                    "scenes": size,
                    "first_s": cold,
                    "warm_s": warm,
                    "warm_ms_per_scene": 1e3 * warm / size,
                    "stages_ms_per_scene": {k: 1e3 * v for k, v in timings.items()},
                }


def iteration_rows(
    batch: Batch, device: str, sizes: Sequence[int], naive: int, repeats: int
) -> Iterator[dict[str, Any]]:
    """Yield the run times of one gradient: fused, plain, and by naive autograd.

    Args:
        batch: of as many problems as the largest size.
        device: name.
        sizes: B of the fused kernels, where there are any.
        naive: largest B of plain torch and autograd.
        repeats: of each.
    """
    work = DevicePlanner.of(device)
    where, settings = work.device, batch.planner.plan_settings
    for size in sizes:
        part = batch.first(size)
        tables = work.tables(part.problems, settings, settings.planning_steps)
        runs = part.runs(tables.steps, where)
        particles = part.latent[:, : settings.particles // part.parts].to(where, torch.float32)
        paths = runs.latent_trajectories(particles)
        q = paths.unflatten(0, (-1, part.parts)).flatten(1, 2).contiguous()
        for width in settings.edge_width:
            found = {}
            for name, gradient in _gradients(tables, size <= naive, where).items():
                found[name] = gradient(q, width)
                _, warm = _seconds(lambda g=gradient, w=width: g(q, w), where, repeats)  # type: ignore[misc]  # noqa: B023
                yield {
                    "measured": "gradient",
                    "how": name,
                    "scenes": size,
                    "edge_width": width,
                    "warm_ms": 1e3 * warm,
                }
            if size <= naive and len(found) > 1:
                oracle = found.pop("naive autograd")
                for name, mine in found.items():
                    error = float((mine - oracle).norm() / oracle.norm())
                    yield {
                        "measured": "difference from autograd",
                        "how": name,
                        "scenes": size,
                        "edge_width": width,
                        "relative": error,
                    }


def _gradients(
    tables: Tables, naive: bool, device: torch.device
) -> dict[str, Callable[[Tensor, float], Tensor]]:
    """Return what finds gradients, by name."""
    found: dict[str, Callable[[Tensor, float], Tensor]] = {}
    if device.type == "cuda":
        from smp_planner.batch.fused import FusedCosts

        found["fused"] = FusedCosts(tables).gradient
    if naive:
        plain = PlainCosts(tables)

        def autograd(trajectories: Tensor, width: float) -> Tensor:
            given = trajectories.detach().requires_grad_()
            (gradient,) = torch.autograd.grad(plain.weighted(given, width)[0].sum(), given)
            return gradient

        found |= {"plain": plain.gradient, "naive autograd": autograd}
    return found


def write_particles(batch: Batch, device: str, count: int, path: Path) -> FloatArray:
    """Adapt problems on a device and write their particles; return the shares (B,) good there.

    Args:
        batch: of at least as many problems.
        device: name.
        count: B.
        path: of the `.npz` file, weights in float32.
    """
    part, work = batch.first(count), DevicePlanner.of(device)
    settings = batch.planner.plan_settings
    tables = work.tables(part.problems, settings, settings.planning_steps)
    runs = part.runs(tables.steps, work.device)
    latent = work.carry_out(part.run, runs, part.latent, part.tables_of(tables), {})
    weights = part.weights(latent).float()
    primitive = batch.planner.prior.single
    finished = work.finish(part.problems, weights.double(), primitive, settings, {}, tables)
    good = np.array([one.verdict.good for one in finished])
    clearance = np.array([one.verdict.clearance for one in finished])
    with replacing(path) as aside:
        np.savez_compressed(aside, weights=weights.cpu().numpy(), good=good, clearance=clearance)
    return np.asarray(good.mean(axis=1))


def exact_shares(
    planner: PrimitivePlanner, problems: Sequence[Problem], path: Path
) -> tuple[BoolArray, BoolArray]:
    """Return masks (B, P) of the particles good by the exact check, and by the device's.

    Args:
        planner: gives the basis.
        problems: those of the file.
        path: what `write_particles` wrote.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no such file.
    """
    data = read_arrays(read_file(path), str(path))
    if not {"weights", "good"} <= set(data):
        raise ValueError(f"{path} must hold weights and good, as `run` writes them")
    weights, on_device = torch.from_numpy(data["weights"]).double(), data["good"]
    count = min(len(problems), len(weights))
    settings, single = planner.plan_settings, planner.prior.single
    exact = [
        assess(problem, single.trajectory(w, settings.samples).numpy(), settings).good
        for problem, w in zip(problems[:count], weights[:count], strict=True)
    ]
    return np.array(exact), np.asarray(on_device[:count])
