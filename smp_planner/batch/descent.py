"""Stein variational gradient descent of a batch on one device: Algorithm 1 without the host.

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

__all__ = ["BatchCosts", "DeviceTarget", "Graphs", "PathRuns", "descend"]

_WARM_UP = 2
"""Iterations before a graph is recorded: they compile kernels and fill caches."""

_KEPT = 4
"""Graphs that are kept, each with the memory of its iterations."""


class BatchCosts(Protocol):
    """The costs of B problems, in plain torch or by fused kernels."""

    def gradient(self, trajectories: Tensor, width: float) -> Tensor:
        """Return the gradient (B, P, T, n) of the weighted sum of costs."""
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


MakeTarget = Callable[[Tables], DeviceTarget]
"""Map from the tables of a batch to its target."""


def _iterations(
    runs: Runs, latent: Tensor, target: DeviceTarget, inference: SVGDSettings, count: int
) -> Tensor:
    state = State(latent, inference.optimizer.init(latent), 0)
    for _ in range(count):
        state = iterate(runs, state, target, inference)
    return state.particles


def descend(
    runs: PathRuns,
    latent: Tensor,
    tables: Tables,
    target: MakeTarget,
    inference: SVGDSettings,
    graphs: Graphs | None = None,
) -> Tensor:
    """Return the particles (B, P, r) after the last iteration.

    Args:
        runs: the priors.
        latent: (B, P, r) whitened particles.
        tables: of the problems.
        target: of tables.
        inference: settings that whiten.
        graphs: recorded runs, on CUDA; None launches each operation by itself.
    """
    if graphs is None or latent.device.type != "cuda":
        return _iterations(runs, latent, target(tables), inference, inference.iterations)
    return graphs.run(runs, latent, tables, target, inference)


@dataclass(eq=False)
class _Recorded:
    graph: torch.cuda.CUDAGraph
    inputs: list[Tensor]
    result: Tensor
    # What the graph reads must stay where it is.
    kept: Any


@dataclass(eq=False)
class Graphs:
    """Recorded runs of all iterations, one for each size of a batch and settings."""

    _recorded: dict[Any, _Recorded] = field(default_factory=dict)

    def run(
        self,
        runs: PathRuns,
        latent: Tensor,
        tables: Tables,
        target: MakeTarget,
        inference: SVGDSettings,
    ) -> Tensor:
        """Return the particles after the last iteration; records the run if it is new."""
        inputs = [latent, runs.mean, runs.factor, *_tensors(tables)]
        key = (
            tuple((t.shape, t.stride(), t.dtype, t.device) for t in inputs),
            _constants(tables),
            inference,
            target,
        )
        found = self._recorded.pop(key, None)
        if found is None:
            found = _record(runs, latent, tables, target, inference)
        else:
            for mine, given in zip(found.inputs, inputs, strict=True):
                mine.copy_(given)
        self._recorded[key] = found
        while len(self._recorded) > _KEPT:
            self._recorded.pop(next(iter(self._recorded)))
        found.graph.replay()
        return found.result.clone()


def _record(
    runs: PathRuns,
    latent: Tensor,
    tables: Tables,
    target: MakeTarget,
    inference: SVGDSettings,
) -> _Recorded:
    latent = latent.clone()
    runs = replace(runs, mean=runs.mean.clone(), factor=runs.factor.clone())
    tables = tables.clone()
    made = target(tables)
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        _iterations(runs, latent, made, inference, min(_WARM_UP, inference.iterations))
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        result = _iterations(runs, latent, made, inference, inference.iterations)
    inputs = [latent, runs.mean, runs.factor, *_tensors(tables)]
    return _Recorded(graph, inputs, result, (runs, tables, made))


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
