"""Hyper-parameters of stable-baselines3's agents, named in a JSON file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from smp_gym.observation import MAX_EPISODE_STEPS, observation_space
from smp_gym.scene import TASKS
from smp_planner.agents.goal_view import GOAL_CONDITIONED
from smp_planner.agents.training_folder import named_settings
from smp_planner.strict_settings import StrictSettings

__all__ = ["LEARNERS", "DemonstrationSettings", "GripperOpeningSettings", "HyperParameters"]

LEARNERS = ("sac_her", "sac_demonstrations", "sac_dense", "ppo")
"""Names of the agents that stable-baselines3 trains."""

_OBSTACLES = "obstacles"


class GripperOpeningSettings(StrictSettings):
    """Exploration by opening the hand, see `smp_planner.agents.exploration.GripperOpenings`.

    Attributes:
        probability: that an opening begins with a decision.
        decisions: that it lasts.
    """

    probability: float = Field(gt=0.0, le=1.0)
    decisions: int = Field(ge=1)


class DemonstrationSettings(StrictSettings):
    """Settings of learning from demonstrations, see `smp_planner.agents.demonstrated_sac`.

    Attributes:
        episodes: of `smp`, those that fail left out.
        stride: control steps from the beginning of one decision that is shown to that of the next;
            null for as many as a decision lasts. With fewer, decisions overlap, and an episode
            shows more of them.
        share: of each batch that is drawn from them.
        cloning_steps: steps of the gradient, before the training, in which the actor learns to do
            what was shown.
        noise: standard deviation of what is added to an action that is cloned, as a share of its
            range.
        critic_decisions: number of decisions in which the critics alone learn.
        critic_steps: times the steps of the gradient that they take in them.
        actor_rate: learning rate of the actor after them, as a share of the critics'.
        pull: weight of the squared distance to the actions that were shown, in the actor's loss.
    """

    episodes: int = Field(default=100, ge=1)
    stride: int | None = Field(default=None, ge=1)
    share: float = Field(default=0.5, gt=0.0, lt=1.0)
    cloning_steps: int = Field(default=3000, ge=0)
    noise: float = Field(default=0.1, gt=0.0, le=1.0)
    critic_decisions: int = Field(default=1000, ge=0)
    critic_steps: int = Field(default=2, ge=1)
    actor_rate: float = Field(default=0.1, gt=0.0, allow_inf_nan=False)
    pull: float = Field(default=100.0, ge=0.0, allow_inf_nan=False)


class HyperParameters(StrictSettings):
    """Hyper-parameters of one agent.

    Attributes:
        algorithm: a class of stable-baselines3.
        reward: of the environment, "sparse" or "dense".
        environments: stepped in turn, in this process.
        observations: entries of the observation that the agent sees; None for all, where there are
            obstacles, and all others where there are none.
        hidden: fields of the desired goal that its networks do not see, see
            `smp_planner.agents.goal_view.GoalView`.
        action_repeat: environment steps that a decision lasts.
        gripper_openings: exploration by opening the hand, of SAC; None for none.
        arguments: of the algorithm; a ``learning_rate`` with ``start`` and ``end`` changes linearly
            over the training.
        her: arguments of `stable_baselines3.HerReplayBuffer`, of SAC; None for none.
        demonstrations: what is shown to an agent of SAC without hindsight, on the sparse reward and
            with a fixed ``ent_coef``; None for nothing.
    """

    algorithm: Literal["SAC", "PPO"] = "SAC"
    reward: Literal["sparse", "dense"] = "sparse"
    environments: int = Field(default=1, ge=1)
    observations: tuple[str, ...] | None = None
    hidden: tuple[str, ...] = ()
    action_repeat: int = Field(default=5, ge=1)
    gripper_openings: GripperOpeningSettings | None = None
    arguments: dict[str, Any] = Field(default_factory=dict)
    her: dict[str, Any] | None = None
    demonstrations: DemonstrationSettings | None = None

    @field_validator("observations")
    @classmethod
    def _observations_are_known(cls, names: tuple[str, ...] | None) -> tuple[str, ...] | None:
        known = list(observation_space(TASKS[0]))
        if names is not None and not set(GOAL_CONDITIONED) <= set(names) <= set(known):
            raise ValueError(
                f"must be null or of {', '.join(known)}, with {', '.join(GOAL_CONDITIONED)} among "
                f"them; got {list(names)!r}"
            )
        return names

    @field_validator("arguments")
    @classmethod
    def _rate_is_positive(cls, arguments: dict[str, Any]) -> dict[str, Any]:
        rate = arguments.get("learning_rate", 3e-4)
        rates = [rate.get(name) for name in ("start", "end")] if isinstance(rate, dict) else [rate]
        if not all(isinstance(value, int | float) and value > 0.0 for value in rates) or (
            isinstance(rate, dict) and len(rate) != 2
        ):
            raise ValueError(
                f"learning_rate must be positive, or have a positive start and end; got {rate!r}"
            )
        return arguments

    @model_validator(mode="after")
    def _parts_fit(self) -> HyperParameters:
        if self.algorithm != "SAC":
            for name in ("gripper_openings", "her", "demonstrations"):
                if getattr(self, name) is not None:
                    raise ValueError(f"{name} must be null but for SAC, got it for PPO")
        if self.demonstrations is not None and self.her is not None:
            raise ValueError("demonstrations must be null where her is not, got both")
        if self.demonstrations is not None:
            if self.reward != "sparse":
                raise ValueError(
                    "reward must be sparse with demonstrations, whose critics know its bounds; got "
                    f"{self.reward}"
                )
            entropy = self.arguments.get("ent_coef", "auto")
            if isinstance(entropy, bool) or not isinstance(entropy, int | float) or entropy < 0.0:
                raise ValueError(
                    f"ent_coef must be a number from 0 on with demonstrations, got {entropy!r}"
                )
        needed = self.environments * -(-MAX_EPISODE_STEPS // self.action_repeat)
        starts = self.arguments.get("learning_starts", 0)
        if self.her is not None and starts < needed:
            raise ValueError(
                f"learning_starts must be at least {needed}, for HER samples from whole episodes; "
                f"got {starts}"
            )
        return self

    @classmethod
    def from_json(cls, path: Path, agent: str, task: str) -> HyperParameters:
        """Read hyper-parameters: those of ``"*"`` in a JSON file, a task's, an agent's, and both's.

        Args:
            path: of the file; an entry such as ``"sac_her Placement"`` is an agent's for a task.
            agent: one of `LEARNERS`, or another that the file names.
            task: one of `smp_gym.scene.TASKS`.

        Raises:
            OSError: there is no such file.
            ValueError: it is not JSON, or a hyper-parameter is unknown or out of range.
        """
        return cls.model_validate(named_settings(path, "*", task, agent, f"{agent} {task}"))

    def seen(self, difficulty: str) -> tuple[str, ...]:
        """Return the entries of the observation that the agent sees at a difficulty."""
        if self.observations is not None:
            return self.observations
        names = tuple(observation_space(TASKS[0]))
        return tuple(name for name in names if difficulty != "none" or name != _OBSTACLES)
