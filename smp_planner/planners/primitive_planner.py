"""A planner from a primitive and an adaptation: `smp`, `promp` and the paper's baselines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, create_model

from smp_gym.datasets.demonstrations import Demonstrations
from smp_planner.adaptation import ADAPTATIONS, Adaptation
from smp_planner.planning.pipeline import one_thread, plan_problems
from smp_planner.planning.plan import Plan
from smp_planner.planning.prior import Prior, learn_prior
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings, PriorSettings

__all__ = ["PrimitivePlanner"]


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
        own = type(kind.settings)
        self.adaptation: Adaptation = replace(kind, settings=own.model_validate(given(own)))
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

    def plan(
        self,
        problems: Sequence[Problem],
        *,
        deadline: float | None = None,
        threads: int | None = None,
    ) -> list[Plan]:
        """Return one plan for each problem; without a deadline, the same problem gives the same.

        Args:
            problems: to be solved.
            deadline: s, and `threads`: see `smp_planner.planning.pipeline.plan_problems`.
            threads: that share the particles.

        Raises:
            UnreachableError: a goal is out of reach.
            ValueError: `deadline` is not a positive number, or the method has none; or `threads` is
                not a positive integer.
        """
        return plan_problems(
            problems,
            self.prior,
            self.adaptation,
            self.plan_settings,
            deadline=deadline,
            threads=threads,
        )
