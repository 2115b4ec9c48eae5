"""Batches of problems on one device: adapted, costed and checked together.

`smp_planner.planning.pipeline` conditions the prior and puts plans together; what it hands over
here comes back as it would from its own path.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from smp_gym.arrays import FloatArray
from smp_planner.adaptation.stein import SteinSettings, inference_of
from smp_planner.batch.check import Gaps, path_gaps
from smp_planner.batch.descent import (
    BatchCosts,
    Descent,
    DeviceTarget,
    Graphs,
    PathRuns,
    Work,
    carry_out,
)
from smp_planner.batch.plain_costs import PlainCosts, plain_gaps
from smp_planner.batch.problem_tables import Tables, checked_device
from smp_planner.batch.tempering import Tempering
from smp_planner.collision.costs import VELOCITY_FRACTION
from smp_planner.collision.verification import CLEARANCE_TOLERANCE, LIMIT_TOLERANCE
from smp_planner.movement_primitives import ProMP, phases
from smp_planner.planning.assessment import Verdict, constraints_met
from smp_planner.planning.own_costs import OwnCost
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings

__all__ = ["DevicePlanner", "Finished", "Targets", "run_of"]


@dataclass(frozen=True)
class Targets:
    """Factory of the target of a batch from its tables.

    Attributes:
        own: name, weight and function of the costs of one's own.
        fused: whether the fused kernels compute the costs.
    """

    own: tuple[tuple[str, float, OwnCost], ...] = ()
    fused: bool = False

    def costs(self, tables: Tables) -> BatchCosts:
        """Return the costs of a batch, without those of one's own."""
        if self.fused:
            from smp_planner.batch.fused import FusedCosts

            return FusedCosts(tables)
        return PlainCosts(tables)

    def __call__(self, tables: Tables) -> DeviceTarget:
        """Return the target of a batch."""
        own = {name: (weight, cost) for name, weight, cost in self.own}
        return DeviceTarget(self.costs(tables), tables.edge_width, own, tables.steps)


def run_of(settings: SteinSettings, count: int) -> Work:
    """Return the run of particles that settings describe.

    Args:
        settings: that whiten.
        count: of particles at the end, if they compete.
    """
    inference = inference_of(settings)
    return Tempering(inference, count) if inference.competes else Descent(inference)


@dataclass(frozen=True, eq=False)
class Finished:
    """Particles of one problem, costed and checked.

    Attributes:
        trajectories: (P, T, D).
        costs: unweighted, by name, each (P,).
        verdict: of the check.
    """

    trajectories: FloatArray
    costs: dict[str, FloatArray]
    verdict: Verdict


@dataclass(eq=False)
class DevicePlanner:
    """A device with the recorded runs of the batches that were planned on it.

    Attributes:
        device: cpu or cuda.
        dtype: of particles, costs and checks.
        graph: whether all iterations are recorded and launched as one CUDA graph.
        fused: whether the fused kernels are used; None where they can be.
    """

    device: torch.device
    dtype: torch.dtype = torch.float32
    graph: bool = True
    fused: bool | None = None
    _graphs: Graphs = field(default_factory=Graphs)

    @classmethod
    def of(cls, device: str | torch.device) -> DevicePlanner:
        """Return the planner of a device by its name.

        Raises:
            ValueError: there is no such device.
        """
        return cls(checked_device(device))

    @cached_property
    def _fused(self) -> bool:
        if self.fused is not None:
            return self.fused
        return self.device.type == "cuda" and importlib.util.find_spec("triton") is not None

    @property
    def _gaps(self) -> Gaps:
        if self._fused:
            from smp_planner.batch.fused import fused_gaps

            return fused_gaps
        return plain_gaps

    def targets(self, own: Mapping[str, tuple[float, OwnCost]]) -> Targets:
        """Return what makes targets of tables."""
        return Targets(tuple((name, *term) for name, term in own.items()), self._fused)

    def tables(self, problems: Sequence[Problem], settings: PlanSettings, steps: int) -> Tables:
        """Return the tables of problems on the device; see `Tables.of`."""
        return Tables.of(problems, settings, self.device, self.dtype, steps)

    def adapt(
        self,
        tables: Tables,
        primitives: Sequence[ProMP],
        latent: Tensor,
        settings: SteinSettings,
        own: Mapping[str, tuple[float, OwnCost]],
        count: int | None = None,
        seed: int = 0,
    ) -> Tensor:
        """Return particles (B, P, r) in float64 at the end of a run.

        Args:
            tables: of B problems at the steps of planning.
            primitives: B priors, conditioned, of one basis and one rank.
            latent: (B, N, r) draws in whitened coordinates.
            settings: of Algorithm 1.
            own: costs of one's own by name, each with its weight.
            count: P, how many of the draws become particles, if they compete; all by default.
            seed: of what is drawn while they compete.

        Raises:
            ValueError: settings that only planning without a device knows, or a gradient that is
                not finite.
        """
        if settings.separate:
            raise ValueError(
                "early_stop must be off, and the kernel without a metric, to plan on a device"
            )
        inference = inference_of(settings)
        if not inference.whiten:
            raise ValueError(
                f"inference must be one that whitens to plan on a device, got "
                f"{settings.inference!r}"
            )
        mean = torch.stack([p.mean for p in primitives]).to(self.device)
        factor = torch.stack([p.factor for p in primitives]).to(self.device)
        runs = PathRuns.of_factors(primitives[0].basis, mean, factor, tables.steps, self.dtype)
        work = run_of(settings, latent.shape[1] if count is None else count)
        return self.carry_out(work, runs, latent, tables, own, seed).cpu().double()

    def carry_out(
        self,
        work: Work,
        runs: PathRuns,
        latent: Tensor,
        tables: Tables,
        own: Mapping[str, tuple[float, OwnCost]],
        seed: int = 0,
    ) -> Tensor:
        """Return particles (B, P, r) on the device at the end of a run."""
        found = carry_out(
            work,
            runs,
            latent.to(self.device, self.dtype),
            tables,
            self.targets(own),
            seed,
            self._graphs if self.graph else None,
        )
        if not bool(torch.isfinite(found).all()):
            raise ValueError("the costs' gradient must be finite, got NaN or infinity")
        return found

    def finish(
        self,
        problems: Sequence[Problem],
        weights: Tensor,
        primitive: ProMP,
        settings: PlanSettings,
        own: Mapping[str, tuple[float, OwnCost]],
        tables: Tables | None = None,
    ) -> list[Finished]:
        """Return the trajectories of particles with their costs and the verdict of the check.

        Args:
            problems: B problems.
            weights: (B, P, K*D) of the primitive.
            primitive: gives the basis.
            settings: steps, weights and limits.
            own: costs of one's own by name, each with its weight.
            tables: of the problems at the steps of planning; None where costs are not asked for.
        """
        weights = weights.to(self.device)
        basis = primitive.basis
        values = _paths(basis, weights, settings.samples)
        costs: dict[str, Tensor] = {}
        if tables is not None:
            planned = _paths(basis, weights, settings.planning_steps).to(self.dtype)
            costs = self.targets(own).costs(tables).costs(planned)
            drop = {"self_collision", "velocity", "joint_limits"}
            unweighted = dict(zip(("obstacles", *_LIMITS), tables.weights, strict=True))
            costs = {
                name: value
                for name, value in costs.items()
                if name not in drop or unweighted[name] > 0.0
            }
            costs |= {name: cost.evaluate(planned)[0] for name, (_, cost) in own.items()}
        verdicts = self.check(problems, values, settings)
        arrays = {name: value.cpu().double().numpy() for name, value in costs.items()}
        return [
            Finished(trajectories, {name: value[b] for name, value in arrays.items()}, verdict)
            for b, (trajectories, verdict) in enumerate(
                zip(values.cpu().numpy(), verdicts, strict=True)
            )
        ]

    def check(
        self, problems: Sequence[Problem], trajectories: Tensor, settings: PlanSettings
    ) -> list[Verdict]:
        """Return what `assess` returns of each problem, found on the device.

        Args:
            problems: B problems of one robot and one task.
            trajectories: (B, P, T, D) rad.
            settings: limit of the duration, and what may be missed.
        """
        tables = self.tables(problems, settings, trajectories.shape[2])
        paths = trajectories.to(self.device, self.dtype).contiguous()
        free = torch.ones(paths.shape[:2], dtype=torch.bool, device=self.device)
        clearance = torch.full(paths.shape[:2], torch.inf, device=self.device, dtype=self.dtype)
        whole = torch.zeros(len(problems), dtype=torch.bool, device=self.device)
        for index, stage in enumerate(tables.stages):
            found = path_gaps(tables, stage, paths, self._gaps)
            # What stands against obstacles is at least the tolerance away, as on the host.
            clear = found.clearance >= CLEARANCE_TOLERANCE
            free &= clear & found.self_free
            clearance = torch.minimum(clearance, found.clearance)
            whole |= torch.tensor(
                [
                    p.stages[index].body is p.body
                    and (p.stages[index].first, p.stages[index].last) == (0.0, 1.0)
                    for p in problems
                ],
                device=self.device,
            )
        if not bool(whole.all()):
            found = path_gaps(tables, tables.body, paths, self._gaps)
            free &= found.self_free | whole[:, None]
        model = problems[0].robot
        lower, upper = (
            torch.as_tensor(bound, dtype=trajectories.dtype, device=trajectories.device)
            for bound in (model.lower, model.upper)
        )
        speed = torch.as_tensor(
            VELOCITY_FRACTION * model.velocity, dtype=trajectories.dtype, device=lower.device
        )
        steps = trajectories.shape[2]
        duration = (trajectories.diff(dim=2).abs() / speed).amax((2, 3)) * (steps - 1)
        lower, upper = lower - LIMIT_TOLERANCE, upper + LIMIT_TOLERANCE
        within = ((trajectories >= lower) & (trajectories <= upper)).all(3).all(2)
        executable = within & (duration <= settings.duration_limit)
        columns = [
            part.cpu().numpy() for part in (free, clearance.double(), executable, duration.double())
        ]
        host = trajectories.cpu().numpy()
        return [
            _verdict(problem, host[b], settings, *(column[b] for column in columns))
            for b, problem in enumerate(problems)
        ]


_LIMITS = ("self_collision", "velocity", "joint_limits")


def _paths(basis: Any, weights: Tensor, steps: int) -> Tensor:
    """Return the trajectories (B, P, T, D) of weights (B, P, K*D)."""
    values = basis.values(phases(steps, dtype=weights.dtype, device=weights.device))
    return values @ weights.unflatten(-1, (basis.count, -1))


def _verdict(
    problem: Problem,
    trajectories: FloatArray,
    settings: PlanSettings,
    free: Any,
    clearance: FloatArray,
    executable: Any,
    duration: FloatArray,
) -> Verdict:
    """Return the verdict with the constraints checked."""
    missed, passing = constraints_met(problem, trajectories, settings)
    return Verdict(free, clearance, executable, duration, missed, passing)
