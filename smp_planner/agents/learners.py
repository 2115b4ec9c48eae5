"""Untrained agents of stable-baselines3 for the tasks."""

from __future__ import annotations

from smp_gym.optional_packages import require

require("rl", "smp_planner.agents.learners")

from typing import Any

from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import VectorizedActionNoise
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv

from smp_planner.agents.decisions import ACTION_REPEAT, CPU_SECONDS
from smp_planner.agents.demonstrated_sac import DemonstratedSAC
from smp_planner.agents.exploration import GripperOpenings
from smp_planner.agents.goal_features import GoalFeatures
from smp_planner.agents.hyper_parameters import HyperParameters
from smp_planner.agents.normed_critics import NormedCriticsPolicy
from smp_planner.agents.shown_decisions import ShownReplayBuffer

__all__ = ["class_of", "make_model"]


def class_of(settings: HyperParameters) -> type[BaseAlgorithm]:
    """Return the class of an agent."""
    if settings.demonstrations is not None:
        return DemonstratedSAC
    classes: dict[str, type[BaseAlgorithm]] = {"SAC": SAC, "PPO": PPO}
    return classes[settings.algorithm]


def make_model(env: VecEnv, task: str, settings: HyperParameters, seed: int) -> BaseAlgorithm:
    """Return an untrained agent.

    Args:
        env: to train in; its actions last as long as the settings say.
        task: of the environment.
        settings: its hyper-parameters.
        seed: of weights and exploration.

    Raises:
        ValueError: the algorithm has no argument of such a name, or the goals no such field.
    """
    policy = {
        "features_extractor_class": GoalFeatures,
        "features_extractor_kwargs": {"task": task, "hidden": settings.hidden},
        **settings.arguments.get("policy_kwargs", {}),
    }
    arguments: dict[str, Any] = {**settings.arguments, "policy_kwargs": policy}
    rate = settings.arguments.get("learning_rate")
    if isinstance(rate, dict):
        arguments["learning_rate"] = LinearSchedule(rate["start"], rate["end"], 1.0)
    if settings.gripper_openings is not None:
        openings = GripperOpenings(seed=seed, **settings.gripper_openings.model_dump())
        if settings.environments > 1:
            arguments["action_noise"] = VectorizedActionNoise(openings, settings.environments)
        else:
            arguments["action_noise"] = openings
    if settings.her is not None:
        arguments["replay_buffer_class"] = HerReplayBuffer
        arguments["replay_buffer_kwargs"] = dict(settings.her)
    if settings.demonstrations is not None:
        arguments["replay_buffer_class"] = ShownReplayBuffer
        arguments["replay_buffer_kwargs"] = {"share": settings.demonstrations.share}
        arguments["demonstrations"] = settings.demonstrations
    algorithm: Any = class_of(settings)
    policies = "MultiInputPolicy" if settings.demonstrations is None else NormedCriticsPolicy
    try:
        model: BaseAlgorithm = algorithm(policies, env, seed=seed, device="cpu", **arguments)
    except TypeError as error:
        raise ValueError(f"the hyper-parameters do not fit: {error}") from None
    # What stable-baselines3 saves of an agent are its attributes.
    setattr(model, ACTION_REPEAT, settings.action_repeat)
    setattr(model, CPU_SECONDS, 0.0)
    return model
