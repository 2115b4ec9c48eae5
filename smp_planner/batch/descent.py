"""Runs of a batch's particles on one device without the host, Algorithm 1 among them.

Whitened particles z and trajectories are related by one affine map for each run,
q = Φ μ + (Φ L) z, so that an iteration multiplies by it once and by its transpose once. None of
them waits for the device. On CUDA all are recorded as one graph, which is launched at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol

import torch
from torch import Tensor

from smp_planner.adaptation import Runs
from smp_planner.adaptation.stein import iterate
from smp_planner.batch.problem_tables import Tables
from smp_planner.inference import State, SVGDSettings
from smp_planner.movement_primitives import phases
from smp_planner.movement_primitives.basis import GaussianBasis
from smp_planner.planning.own_costs import OwnCost

__all__ = [
    "BatchCosts",
    "Descent",
    "DeviceTarget",
    "Graphs",
    "PathRuns",
    "Work",
    "carry_out",
]

_WARM_UP = 2
"""Iterations before a graph is recorded: they compile kernels and fill caches."""

_KEPT = 4
"""Graphs that are kept, each with the memory of its iterations."""


class BatchCosts(Protocol):
    """The costs of B problems, in plain torch or by fused kernels."""

    def gradient(self, trajectories: Tensor, width: float) -> Tensor:
        """Return the gradient (B, P, T, n) of the weighted sum of costs."""
        ...

    def weighted_sum(self, trajectories: Tensor) -> Tensor:
        """Return the weighted sums (B, P) of costs, with the map's edge at its last width."""
        ...

    def costs(self, trajectories: Tensor) -> dict[str, Tensor]:
        """Return the unweighted costs (B, P) by name."""
        ...


@dataclass(frozen=True, eq=False)
class PathRuns(Runs):
    """The priors of B runs as affine maps from whitened particles to trajectories.

    It serves settings that whiten, and knows no weights.

    Attributes:
        mean: (B, 1, T*D) Φ μ.
        factor: (B, T*D, r) Φ L.
    """

    @classmethod
    def of_factors(
        cls, basis: GaussianBasis, mean: Tensor, factor: Tensor, steps: int, dtype: torch.dtype
    ) -> PathRuns:
        """Return the runs of priors with one basis.

        Args:
            basis: of K functions.
            mean: (B, K*D) μ.
            factor: (B, K*D, r) L.
            steps: T.
            dtype: of the result.
        """
        values = basis.values(phases(steps, dtype=mean.dtype, device=mean.device))
        path = values @ mean.unflatten(-1, (basis.count, -1))
        columns = values @ factor.unflatten(-2, (basis.count, -1)).movedim(-1, 1)
        return cls(
            (),
            steps,
            path.flatten(-2)[:, None].to(dtype).contiguous(),
            columns.flatten(-2).mT.to(dtype).contiguous(),
            values.to(dtype),
        )

    def latent_trajectories(self, latent: Tensor) -> Tensor:
        """Return the trajectories (B, P, T, D) of whitened particles (B, P, r)."""
        paths = torch.baddbmm(self.mean, latent, self.factor.mT)
        return paths.unflatten(-1, (self.steps, -1))

    def latent_gradient(self, gradient: Tensor) -> Tensor:
        """Return the gradient (B, P, r) by whitened particles of one by trajectories."""
        return gradient.flatten(-2) @ self.factor


class DeviceTarget:
    """The target of B problems on their device.

    Args:
        costs: of the problems.
        edge_width: m, of the map in the first and the last iteration.
        own: costs of one's own by name, each with its weight.
    """

    scenes: Sequence[Any] = ()

    def __init__(
        self,
        costs: BatchCosts,
        edge_width: tuple[float, float],
        own: Mapping[str, tuple[float, OwnCost]],
        steps: int,
    ) -> None:
        self._costs, self._edge_width, self._own, self.steps = costs, edge_width, own, steps

    def gradient(self, trajectories: Tensor, progress: float) -> Tensor:
        """Return the gradient (B, P, T, D); see `smp_planner.adaptation.Target`."""
        first, last = self._edge_width
        gradient = self._costs.gradient(trajectories, first * (last / first) ** progress)
        for weight, cost in self._own.values():
            gradient = gradient + weight * cost.evaluate(trajectories)[1]
        return gradient

    def weighted_sum(self, trajectories: Tensor) -> Tensor:
        """Return the weighted sums (B, P) of all costs, with the map's edge at its last width."""
        total = self._costs.weighted_sum(trajectories)
        for weight, cost in self._own.values():
            total = total + weight * cost.evaluate(trajectories)[0]
        return total


MakeTarget = Callable[[Tables], DeviceTarget]
"""Map from the tables of a batch to its target."""


class Work(Protocol):
    """A run of particles on a device, which does not wait for it; a value that can be a key."""

    def shortened(self, iterations: int) -> Work:
        """Return a run of few iterations, which calls all that the whole one calls."""
        ...

    def __call__(
        self, runs: Runs, latent: Tensor, target: DeviceTarget, generator: torch.Generator
    ) -> Tensor:
        """Return the particles (B, P, r) at the end of the run.

        Args:
            runs: the priors.
            latent: (B, N, r) draws in whitened coordinates.
            target: the costs.
            generator: source of all randomness.
        """
        ...


@dataclass(frozen=True)
class Descent:
    """The iterations of Algorithm 1.

    Attributes:
        inference: settings that whiten, with the number of iterations.
    """

    inference: SVGDSettings

    def shortened(self, iterations: int) -> Descent:
        """Return a run of few iterations."""
        fewer = min(iterations, self.inference.iterations)
        return Descent(replace(self.inference, iterations=fewer))

    def __call__(
        self, runs: Runs, latent: Tensor, target: DeviceTarget, generator: torch.Generator
    ) -> Tensor:
        """Return the particles (B, P, r) after the last iteration; nothing is drawn."""
        state = State(latent, self.inference.optimizer.init(latent), 0)
        for _ in range(self.inference.iterations):
            state = iterate(runs, state, target, self.inference)
        return state.particles


def carry_out(
    work: Work,
    runs: PathRuns,
    latent: Tensor,
    tables: Tables,
    target: MakeTarget,
    seed: int,
    graphs: Graphs | None = None,
) -> Tensor:
    """Return the particles (B, P, r) at the end of a run.

    Args:
        work: the run.
        runs: the priors.
        latent: (B, N, r) draws in whitened coordinates.
        tables: of the problems.
        target: of tables.
        seed: of what is drawn.
        graphs: recorded runs, on CUDA; None launches each operation by itself.
    """
    if graphs is None or latent.device.type != "cuda":
        generator = torch.Generator(latent.device).manual_seed(seed)
        return work(runs, latent, target(tables), generator)
    return graphs.run(work, runs, latent, tables, target, seed)


@dataclass(eq=False)
class _Recorded:
    graph: torch.cuda.CUDAGraph
    generator: torch.Generator
    inputs: list[Tensor]
    result: Tensor
    # What the graph reads must stay where it is.
    kept: Any


@dataclass(eq=False)
class Graphs:
    """Recorded runs, one for each size of a batch and settings."""

    _recorded: dict[Any, _Recorded] = field(default_factory=dict)

    def run(
        self,
        work: Work,
        runs: PathRuns,
        latent: Tensor,
        tables: Tables,
        target: MakeTarget,
        seed: int,
    ) -> Tensor:
        """Return the particles at the end of a run; records it if it is new."""
        inputs = [latent, runs.mean, runs.factor, *_tensors(tables)]
        key = (
            tuple((t.shape, t.stride(), t.dtype, t.device) for t in inputs),
            _constants(tables),
            work,
            target,
        )
        found = self._recorded.pop(key, None)
        if found is None:
            found = _record(work, runs, latent, tables, target)
        else:
            for mine, given in zip(found.inputs, inputs, strict=True):
                mine.copy_(given)
        self._recorded[key] = found
        while len(self._recorded) > _KEPT:
            self._recorded.pop(next(iter(self._recorded)))
        found.generator.manual_seed(seed)
        found.graph.replay()
        return found.result.clone()


def _record(
    work: Work, runs: PathRuns, latent: Tensor, tables: Tables, target: MakeTarget
) -> _Recorded:
    latent = latent.clone()
    runs = replace(runs, mean=runs.mean.clone(), factor=runs.factor.clone())
    tables = tables.clone()
    made = target(tables)
    generator = torch.Generator(latent.device)
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        work.shortened(_WARM_UP)(runs, latent, made, generator)
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    graph.register_generator_state(generator)
    with torch.cuda.graph(graph):
        result = work(runs, latent, made, generator)
    inputs = [latent, runs.mean, runs.factor, *_tensors(tables)]
    return _Recorded(graph, generator, inputs, result, (runs, tables, made))


def _tensors(value: Any) -> list[Tensor]:
    """Return the tensors of tables, in one order."""
    if isinstance(value, Tensor):
        return [value]
    if isinstance(value, tuple):
        return [tensor for part in value for tensor in _tensors(part)]
    if isinstance(value, dict):
        return [tensor for part in value.values() for tensor in _tensors(part)]
    if hasattr(value, "__dataclass_fields__"):
        return [t for f in fields(value) for t in _tensors(getattr(value, f.name))]
    return []


def _constants(value: Any) -> Any:
    """Return what of tables is no tensor, as a key."""
    if isinstance(value, Tensor):
        return None
    if isinstance(value, tuple):
        return tuple(_constants(part) for part in value)
    if isinstance(value, dict):
        return tuple((name, _constants(part)) for name, part in value.items())
    if hasattr(value, "__dataclass_fields__"):
        return tuple(_constants(getattr(value, f.name)) for f in fields(value))
    return value
