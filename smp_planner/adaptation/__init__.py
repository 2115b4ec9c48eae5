"""Methods of adapting a primitive to new scenes: SVGD, and the paper's baselines.

An adaptation is a function and its settings, data. It knows trajectories and their costs only, no
arm and no scene.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel
from torch import Tensor

from smp_gym.arrays import shown
from smp_planner.adaptation.chance_constrained import ChanceSettings, chance_constrained
from smp_planner.adaptation.flow import FlowSettings, flow
from smp_planner.adaptation.optimised_mean import OptimisedMeanSettings, optimised_mean
from smp_planner.adaptation.runs import Adapt, Good, Runs, SceneCosts, StepConstraint, Target
from smp_planner.adaptation.stein import SteinSettings, stein
from smp_planner.adaptation.tempered import tempered_stein
from smp_planner.adaptation.variational import VariationalSettings, gaussian_vi
from smp_planner.strict_settings import StrictSettings

__all__ = [
    "ADAPTATIONS",
    "Adapt",
    "Adaptation",
    "ChanceSettings",
    "FlowSettings",
    "Good",
    "OptimisedMeanSettings",
    "Runs",
    "SceneCosts",
    "SteinSettings",
    "StepConstraint",
    "Target",
    "Unadapted",
    "VariationalSettings",
    "adaptation",
]


class Unadapted(StrictSettings):
    """Settings of conditioning alone: there are none."""


@dataclass(frozen=True)
class Adaptation:
    """An adaptation: a function with its settings.

    Attributes:
        settings: of the function.
        adapt: carries draws of the prior to a target; None leaves the conditioned draws as they
            are.
        timely: whether `adapt` takes a last argument ``until``, a time of `time.perf_counter`, by
            which it returns what it has.
        recorded: whether `adapt` and `jointly` take an argument ``record``, which is told the
            particles of each iteration.
        jointly: carries the draws of all parts of one problem to its target together, as
            `tempered_stein`, where the settings' `competes` says so; None if no settings do.
    """

    settings: BaseModel
    adapt: Adapt | None
    timely: bool = False
    recorded: bool = False
    jointly: Callable[..., list[Tensor]] | None = None


ADAPTATIONS: Mapping[str, Adaptation] = MappingProxyType(
    {
        "smp": Adaptation(
            SteinSettings(), stein, timely=True, recorded=True, jointly=tempered_stein
        ),
        "promp": Adaptation(Unadapted(), None),
        "cpromp": Adaptation(VariationalSettings(), gaussian_vi),
        "cpromp_chance": Adaptation(ChanceSettings(), chance_constrained),
        "prompt_o": Adaptation(OptimisedMeanSettings(), optimised_mean),
        "promp_diff": Adaptation(FlowSettings(), flow),
    }
)
"""Adaptations by name, with default settings: Stein Movement Primitives, conditioning alone
(Sec. III-A), and the paper's baselines CProMPs (as Gaussian variational inference, and
with chance constraints), ProMPT-O and ProMPs-Diff."""


def adaptation(name: str, **settings: Any) -> Adaptation:
    """Return one of `ADAPTATIONS` with settings of its own.

    Args:
        name: of the method.
        **settings: by name; the rest keep their defaults.

    Raises:
        ValueError: unknown name or setting, or a setting out of range.
    """
    if name not in ADAPTATIONS:
        raise ValueError(f"method must be one of {', '.join(ADAPTATIONS)}; got {shown(name)}")
    known = ADAPTATIONS[name]
    return replace(known, settings=type(known.settings).model_validate(settings))
