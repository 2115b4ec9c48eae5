"""Methods of the benchmark, planners and agents, by the specs that name them.

An agent is one of `AGENTS`; ``name=path.zip``, an agent that stable-baselines3 saved; or
``name=module:Class``, and the name that an installed package gives it, where the class has
``predict`` as stable-baselines3's agents have it, and no ``plan``. It is called with the name of
the task, and sees whole observations. Any other spec names a planner, see
`smp_planner.planners.registry.resolve`. To resolve a spec runs no code of a zip; to make its policy
does, since stable-baselines3 pickles.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smp_gym.assets import asset_path
from smp_gym.rollout import Policy
from smp_gym.suites import Cell
from smp_planner.agents.shipped import TRAINED_BY
from smp_planner.planners import registry
from smp_planner.planners.bump_planner import LEARNED
from smp_planner.planners.registry import installed_methods, known_methods
from smp_planner.policy.planner_policy import PlannerPolicy
from smp_planner.policy.replanned_execution import LATENCY

__all__ = ["AGENTS", "Acting", "known_methods_and_agents", "resolve_method"]

AGENTS = ("random", *TRAINED_BY)
"""Agents that have a name of their own."""

_ZIP = ".zip"


@dataclass(frozen=True)
class Acting:
    """A method of the benchmark.

    Attributes:
        name: of the method in rows and files.
        spec: with which `resolve_method` finds it again, in other processes, too.
        digest: of what decides its actions: of its source files, and of its weights.
        plans: whether it is a planner.
    """

    name: str
    spec: str
    digest: str
    plans: bool

    def policy(
        self,
        task: str,
        sensing: str = "exact",
        *,
        replan_every: int | None = None,
        latency: int = LATENCY,
    ) -> Policy:
        """Return a policy for environments of a task; loads, and runs the code of, a zip.

        Args:
            task: one of `smp_gym.scene.TASKS`.
            sensing: of the environments.
            replan_every: control steps after which a planner makes plans anew; None plans once.
            latency: control steps from asking for a plan to its taking effect.

        Raises:
            ValueError: the method cannot be made for these environments, or cannot replan.
        """
        if self.plans:
            return PlannerPolicy.make(self.spec, task, replan_every=replan_every, latency=latency)
        if replan_every is not None:
            raise ValueError(
                "replan_every needs a planner that can go on from a plan, of the methods here smp "
                f"and promp; got the agent {self.name!r}"
            )
        # stable-baselines3 takes seconds to import, and planners do without.
        from smp_planner.agents.acting import RandomActions, load_shipped, load_zip

        if self.spec in TRAINED_BY:
            shipped = load_shipped(self.spec, task)
            shipped.check(task, sensing)
            return shipped
        if self.spec in AGENTS:
            return RandomActions()
        place = _place(self.spec)
        if not place.endswith(_ZIP):
            return _made(registry.from_outside(self.name, place), self.name, task)
        agent = load_zip(Path(place), self.name)
        agent.check(task, sensing)
        return agent

    def check(self, cells: Sequence[Cell], replan_every: int | None, latency: int) -> None:
        """Raise ValueError if the method cannot act in cells, as far as that is quickly told.

        Args:
            cells: to be played.
            replan_every: see `policy`, as the next.
            latency: of plans.
        """
        if self.plans and replan_every is None and self.spec not in LEARNED:
            return
        for task, sensing in dict.fromkeys((cell.task, cell.sensing) for cell in cells):
            self.policy(task, sensing, replan_every=replan_every, latency=latency)


def known_methods_and_agents() -> tuple[str, ...]:
    """Return the names of all methods that need no path: planners, agents, installed ones."""
    return (*known_methods(), *AGENTS, *installed_methods())


def resolve_method(spec: str) -> Acting:
    """Return the method that a spec names.

    Args:
        spec: one of `AGENTS`, ``name=path.zip``, or the spec of a class or a planner, whose module
            is imported.

    Raises:
        ValueError: no such name, file, module or class, a class that neither plans nor predicts,
            or a name that is taken or holds other characters than letters, digits, ``_``, ``-`` and
            ``.``.
    """
    if spec in AGENTS:
        decisive = hashlib.sha256(registry.source_digest(__name__).encode())
        for path in sorted(asset_path("agents").glob(f"{spec}_*")):
            decisive.update(path.read_bytes())
        return Acting(spec, spec, decisive.hexdigest()[:16], plans=False)
    name, own, place = spec.rpartition("=") if isinstance(spec, str) else ("", "", "")
    if own and name in AGENTS:
        raise ValueError(f"the name {name!r} of a method is taken: give {place!r} another")
    if own and place.endswith(_ZIP):
        registry.check_name(name, spec, place)
        try:
            content = Path(place).read_bytes()
        except OSError as error:
            raise ValueError(f"agent {name!r}: no file {place!r}: {error.strerror}") from None
        digest = hashlib.sha256(content).hexdigest()[:16]
        # Workers, and a run that is continued, may stand in other folders.
        return Acting(name, f"{name}={Path(place).resolve()}", digest, plans=False)
    if isinstance(spec, str) and spec not in known_methods() and (place := _place(spec)):
        name = name or spec
        if own:
            registry.check_name(name, spec, place)
        found = registry.from_outside(name, place)
        if hasattr(found, "predict") and not hasattr(found, "plan"):
            return Acting(name, spec, registry.digest_of(place), plans=False)
    planner = registry.resolve(spec)
    return Acting(planner.name, planner.spec, planner.digest, plans=True)


def _place(spec: str) -> str:
    """Return the path or ``module:Class`` that a spec names; empty if it names none."""
    _, own, place = spec.rpartition("=")
    return place if own else registry.installed_place(spec) or ""


def _made(agent: Callable[..., Any], name: str, task: str) -> Policy:
    """Return an agent of one's own for a task.

    Raises:
        ValueError: the class does not take the name of a task alone.
    """
    try:
        inspect.signature(agent).bind(task)
    except TypeError as error:
        raise ValueError(
            f"agent {name!r} must be made by the name of a task alone, as {task!r}: {error}"
        ) from None
    made: Policy = agent(task)
    return made
