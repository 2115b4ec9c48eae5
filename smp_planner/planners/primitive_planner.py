"""A planner from a primitive and an adaptation: `smp`, `promp` and the paper's baselines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, create_model

from smp_gym.datasets.demonstrations import Demonstrations
from smp_planner.adaptation import ADAPTATIONS, Adaptation, SteinSettings
from smp_planner.planning.maps import SceneMaps
from smp_planner.planning.pipeline import one_thread, plan_problems
from smp_planner.planning.plan import Plan
from smp_planner.planning.prior import Prior, learn_prior
from smp_planner.planning.problem import Problem
from smp_planner.planning.replanning import replan
from smp_planner.planning.settings import PlanSettings, PriorSettings

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
        models = (PriorSettings, PlanSettings, type(kind.settings))
        # All settings are checked as one model, so that an error names all that exist.
        everything: Any = create_model(
            f"settings of {adaptation}",
            __config__=ConfigDict(extra="forbid", frozen=True),
            **{  # type: ignore[call-overload]
                name: (field.annotation, field)
                for model in models
                for name, field in model.model_fields.items()
            },
        )
        everything.model_validate(dict(settings))

        def given(model: type[BaseModel]) -> dict[str, Any]:
            return {name: settings[name] for name in model.model_fields if name in settings}

        self.plan_settings = PlanSettings.model_validate(given(PlanSettings))
        self.adaptation = Adaptation(
            type(kind.settings).model_validate(given(type(kind.settings))), kind.adapt
        )
        self._maps: dict[Any, Any] = {}
        with one_thread():
            self.prior: Prior = learn_prior(
                list(np.array(demonstrations.configurations)),
                PriorSettings.model_validate(given(PriorSettings)),
            )

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

    def plan(self, problems: Sequence[Problem]) -> list[Plan]:
        """Return one plan for each problem; the same problem gives the same plan.

        Raises:
            UnreachableError: a goal is out of reach.
        """
        return plan_problems(problems, self.prior, self.adaptation, self.plan_settings)

    def replan(self, plan: Plan, problem: Problem, particle: int | None = None) -> Plan:
        """Return a plan for what is left of a problem, from the particles of the last one.

        Args:
            plan: the last one, of this planner.
            problem: from `smp_planner.planning.replanning.resumed`.
            particle: of the plan, that is executed; by default the best.

        Raises:
            ValueError: the plan is of another planner, the problem of another robot, or the
                method one that cannot go on from particles.
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
