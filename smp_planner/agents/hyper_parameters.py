"""Hyper-parameters of agents: data, a JSON file per environment id in `envs_assets/agents/`."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from smp_gym.observation import MAX_EPISODE_STEPS, observation_space
from smp_gym.scene import TASKS
from smp_planner.agents.goal_view import GOAL_CONDITIONED

__all__ = ["HyperParameters"]


@dataclass(frozen=True)
class HyperParameters:
    """Hyper-parameters of one agent.

    Attributes:
        environments: stepped in turn, in this process.
        observations: entries of the observation that the agent sees; None for all. Where there are
            no obstacles, leaving out their rows of zeros makes learning faster.
        hidden: fields of the desired goal that its networks do not see, see
            `smp_planner.agents.goal_view.GoalView`.
        action_repeat: environment steps that a decision lasts.
        gripper_openings: exploration by opening the hand, arguments ``probability`` and
            ``decisions`` of `smp_planner.agents.decisions.GripperOpenings`; None for none.
        sac: arguments of `stable_baselines3.SAC`; a ``learning_rate`` with ``start`` and ``end``
            changes linearly over the training.
        her: arguments of `stable_baselines3.HerReplayBuffer`; None for none.
    """

    environments: int
    observations: list[str] | None
    hidden: list[str]
    action_repeat: int
    gripper_openings: dict[str, Any] | None
    sac: dict[str, Any]
    her: dict[str, Any] | None

    @classmethod
    def from_json(cls, path: Path) -> HyperParameters:
        """Read hyper-parameters.

        Args:
            path: a JSON file with an entry for each attribute.

        Raises:
            OSError: there is no such file.
            ValueError: the file is not JSON, or its entries are not those of this class.
        """
        try:
            entries = json.loads(path.read_text())
        except json.JSONDecodeError as error:
            raise ValueError(f"{path} must be JSON: {error}") from None
        names = [field.name for field in fields(cls)]
        if not isinstance(entries, dict) or set(entries) != set(names):
            found = sorted(entries) if isinstance(entries, dict) else type(entries).__name__
            raise ValueError(f"{path} must have the entries {', '.join(names)}; got {found}")
        settings = cls(**entries)
        if not (isinstance(settings.environments, int) and settings.environments >= 1):
            raise ValueError(
                f"environments in {path} must be at least 1, got {settings.environments!r}"
            )
        if not (isinstance(settings.action_repeat, int) and settings.action_repeat >= 1):
            raise ValueError(
                f"action_repeat in {path} must be at least 1, got {settings.action_repeat!r}"
            )
        openings = settings.gripper_openings
        if openings is not None and not (
            isinstance(openings, dict)
            and set(openings) == {"probability", "decisions"}
            and all(isinstance(value, (int, float)) for value in openings.values())
            and 0.0 < openings["probability"] <= 1.0
            and openings["decisions"] >= 1
        ):
            raise ValueError(
                f"gripper_openings in {path} must be null or have a probability above 0, at most "
                f"1, and a number of decisions of at least 1; got {openings!r}"
            )
        known = list(observation_space(TASKS[0]))
        if settings.observations is not None and not (
            isinstance(settings.observations, list)
            and set(GOAL_CONDITIONED) <= set(settings.observations) <= set(known)
        ):
            raise ValueError(
                f"observations in {path} must be null or of {', '.join(known)}, with "
                f"{', '.join(GOAL_CONDITIONED)} among them; "
                f"got {settings.observations!r}"
            )
        rate = settings.sac.get("learning_rate", 3e-4)
        rates = [rate.get(name) for name in ("start", "end")] if isinstance(rate, dict) else [rate]
        if not all(isinstance(value, int | float) and value > 0.0 for value in rates) or (
            isinstance(rate, dict) and len(rate) != 2
        ):
            raise ValueError(
                f"sac.learning_rate in {path} must be positive, or have a positive start and end; "
                f"got {rate!r}"
            )
        if settings.her is not None:
            decisions = -(-MAX_EPISODE_STEPS // settings.action_repeat)
            needed = settings.environments * decisions
            if settings.sac.get("learning_starts", 0) < needed:
                raise ValueError(
                    f"sac.learning_starts in {path} must be at least {needed}, for HER samples "
                    f"from whole episodes; got {settings.sac.get('learning_starts', 0)}"
                )
        return settings
