"""`mp_rl` and its kin: planners whose proposals a learned policy makes, in one look at the scene.

They start from the primitive of `smp`, propose as many trajectories as it has particles, have as
many tries, and choose the best by the same exact check: the first proposal is the policy's mean
action, the others are drawn from it (`smp_planner.planners.bump_policy`). Nothing is adapted to the
scene. `mp_rl_physics` is `mp_rl` with another reward in training, that of the physics; `detour`
does not see the scene. The network sees rows of obstacles; where a depth camera's points are
observed in their place, it sees none, and proposals are only checked against them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from smp_gym.arrays import FloatArray, IntArray
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.robot.kinematics import UnreachableError
from smp_planner.planners.agent_file import read_agent
from smp_planner.planners.bump_policy import ActionDistribution, look, stacked
from smp_planner.planners.card_file import shipped_agent
from smp_planner.planning.assessment import make_plan
from smp_planner.planning.bumps import BumpedMean, bump_phases, bumped_mean
from smp_planner.planning.plan import Plan
from smp_planner.planning.prior import Prior, learn_prior
from smp_planner.planning.problem import Problem
from smp_planner.planning.settings import PlanSettings, PriorSettings
from smp_planner.planning.stopwatch import Stopwatch
from smp_planner.planning.tries import Try, tries
from smp_planner.strict_settings import StrictSettings, checked_settings
from smp_planner.torch_threads import one_thread

__all__ = ["LEARNED", "BumpPlanner", "ProposalSettings"]

LEARNED = ("mp_rl", "mp_rl_physics", "detour")
"""Names of the planners whose proposals are learned; those of `smp` are their other settings."""


class ProposalSettings(StrictSettings):
    """Settings of the proposals.

    Attributes:
        agent: path of an agent's card (`smp_planner.planners.agent_file`); empty for the one that
            is shipped for the task.
        action: "best" proposes as many trajectories as `PlanSettings.particles` says, and more, at
            last of a wider spread, as long as none is good (`smp_planner.planning.tries`); "mean"
            the policy's mean action alone.
    """

    agent: str = ""
    action: Literal["best", "mean"] = "best"


class BumpPlanner:
    """A learned policy over bumps on the conditioned mean.

    Args:
        demonstrations: from which the primitive is learned; their task says which agent is shipped.
        name: one of `LEARNED`.
        settings: by name, of `PriorSettings`, `PlanSettings` and `ProposalSettings`; the rest keep
            their defaults.

    Attributes:
        prior: what was learned from demonstrations.
        card: of the agent.

    Raises:
        ValueError: an unknown setting, or one out of range; there is no agent for the task; or it
            is of another task or primitive.
    """

    def __init__(
        self, demonstrations: Demonstrations, name: str, settings: Mapping[str, Any]
    ) -> None:
        self._plan_settings: PlanSettings
        self._proposals: ProposalSettings
        prior, self._plan_settings, self._proposals = checked_settings(
            f"settings of {name}", settings, PriorSettings, PlanSettings, ProposalSettings
        )
        path = Path(self._proposals.agent or shipped_agent(name, demonstrations.task))
        try:
            self._policy, self.card = read_agent(path)
        except FileNotFoundError:
            raise ValueError(
                f"{name} needs an agent for {demonstrations.task}, and there is no {path}: train "
                f"one with scripts/train_mp_rl.py --agent {name}, then write it there with "
                "scripts/ship_agent.py or give its card as the setting 'agent'"
            ) from None
        self.prior: Prior = learn_prior(list(np.array(demonstrations.configurations)), prior)
        expected = (name, demonstrations.task, self.prior.single.dimension * self.card.bumps)
        found = (self.card.agent, self.card.task, self._policy.shape.actions)
        if found != expected or self._policy.shape.components != len(self.prior.used.components):
            raise ValueError(
                f"{path} must be an agent {name} of {demonstrations.task} for a primitive of "
                f"{len(self.prior.used.components)} components, got {self.card.agent} of "
                f"{self.card.task} for {self._policy.shape.components}"
            )
        self._phases = bump_phases(self.card.bumps)

    @property
    def settings(self) -> dict[str, Any]:
        """All settings by name, as plain data."""
        return {
            **self.prior.settings.model_dump(mode="json"),
            **self._plan_settings.model_dump(mode="json"),
            **self._proposals.model_dump(mode="json"),
        }

    def plan(self, problems: Sequence[Problem]) -> list[Plan]:
        """Return one plan for each problem; the same problem gives the same plan.

        Raises:
            UnreachableError: a goal is out of reach.
            ValueError: a problem is of another dimension than the demonstrations.
        """
        dimension = self.prior.single.dimension
        for index, problem in enumerate(problems):
            if problem.body.dimension != dimension:
                raise ValueError(
                    f"problems must have the {dimension} joints that demonstrations have, got "
                    f"{problem.body.dimension} in problems[{index}]"
                )
        return [self._plan(problem) for problem in problems]

    def _plan(self, problem: Problem) -> Plan:
        """Return the plan of the first try with a good proposal, or of the first of all."""
        stopwatch, settings = Stopwatch(), self._plan_settings
        generator = torch.Generator().manual_seed(problem.seed % 2**63)
        plan: Plan | None = None
        with one_thread():
            with stopwatch.stage("conditioning"):
                reached = self._reached(problem)
            with stopwatch.stage("inference"):
                found = self._distribution(problem, reached)
            ahead = tries(settings, compete=True)
            if self._proposals.action == "mean":
                ahead = [Try(1, 1.0)]
            for number, (count, width) in enumerate(ahead):
                with stopwatch.stage("inference"):
                    wider = found._replace(std=width * found.std)
                    gaussian, action = _drawn(wider, count, generator, mean_first=number == 0)
                    side = self._policy.shape.component_of(gaussian[0].numpy())
                    components = np.array(list(reached))[side]
                    numbers = (action * self._policy.scale)[0].numpy().astype(np.float64)
                tried = self._checked(problem, reached, components, numbers, stopwatch)
                if plan is None or tried.solved:
                    plan = tried
                if plan.solved:
                    break
        assert plan is not None
        return plan.changed(timings=stopwatch.timings)

    def _checked(
        self,
        problem: Problem,
        reached: Mapping[int, BumpedMean],
        side: IntArray,
        numbers: FloatArray,
        stopwatch: Stopwatch,
    ) -> Plan:
        """Return the plan of proposals: components (P,) and numbers (P, F) on their means."""
        count, settings = len(numbers), self._plan_settings
        with stopwatch.stage("inference"):
            trajectories = np.empty((count, settings.samples, self.prior.single.dimension))
            weights = np.empty((count, self.prior.single.mean.shape[-1]))
            surprise = np.empty(count)
            for component in np.unique(side):
                chosen, mean = side == component, reached[component]
                trajectories[chosen] = mean.trajectories(numbers[chosen])
                weights[chosen] = mean.weights(numbers[chosen]).numpy()
                surprise[chosen] = mean.surprise(numbers[chosen])
        with stopwatch.stage("verification"):
            return make_plan(
                problem,
                trajectories,
                {"prior": surprise},
                settings,
                weights=weights.reshape(count, -1, self.prior.single.dimension),
                components=side if len(self.prior.used.components) > 1 else None,
                reason="no proposal is good",
            )

    def _reached(self, problem: Problem) -> dict[int, BumpedMean]:
        """Return the conditioned means of the components that reach a goal, by their index."""
        found = {}
        for index, component in enumerate(self.prior.components()):
            mean = bumped_mean(
                component, problem, self._plan_settings, self._phases, self._plan_settings.samples
            )
            if mean is not None:
                found[index] = mean
        if not found:
            raise UnreachableError("no component of the primitive reaches a goal")
        return found

    def _distribution(
        self, problem: Problem, reached: Mapping[int, BumpedMean]
    ) -> ActionDistribution:
        """Return the distribution of actions on the means that reach a goal, of a batch of one."""
        seen = look(list(reached.values()), problem.movable)
        with torch.no_grad():
            return self._policy(stacked([seen]), list(reached))


def _drawn(
    found: ActionDistribution, count: int, generator: torch.Generator, *, mean_first: bool
) -> tuple[Tensor, Tensor]:
    """Return `count` indices of Gaussians (1, N) and actions (1, N, F).

    The likeliest Gaussian's mean may be the first.
    """
    parts = []
    if mean_first:
        likeliest = found.choice.argmax(dim=1, keepdim=True)
        parts.append((likeliest, torch.take_along_dim(found.mean, likeliest[..., None], 1)))
    if count > len(parts):
        parts.append(found.sample(count - len(parts), generator))
    gaussian, action = (torch.cat(each, 1) for each in zip(*parts, strict=True))
    return gaussian, action
