"""A planner from a primitive and an adaptation: `smp`, `promp` and the paper's baselines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from smp_gym.datasets.demonstrations import Demonstrations
from smp_planner.adaptation import ADAPTATIONS, Adaptation, SteinSettings
from smp_planner.batch.planning import DevicePlanner
from smp_planner.planning.maps import SceneMaps
from smp_planner.planning.own_costs import OwnCosts, checked_own_costs
from smp_planner.planning.pipeline import plan_problems
from smp_planner.planning.plan import Plan
from smp_planner.planning.prior import Prior, learn_prior
from smp_planner.planning.problem import Problem
from smp_planner.planning.replanning import replan
from smp_planner.planning.settings import PlanSettings, PriorSettings
from smp_planner.strict_settings import checked_settings

__all__ = ["PrimitivePlanner"]

_MOST_MAPS = 16
"""Grids of standing obstacles that are kept from one replan to the next."""


class PrimitivePlanner:
    """A prior learned from demonstrations, adapted to each problem.

    Args:
        demonstrations: what to learn from.
        adaptation: one of `ADAPTATIONS`.
        settings: by name, of `PriorSettings`, `PlanSettings` and the adaptation; the rest keep
            their defaults.

    Attributes:
        prior: what was learned.
        adaptation: with its settings.
        plan_settings: map, costs and number of tries.

    Raises:
        ValueError: an unknown setting, or one out of range.
    """

    def __init__(
        self, demonstrations: Demonstrations, adaptation: str, settings: Mapping[str, Any]
    ) -> None:
        kind = ADAPTATIONS[adaptation]
        self.plan_settings: PlanSettings
        prior, self.plan_settings, own = checked_settings(
            f"settings of {adaptation}", settings, PriorSettings, PlanSettings, type(kind.settings)
        )
        self.adaptation: Adaptation = replace(kind, settings=own)
        self._devices: dict[str, DevicePlanner] = {}
        self._maps: dict[Any, Any] = {}
        self.prior: Prior = learn_prior(list(np.array(demonstrations.configurations)), prior)

    @property
    def settings(self) -> dict[str, Any]:
        """All settings by name, as plain data."""
        return {
            **self.prior.settings.model_dump(mode="json"),
            **self.plan_settings.model_dump(mode="json"),
            **self.adaptation.settings.model_dump(mode="json"),
        }

    @property
    def can_replan(self) -> bool:
        """Whether it can go on from particles: Stein Movement Primitives, or conditioning."""
        return self.adaptation.adapt is None or isinstance(self.adaptation.settings, SteinSettings)

    def plan(
        self,
        problems: Sequence[Problem],
        device: str | None = None,
        *,
        own: OwnCosts | None = None,
        deadline: float | None = None,
        threads: int | None = None,
        history: int | None = None,
    ) -> list[Plan]:
        """Return one plan for each problem; without a deadline, the same problem gives the same.

        On a device all problems are planned at once, in float32 and with the exact distance to
        obstacles in place of a map. So numbers differ from those without a device, and a little
        from batch to batch. "cpu" is the reference of "cuda": without a device it goes faster.
        On a device particles of "tempered" compete with those of the same part of the prior alone,
        and what is drawn meanwhile depends on all problems of the batch.

        Args:
            problems: to be solved; on a device, at least one, all of one robot and one task.
            device: "cuda", "cuda:1", …, or "cpu"; None plans problem by problem on the processor.
            own: costs of one's own by name, each a weight and a function in torch; see `OwnCost`.
            deadline: s, and `threads`: see `smp_planner.planning.pipeline.plan_problems`.
            threads: that share the particles, without a device.
            history: iterations after which particles are kept on their way, in `Plan.history`; see
                there, too.

        Raises:
            UnreachableError: a goal is out of reach.
            ValueError: there is no such device, or it cannot plan these problems together or with
                this method; a cost of one's own is none, or clashes with another's name;
                `deadline` is not a positive number, or the method or device keeps none;
                `threads` or `history` is not a positive integer; or particles cannot be kept.
        """
        costs = checked_own_costs(own)
        if costs and self.adaptation.adapt is None:
            raise ValueError("own must be empty where nothing is adapted, as by 'promp'")
        found = None
        if device is not None:
            found = self._devices.get(device) or DevicePlanner.of(device)
            self._devices[device] = found
        return plan_problems(
            problems,
            self.prior,
            self.adaptation,
            self.plan_settings,
            own=costs,
            device=found,
            deadline=deadline,
            threads=threads,
            history=history,
        )

    def plan_once(self, problem: Problem) -> Plan:
        """Return a plan in one try: an arm in motion has no time for the further ones.

        Raises:
            UnreachableError: a goal is out of reach.
            ValueError: the problem is of another dimension than the demonstrations.
        """
        one_try = self.plan_settings.model_copy(update={"retries": 0})
        return plan_problems([problem], self.prior, self.adaptation, one_try)[0]

    def replan(self, plan: Plan, problem: Problem, particle: int | None = None) -> Plan:
        """Return a plan for what is left of a problem, from the particles of the last one.

        Args:
            plan: the last one, of this planner.
            problem: from `smp_planner.planning.replanning.resumed`.
            particle: of the plan, that is executed; by default the best.

        Raises:
            ValueError: the plan is of another planner, the problem of another robot or task, or
                the method one that cannot go on from particles.
        """
        if len(self._maps) > _MOST_MAPS:
            self._maps.clear()
        maps = SceneMaps(self.plan_settings, problem.seed, self._maps)
        return replan(
            plan,
            problem,
            self.prior,
            self.adaptation,
            self.plan_settings,
            particle=particle,
            maps=maps,
        )
