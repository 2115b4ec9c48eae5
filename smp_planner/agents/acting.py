"""Agents that act in an episode beside the planners: stable-baselines3's, and random actions.

All of them have the interface of stable-baselines3's agents, `smp_gym.rollout.Policy`. What an
agent sees of an observation is decided by its own observation space, which its file holds: the
entries of a `Dict` by their keys, or all of it as one flat vector. How long a decision lasts, its
file says, too; see `smp_planner.agents.decisions`.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, cast
from zipfile import BadZipFile

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from smp_gym.observation import Sensing, observation_space
from smp_gym.rollout import Policy
from smp_gym.untrusted_files import read_file, read_members
from smp_planner.agents.actor_file import read_actor
from smp_planner.agents.decisions import acting
from smp_planner.agents.shipped import TRAINED_BY
from smp_planner.planners.card_file import shipped_agent

__all__ = ["RandomActions", "ViewingAgent", "load_shipped", "load_zip"]

_ACTIONS = spaces.Box(-1.0, 1.0, (7,), np.float32)

_LIBRARIES = ("stable_baselines3", "sb3_contrib")


class RandomActions:
    """A policy that draws every action uniformly from the action space.

    The generator is seeded from the first observation of the episode, so the same episode always
    sees the same actions.
    """

    def predict(
        self,
        observation: Mapping[str, NDArray[Any]],
        state: np.random.Generator | None = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.float32], np.random.Generator]:
        """Return an action (7,), and the generator as the state.

        Args:
            observation: one observation, as dict.
            state: what the last call returned; None in the beginning of an episode.
            episode_start: accepted for the interface, unused.
            deterministic: accepted for the interface, unused.
        """
        if state is None:
            content = b"".join(observation[key].tobytes() for key in sorted(observation))
            seed = int.from_bytes(blake2b(content, digest_size=8).digest(), "little")
            state = np.random.default_rng(seed)
        return state.uniform(_ACTIONS.low, _ACTIONS.high).astype(np.float32), state


@dataclass(frozen=True)
class ViewingAgent:
    """An agent that sees of an observation what it was trained on.

    Attributes:
        agent: acts.
        space: of the observations that it was trained on.
        name: of it, for errors.
    """

    agent: Policy
    space: spaces.Space[Any]
    name: str

    def check(self, task: str, sensing: str) -> None:
        """Raise ValueError unless observations of a task are what the agent was trained on.

        Args:
            task: of the environment.
            sensing: of the environment.
        """
        given = observation_space(task, cast(Sensing, sensing))
        own = self.space
        if isinstance(own, spaces.Dict):
            missing = sorted(set(own) - set(given))
            # `in` asks a space whether it holds a value, not whether it has a key.
            shapes = {
                key: (own[key].shape, given[key].shape)
                for key in set(own) & set(given)
                if own[key].shape != given[key].shape
            }
            if missing or shapes:
                wrong = [f"no entry {key!r}" for key in missing]
                wrong += [
                    f"{key!r} of shape {is_}, not {was}" for key, (was, is_) in shapes.items()
                ]
                raise ValueError(
                    f"agent {self.name!r} was trained on other observations than those of {task} "
                    f"with sensing {sensing!r}, which have {', '.join(wrong)}; their entries are "
                    f"{', '.join(given)}"
                )
        elif own.shape != (spaces.flatdim(given),):
            raise ValueError(
                f"agent {self.name!r} was trained on observations {own}; those of {task} with "
                f"sensing {sensing!r} are a Dict of {', '.join(given)}, or "
                f"({spaces.flatdim(given)},) when flattened"
            )

    def predict(
        self,
        observation: Mapping[str, NDArray[Any]],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Return the agent's action for what it sees of an observation, and its state."""
        seen: Any
        if isinstance(self.space, spaces.Dict):
            seen = {key: observation[key] for key in self.space}
        else:
            # As `gymnasium.spaces.flatten` has it: the keys of a space are in alphabetical order.
            seen = np.concatenate([np.ravel(observation[key]) for key in sorted(observation)])
        return self.agent.predict(seen, state, episode_start, deterministic)


def load_shipped(name: str, task: str) -> ViewingAgent:
    """Return an agent whose actor is shipped.

    Args:
        name: of its method.
        task: that it was trained for.

    Raises:
        ValueError: none is shipped for the task.
    """
    try:
        actor, card = read_actor(shipped_agent(name, task))
    except FileNotFoundError as error:
        raise ValueError(
            f"no agent {name} is shipped for {task} ({error.filename}): train one with "
            f"scripts/{TRAINED_BY[name]}, then write it there with scripts/ship_agent.py"
        ) from None
    own = observation_space(task)
    space = spaces.Dict({key: own[key] for key in card.entries})
    return ViewingAgent(acting(actor), space, name)


def _policy_module(entry: Any, path: Path) -> str:
    """Return the module of a policy, or that of its nearest base in one of the libraries.

    Raises:
        ValueError: it is a policy of another module that cannot be loaded.
    """
    module = str(entry.get("__module__", "")) if isinstance(entry, Mapping) else ""
    if not module or module.partition(".")[0] in _LIBRARIES:
        return module
    try:
        from stable_baselines3.common.save_util import json_to_data

        policy = json_to_data(json.dumps({"policy_class": entry}))["policy_class"]
    except Exception as error:
        raise ValueError(
            f"{path} has a policy of the module {module}, which cannot be loaded: "
            f"{type(error).__name__}: {error}"
        ) from None
    modules = [base.__module__ for base in getattr(policy, "__mro__", ())]
    return next((each for each in modules if each.partition(".")[0] in _LIBRARIES), module)


def _algorithm(data: Mapping[str, Any], path: Path) -> Any:
    """Return the class that saved an agent, told from the module of its policy and its arguments.

    Raises:
        ValueError: it cannot be told, or its package is not installed.
    """
    module = _policy_module(data.get("policy_class"), path)
    package, _, rest = module.partition(".")
    name = rest.partition(".")[0]
    if name == "common":
        # Of the two that share the policies, only one clips.
        name = "ppo" if "clip_range" in data else "a2c"
    if package not in _LIBRARIES or not name.isidentifier():
        raise ValueError(f"{path} must be an agent that stable-baselines3 saved, got {module!r}")
    try:
        algorithms = importlib.import_module(package)
    except ImportError as error:
        raise ValueError(
            f'{path} needs the package {package}: {error} (pip install "smp-gym[rl]")'
        ) from None
    for found in vars(algorithms).values():
        if isinstance(found, type) and found.__name__.lower() == name.replace("_", ""):
            return found
    raise ValueError(f"{path} is of the algorithm {name!r}, which {package} has not")


def load_zip(path: Path, name: str) -> ViewingAgent:
    """Return an agent that stable-baselines3 saved, on the processor.

    Loading runs code that the file holds, pickled: load only files that you trust.

    Args:
        path: of the zip.
        name: of the agent, for errors.

    Raises:
        ValueError: there is no such file, it is no such agent, or its actions are not (7,) in
            [-1, 1].
    """
    try:
        members = read_members(read_file(path), str(path))
        data = json.loads(members["data"])
    except (OSError, BadZipFile, KeyError, ValueError) as error:
        raise ValueError(
            f"agent {name!r}: {path} must be an agent that stable-baselines3 saved: {error}"
        ) from None
    algorithm = _algorithm(data, path)
    # What only training needs; a replay buffer would take hundreds of megabytes.
    unused: dict[str, Any] = {
        "replay_buffer_class": None,
        "replay_buffer_kwargs": {},
        "buffer_size": 1,
    }
    replaced = {key: value for key, value in unused.items() if key in data}
    load: Callable[..., Any] = algorithm.load
    try:
        agent = load(path, device="cpu", custom_objects=replaced)
    except Exception as error:
        raise ValueError(
            f"agent {name!r}: {path} cannot be loaded as {algorithm.__name__}: "
            f"{type(error).__name__}: {error}"
        ) from error
    actions = agent.action_space
    if not isinstance(actions, spaces.Box) or actions != _ACTIONS:
        raise ValueError(f"agent {name!r} must act in {_ACTIONS}, got {actions}")
    try:
        return ViewingAgent(acting(agent), agent.observation_space, name)
    except ValueError as error:
        raise ValueError(f"agent {name!r}: {error}") from None
