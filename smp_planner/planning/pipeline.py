"""The pipeline from problems to plans, Algorithm 1: condition, draw, adapt, assess, try again.

It is the same for robots and balls, which differ in how a `Problem` is made. Problems are planned
in batches: particles that have equally many directions and are equally many in number are adapted
together, with a leading dimension for each run of them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import BoolArray, checked_count
from smp_gym.robot.kinematics import UnreachableError
from smp_planner.adaptation import Adaptation, Runs, SteinSettings
from smp_planner.movement_primitives.mixture import shared_out
from smp_planner.planning.assessment import assess, make_plan
from smp_planner.planning.conditioning import Part, conditioned_parts
from smp_planner.planning.forecasting import runs_in_time
from smp_planner.planning.own_costs import OwnCost
from smp_planner.planning.plan import Plan
from smp_planner.planning.prior import Prior
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings
from smp_planner.planning.stopwatch import Stopwatch
from smp_planner.planning.target import SceneTarget, TargetBatch
from smp_planner.planning.threads import Threads, default_threads
from smp_planner.planning.tries import tries
from smp_planner.torch_threads import one_thread

if TYPE_CHECKING:
    from smp_planner.batch.planning import DevicePlanner, Finished

__all__ = [
    "PlanState",
    "checked_deadline",
    "checked_history",
    "plan_problems",
]

_RESERVED = 0.1
"""Share of the time until a deadline that is kept for checking the best particle."""


def checked_deadline(deadline: Any, adaptation: Adaptation | None = None) -> float | None:
    """Return a deadline, s, or None for none.

    Args:
        deadline: as it was given.
        adaptation: that is to keep it, where it is known already.

    Raises:
        ValueError: it is not a positive, finite number, or the adaptation cannot keep one.
    """
    if deadline is None:
        return None
    number = isinstance(deadline, int | float | np.integer | np.floating)
    if not number or isinstance(deadline, bool) or not (math.isfinite(deadline) and deadline > 0.0):
        raise ValueError(f"deadline must be a positive number of seconds, got {deadline!r}")
    if adaptation is not None and adaptation.adapt is not None and not adaptation.timely:
        raise ValueError(f"deadline must be None for this adaptation, got {deadline}")
    return float(deadline)


def checked_history(history: Any, adaptation: Adaptation) -> int | None:
    """Return after how many iterations particles are kept, or None if they are not.

    Args:
        history: as it was given.
        adaptation: that is to say where particles are.

    Raises:
        ValueError: it is not a positive whole number, or the adaptation does not say.
    """
    if history is None:
        return None
    count = checked_count("history", history)
    if not adaptation.recorded:
        raise ValueError(
            f"history must be None for this adaptation, whose particles go through no iterations "
            f"that could be kept; got {count}"
        )
    return count


@dataclass(frozen=True, eq=False)
class PlanState:
    """What a planner goes on from when a plan is made anew, `Plan.state`.

    Attributes:
        prior: digest of the prior.
        problem: that the plan is of.
        parts: the particles, in the order of the plan.
    """

    prior: str
    problem: Problem
    parts: tuple[Part, ...]


@dataclass(eq=False)
class _Attempt:
    """State of a problem that is being planned.

    Attributes:
        problem: to be solved.
        stopwatch: of its stages.
        target: its costs.
        parts: its particles.
        best: plan of the best try.
        done: whether there is to be no other try.
        drawn: the parts of this try before their adaptation.
        passed: where particles of this try were, by index of the part in `drawn` and iteration.
        stops: the parts of the best try on their way, by iteration.
    """

    problem: Problem
    stopwatch: Stopwatch = field(default_factory=Stopwatch)
    target: SceneTarget | None = None
    parts: list[Part] = field(default_factory=list)
    best: Plan | None = None
    done: bool = False
    drawn: list[Part] = field(default_factory=list)
    passed: dict[int, dict[int, Tensor]] = field(default_factory=dict)
    stops: dict[int, list[Part]] = field(default_factory=dict)

    def record(self, part: int, iteration: int, latent: Tensor) -> None:
        """Keep the particles (P_c, r) of a part before an iteration."""
        self.passed.setdefault(part, {})[iteration] = latent.clone()

    def stopped(self) -> dict[int, list[Part]]:
        """Return the parts as they were before the iterations that were kept, by iteration.

        A part that took fewer iterations than another stays where it was last.
        """
        found: dict[int, list[Part]] = {}
        for iteration in sorted({number for own in self.passed.values() for number in own}):
            found[iteration] = []
            for index, own in self.passed.items():
                latest = own[max(number for number in own if number <= iteration)]
                if len(latest):
                    found[iteration].append(replace(self.drawn[index], latent=latest))
        return found


def plan_problems(
    problems: Sequence[Problem],
    prior: Prior,
    adaptation: Adaptation,
    settings: PlanSettings,
    *,
    deadline: float | None = None,
    threads: int | None = None,
    own: Mapping[str, tuple[float, OwnCost]] = MappingProxyType({}),
    device: DevicePlanner | None = None,
    history: int | None = None,
) -> list[Plan]:
    """Return one plan for each problem; without a deadline, the same problem gives the same plan.

    A problem without a good particle is tried again, as often as `PlanSettings.retries` and as
    `smp_planner.planning.tries` say; of tries that all fail, the first, with the prior as learned,
    is taken. What is not adapted is not tried again. Of a try with more particles than were asked
    for as many are kept, at random.

    With a deadline there are as many iterations as it leaves room for, no new try once it is over,
    and the best of the particles that could be checked is chosen; if none of these is good, the
    plan's message says so. A map is made whole, at least one particle of each problem is checked:
    so much the plan may be late.

    Args:
        problems: to be solved.
        prior: learned from demonstrations.
        adaptation: how draws of the prior are carried to the problems.
        settings: map, costs and number of tries.
        deadline: s from the call, for all problems together; none by default.
        threads: that share the particles of a plan, `default_threads` by default; the plan does
            not depend on it.
        own: costs of one's own by name, each with its weight.
        device: what adapts and checks all problems together; None does it problem by problem.
        history: iterations after which particles are kept on their way, as plans of their own in
            `Plan.history`, whose checks count in no timing, all particles of the try that the plan
            is of; None keeps none. The plan itself is the same in any case.

    Raises:
        UnreachableError: a goal is out of reach.
        ValueError: a problem is of another dimension than the demonstrations; `deadline` is not a
            positive number, or the adaptation or a device cannot keep one; `threads` is not a
            positive integer; `history` is not one, the adaptation has no iterations, or there is a
            device or a deadline; or the problems cannot be planned together on a device.
    """
    begin = time.perf_counter()
    until = math.inf
    deadline = checked_deadline(deadline, adaptation)
    history = checked_history(history, adaptation)
    if history is not None and (deadline is not None or device is not None):
        other = "on a device" if deadline is None else f"with a deadline, {deadline} s"
        raise ValueError(f"history must be None {other}, got {history}")
    if deadline is not None:
        if device is not None:
            raise ValueError(f"deadline must be None on a device, got {deadline}")
        until = begin + deadline
    dimension = prior.single.dimension
    for index, problem in enumerate(problems):
        if problem.body.dimension != dimension:
            raise ValueError(
                f"problems must have the {dimension} coordinates (or joints) that demonstrations "
                f"have, got {problem.body.dimension} in problems[{index}]"
            )
    attempts = [_Attempt(problem) for problem in problems]
    compete = _competes(adaptation)
    overdraw: int = adaptation.settings.overdraw if compete else 1  # type: ignore[attr-defined]
    ahead = tries(settings, compete=compete and device is None)
    if adaptation.adapt is None:
        ahead = ahead[:1]
    with Threads(default_threads() if threads is None else threads) as pool, one_thread():
        for number, (particles, width) in enumerate(ahead):
            if number > 0 and time.perf_counter() > until:
                break
            open_ = [attempt for attempt in attempts if not attempt.done]
            for attempt in open_:
                if adaptation.adapt is not None and attempt.target is None and device is None:
                    with attempt.stopwatch.stage("map"):
                        attempt.target = SceneTarget(
                            attempt.problem, settings, dict(own), threads=pool
                        )
                _draw(attempt, prior, _with(settings, overdraw * particles), width)
            open_ = [attempt for attempt in open_ if not attempt.done]
            if device is None:
                _adapt(open_, adaptation, _with(settings, particles), until, history)
                for attempt in open_:
                    _thin(attempt, settings.particles)
                plans = [_plan_of(attempt, prior, settings, until) for attempt in open_]
            else:
                plans = _on_device(open_, prior, adaptation, settings, own, device)
            for attempt, plan in zip(open_, plans, strict=True):
                if attempt.best is None or plan.solved:
                    attempt.best, attempt.stops = plan, attempt.stopped()
                attempt.done = attempt.best.solved
        return [_chosen(attempt, prior, settings) for attempt in attempts]


def _chosen(attempt: _Attempt, prior: Prior, settings: PlanSettings) -> Plan:
    """Return the plan of the best try, with its times and its history."""
    assert attempt.best is not None
    timings = dict(attempt.stopwatch.timings)
    if not attempt.stops:
        return attempt.best.changed(timings=timings)
    history = {
        iteration: _plan_of(replace(attempt, parts=parts, stopwatch=Stopwatch()), prior, settings)
        for iteration, parts in attempt.stops.items()
    }
    return attempt.best.changed(timings=timings, history=history)


def _with(settings: PlanSettings, particles: int) -> PlanSettings:
    """Return settings with another number of particles."""
    return settings.model_copy(update={"particles": particles})


def _draw(attempt: _Attempt, prior: Prior, settings: PlanSettings, width: float) -> None:
    """Draw the particles of one attempt."""
    with attempt.stopwatch.stage("conditioning"):
        try:
            attempt.parts = conditioned_parts(prior, attempt.problem, settings, width)
        except UnreachableError:
            # So wide a primitive may miss a goal that it reached before.
            if attempt.best is None:
                raise
            attempt.done = True


def _thin(attempt: _Attempt, count: int) -> None:
    """Keep so many of an attempt's particles, all alike in their chances, if there are more."""
    parts = attempt.parts
    owner = np.repeat(np.arange(len(parts)), [len(part.latent) for part in parts])
    if len(owner) <= count:
        return
    rng = np.random.default_rng([attempt.problem.seed, 4])
    chosen = np.sort(rng.choice(len(owner), count, replace=False))
    first = np.searchsorted(owner, np.arange(len(parts)))
    kept = [chosen[owner[chosen] == index] - first[index] for index in range(len(parts))]
    attempt.parts = [
        replace(part, latent=part.latent[torch.from_numpy(own)])
        for part, own in zip(parts, kept, strict=True)
        if len(own)
    ]


def _adapt(
    attempts: Sequence[_Attempt],
    adaptation: Adaptation,
    settings: PlanSettings,
    until: float,
    history: int | None,
) -> None:
    """Carry the particles of attempts to their targets, equal parts together."""
    if adaptation.adapt is None:
        return
    for attempt in attempts:
        attempt.passed, attempt.drawn = {}, list(attempt.parts)
    if _competes(adaptation):
        _adapt_jointly(attempts, adaptation, settings, until, history)
        return
    groups: dict[tuple[int, ...], list[tuple[_Attempt, int]]] = {}
    separate = getattr(adaptation.settings, "separate", False)
    for attempt in attempts:
        for index, part in enumerate(attempt.parts):
            own = (len(groups),) if separate else ()
            groups.setdefault((*part.latent.shape, *own), []).append((attempt, index))
    for number, group in enumerate(groups.values()):
        begin = time.perf_counter()
        parts = [attempt.parts[index] for attempt, index in group]
        targets = [attempt.target for attempt, _ in group]
        runs = Runs.of([part.primitive for part in parts], settings.planning_steps)
        rngs = [
            np.random.default_rng(
                [attempt.problem.seed, 3, part.component, *part.branch, *_nth(part.width)]
            )
            for (attempt, _), part in zip(group, parts, strict=True)
        ]

        timely: dict[str, Any] = {}
        if until < math.inf:
            # The groups that are left share the time that is left, but for what comes after.
            left = (1.0 - _RESERVED) * (until - begin)
            timely["until"] = begin + left / (len(groups) - number)
        if history is not None:
            timely["record"] = partial(_record_runs, group, history)
        latent = adaptation.adapt(
            runs,
            torch.stack([part.latent for part in parts]),
            TargetBatch([target for target in targets if target is not None]),
            rngs,
            adaptation.settings,
            partial(_good, runs, [attempt.problem for attempt, _ in group], settings),
            **timely,
        )
        seconds = (time.perf_counter() - begin) / len(group)
        for (attempt, index), adapted in zip(group, latent, strict=True):
            attempt.parts[index] = replace(attempt.parts[index], latent=adapted)
            attempt.stopwatch.add("inference", seconds)


def _record_runs(
    group: Sequence[tuple[_Attempt, int]], history: int, iteration: int, latent: Tensor
) -> None:
    """Keep the particles (B, P, r) of runs, each of a part of an attempt, if it is their turn."""
    if iteration % history == 0:
        for (attempt, index), own in zip(group, latent, strict=True):
            attempt.record(index, iteration, own)


def _record_parts(attempt: _Attempt, history: int, iteration: int, latent: list[Tensor]) -> None:
    """Keep the particles of all parts of an attempt, if it is their turn."""
    if iteration % history == 0:
        for index, own in enumerate(latent):
            attempt.record(index, iteration, own)


def _nth(width: float) -> tuple[int, ...]:
    """Return what a width adds to the seed of a part's generator."""
    return () if width == 1.0 else (round(1000 * width),)


def _competes(adaptation: Adaptation) -> bool:
    """Return whether the particles of a problem are adapted as one population."""
    return adaptation.jointly is not None and getattr(adaptation.settings, "competes", False)


def _adapt_jointly(
    attempts: Sequence[_Attempt],
    adaptation: Adaptation,
    settings: PlanSettings,
    until: float,
    history: int | None,
) -> None:
    """Carry the particles of each attempt to its target, all parts as one population."""
    assert adaptation.jointly is not None
    for number, attempt in enumerate(attempts):
        begin = time.perf_counter()
        left = until
        if until < math.inf:
            left = begin + (1.0 - _RESERVED) * (until - begin) / (len(attempts) - number)
        recording: dict[str, Any] = {}
        if history is not None:
            recording["record"] = partial(_record_parts, attempt, history)
        with attempt.stopwatch.stage("inference"):
            found = adaptation.jointly(
                [Runs.of([part.primitive], settings.planning_steps) for part in attempt.parts],
                [part.latent for part in attempt.parts],
                attempt.target,
                np.random.default_rng([attempt.problem.seed, 3]),
                adaptation.settings,
                settings.particles,
                left,
                **recording,
            )
        attempt.parts = [
            replace(part, latent=latent)
            for part, latent in zip(attempt.parts, found, strict=True)
            if len(latent)
        ]


def _good(
    runs: Runs, problems: Sequence[Problem], settings: PlanSettings, latent: Tensor
) -> BoolArray:
    """Return a mask (B, P) of the whitened particles (B, P, r) that are good as they are."""
    found = []
    for problem, primitive, weights in zip(
        problems, runs.primitives, runs.unwhiten(latent), strict=True
    ):
        trajectories = primitive.trajectory(weights, settings.samples).numpy()
        found.append(assess(problem, trajectories, settings).good)
    return np.stack(found)


def _plan_of(
    attempt: _Attempt,
    prior: Prior,
    settings: PlanSettings,
    until: float = math.inf,
    finished: Finished | None = None,
) -> Plan:
    """Return the plan that the particles of one attempt amount to.

    Args:
        attempt: with adapted particles.
        prior: gives the basis.
        settings: see `plan_problems`.
        until: time of `time.perf_counter` from which on no more particles are checked.
        finished: what a device found of them already.
    """
    parts, primitive = attempt.parts, prior.single
    weights = _weights(attempt)
    costs = {"prior": np.concatenate([part.surprise for part in parts])}
    if finished is not None:
        costs |= finished.costs
    elif attempt.target is not None:
        with attempt.stopwatch.stage("inference"):
            planned = primitive.trajectory(weights, settings.planning_steps).numpy()
            costs |= attempt.target.costs(planned)
    components = None
    if len(prior.used.components) > 1:
        components = np.repeat(
            [part.component for part in parts], [len(part.latent) for part in parts]
        )
    with attempt.stopwatch.stage("verification"):
        if finished is None:
            trajectories = primitive.trajectory(weights, settings.samples).numpy()
        else:
            trajectories = finished.trajectories
        if attempt.problem.done is not None:
            trajectories[:, : len(attempt.problem.done)] = attempt.problem.done
        plan = make_plan(
            attempt.problem,
            trajectories,
            costs,
            settings,
            weights=weights.numpy().reshape(-1, primitive.basis.count, primitive.dimension),
            components=components,
            until=until,
            verdict=None if finished is None else finished.verdict,
        )
    return plan.changed(state=PlanState(prior.digest, attempt.problem, tuple(parts)))


def _weights(attempt: _Attempt) -> Tensor:
    """Return the weights (P, K*D) of the particles of all parts."""
    return torch.cat([part.primitive.unwhiten(part.latent) for part in attempt.parts])


def _on_device(
    attempts: Sequence[_Attempt],
    prior: Prior,
    adaptation: Adaptation,
    settings: PlanSettings,
    own: Mapping[str, tuple[float, OwnCost]],
    device: DevicePlanner,
) -> list[Plan]:
    """Return the plans of attempts, adapted and checked together on a device."""
    if not attempts:
        return []
    everyone = [(attempt, 1.0 / len(attempts)) for attempt in attempts]
    problems = [attempt.problem for attempt in attempts]
    if any(runs_in_time(problem, settings) for problem in problems):
        raise ValueError("obstacles must stand still to be planned around on a device")
    tables = None
    if adaptation.adapt is not None:
        if not isinstance(adaptation.settings, SteinSettings):
            raise ValueError("only the methods 'smp' and 'promp' can be planned on a device")
        with _shared("map", everyone):
            tables = device.tables(problems, settings, settings.planning_steps)
        groups: dict[tuple[int, ...], list[tuple[int, int]]] = {}
        for number, attempt in enumerate(attempts):
            # Particles compete with those of their own part alone.
            counts = shared_out(settings.particles, [float(len(p.latent)) for p in attempt.parts])
            for index, (part, count) in enumerate(zip(attempt.parts, counts, strict=True)):
                groups.setdefault((count, *part.latent.shape), []).append((number, index))
        for (count, *_), group in groups.items():
            parts = [attempts[number].parts[index] for number, index in group]
            numbers = [number for number, _ in group]
            with _shared("inference", [(attempts[n], 1.0 / len(group)) for n in numbers]):
                adapted = device.adapt(
                    tables.of_problems(numbers),
                    [part.primitive for part in parts],
                    torch.stack([part.latent for part in parts]),
                    adaptation.settings,
                    own,
                    count,
                    _seed_of([problems[number].seed for number in numbers]),
                )
            for (number, index), part, latent in zip(group, parts, adapted, strict=True):
                attempts[number].parts[index] = replace(part, latent=latent)
    with _shared("verification", everyone):
        weights = torch.stack([_weights(attempt) for attempt in attempts])
        found = device.finish(problems, weights, prior.single, settings, own, tables)
    return [
        _plan_of(attempt, prior, settings, finished=finished)
        for attempt, finished in zip(attempts, found, strict=True)
    ]


def _seed_of(seeds: Sequence[int]) -> int:
    """Return the seed of what is drawn for problems together, from the seeds of all."""
    return int(np.random.SeedSequence([*seeds, 3]).generate_state(1)[0])


@contextmanager
def _shared(name: str, attempts: Sequence[tuple[_Attempt, float]]) -> Iterator[None]:
    """Add shares of the time spent inside to a stage of attempts."""
    begin = time.perf_counter()
    yield
    seconds = time.perf_counter() - begin
    for attempt, share in attempts:
        attempt.stopwatch.add(name, share * seconds)
