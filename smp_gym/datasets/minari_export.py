"""Demonstrations as data sets of Minari, and back; needs the extra ``minari``.

A data set holds one episode for each demonstration, played in the environment: observations,
actions, rewards, endings and infos, as any offline learner reads them. Beside each episode lie the
scene it was played in (so that it can be played again, bit for bit) and the demonstration itself
(so that it comes back exactly).
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from smp_gym.datasets.demonstrations import FORMAT_VERSION, Demonstrations
from smp_gym.optional_packages import require
from smp_gym.registration import environment_id
from smp_gym.rollout import Moment, Policy, rollout
from smp_gym.scene import DIFFICULTIES, Scene

if TYPE_CHECKING:
    from minari import MinariDataset
    from minari.data_collector import EpisodeBuffer

__all__ = [
    "dataset_path",
    "default_dataset_id",
    "export_demonstrations",
    "import_demonstrations",
]

AUTHOR = "Stein Movement Primitives contributors"

_HEADER = "smp_gym_demonstrations"
_PARTIAL = ".partial-"
_PACKAGES = ("gymnasium", "numpy", "pybullet")


def _require_minari() -> None:
    require("minari", "exporting a data set of Minari")


def default_dataset_id(task: str) -> str:
    """Return the id under which the demonstrations of a task are kept."""
    return f"smp_gym/{task}/demonstrations-v{FORMAT_VERSION}"


def dataset_path(dataset_id: str) -> Path:
    """Return the folder of a data set, below ``MINARI_DATASETS_PATH`` or ``~/.minari/datasets``.

    Raises:
        ImportError: Minari is not installed.
        ValueError: that is no id.
    """
    _require_minari()
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.storage.datasets_root_dir import get_dataset_path

    try:
        parse_dataset_id(dataset_id)
    except (TypeError, ValueError):
        raise ValueError(
            f"dataset_id must be like 'namespace/name-v0', got {dataset_id!r}"
        ) from None
    return Path(get_dataset_path(dataset_id))


def export_demonstrations(
    demonstrations: Demonstrations,
    policies: Sequence[Policy],
    dataset_id: str | None = None,
    *,
    difficulty: str = "medium",
    overwrite: bool = False,
    finished: Callable[[int], None] | None = None,
) -> MinariDataset:
    """Play demonstrations and write them as a data set of Minari.

    All are played before anything is written, and the data set is moved to its place as a whole:
    an export that fails leaves things as they were.

    Args:
        demonstrations: what to export.
        policies: for each demonstration what executes it, such as
            `smp_planner.policy.tracking.Track`.
        dataset_id: by default `default_dataset_id` of the task.
        difficulty: of the environment that the data set brings, whose `reset` draws new scenes.
        overwrite: whether to replace a data set of this id.
        finished: called with the number of each demonstration that has been played.

    Returns:
        The data set, as `minari.load_dataset` gives it.

    Raises:
        ImportError: Minari is not installed.
        ValueError: no such difficulty, no such id, or not one of `policies` for each demonstration.
        FileExistsError: there is a data set of this id, and `overwrite` is False.
        RuntimeError: an episode did not end in success; the message says which, and why.
    """
    _require_minari()
    from minari import MinariDataset
    from minari.storage.datasets_root_dir import get_dataset_path

    dataset_id = default_dataset_id(demonstrations.task) if dataset_id is None else dataset_id
    path = dataset_path(dataset_id)
    if difficulty not in DIFFICULTIES:
        allowed = ", ".join(DIFFICULTIES)
        raise ValueError(f"difficulty must be one of {allowed}; got {difficulty!r}")
    if len(policies) != len(demonstrations):
        raise ValueError(
            f"policies must hold one for each of {len(demonstrations)} demonstrations, got "
            f"{len(policies)}"
        )
    if path.exists() and not overwrite:
        raise FileExistsError(f"there is a data set {dataset_id} in {path}: overwrite it, or not")
    env = gymnasium.make(environment_id(demonstrations.task), difficulty=difficulty)
    episodes = []
    try:
        for number, scene in enumerate(demonstrations.scenes):
            episodes.append(_played(env, number, scene, policies[number]))
            if finished is not None:
                finished(number)
    finally:
        env.close()
    with tempfile.TemporaryDirectory(prefix=_PARTIAL, dir=get_dataset_path()) as folder:
        new = Path(folder) / "new"
        _write(new / "data", dataset_id, env, demonstrations, episodes)
        _make_namespace(dataset_id)
        if path.exists():
            os.replace(path, Path(folder) / "old")
        os.replace(new, path)
    return MinariDataset(path / "data")


def _played(
    env: gymnasium.Env[Any, Any], number: int, scene: Scene, policy: Policy
) -> EpisodeBuffer:
    """Play one demonstration; raise RuntimeError unless it succeeds."""
    from minari.data_collector import EpisodeBuffer

    moments: list[Moment] = []
    played = rollout(env, policy, scene=scene, recorders=(moments.append,))
    if not played.success:
        raise RuntimeError(f"demonstration {number + 1} did not succeed: {played.info['failure']}")
    steps = moments[1:]
    # None, which stands for no collision and for no seed, cannot be stored.
    kept = [key for key, value in played.info.items() if isinstance(value, bool | float | str)]
    return EpisodeBuffer(
        id=number,
        # Data sets keep plain values only.
        options={"scene": scene.to_json()},
        observations={
            key: np.stack([moment.observation[key] for moment in moments]) for key in played.first
        },
        actions=np.stack([moment.action for moment in steps]),
        rewards=[moment.reward for moment in steps],
        terminations=[moment.terminated for moment in steps],
        truncations=[moment.truncated for moment in steps],
        infos={key: [moment.info[key] for moment in moments] for key in kept},
    )


def _write(
    folder: Path,
    dataset_id: str,
    env: gymnasium.Env[Any, Any],
    demonstrations: Demonstrations,
    episodes: list[EpisodeBuffer],
) -> None:
    import minari
    from minari.dataset.minari_storage import MinariStorage

    task = demonstrations.task
    folder.mkdir(parents=True)
    storage = MinariStorage.new(
        folder,
        observation_space=env.observation_space,
        action_space=env.action_space,
        env_spec=env.spec,
    )
    storage.update_episodes(episodes)
    storage.update_episode_metadata(
        {
            "configurations": demonstrations.configurations[number],
            "gripper": demonstrations.gripper[number],
            "duration": demonstrations.durations[number],
            "rewards_sum": sum(episode.rewards),
        }
        for number, episode in enumerate(episodes)
    )
    header = {"version": FORMAT_VERSION, "task": task, "metadata": demonstrations.metadata}
    storage.update_metadata(
        {
            "dataset_id": dataset_id,
            "minari_version": minari.__version__,
            "author": {AUTHOR},
            "algorithm_name": "scripted demonstrator",
            "description": f"{len(demonstrations)} demonstrations of {task} with a JACO arm in "
            "PyBullet, each ending in success. The metadata of an episode hold its scene "
            "(`env.reset(options=metadata['options'])` begins it again) and the demonstration: "
            "configurations (T, 6) rad at equal steps of phase, gripper (T,) and duration in s.",
            "requirements": [f"{name}=={metadata.version(name)}" for name in _PACKAGES],
            _HEADER: json.dumps(header),
        }
    )


def _make_namespace(dataset_id: str) -> None:
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.namespace import create_namespace, list_local_namespaces

    namespace = parse_dataset_id(dataset_id)[0]
    if namespace is not None and namespace not in list_local_namespaces():
        create_namespace(namespace)


def import_demonstrations(dataset: MinariDataset | str) -> Demonstrations:
    """Return the demonstrations that `export_demonstrations` wrote, exactly.

    Args:
        dataset: the data set or its id; also some of its episodes, as ``filter_episodes`` gives
            them.

    Raises:
        ImportError: Minari is not installed.
        FileNotFoundError: there is no data set of this id.
        ValueError: the data set is damaged or holds something else; the message names it.
    """
    _require_minari()
    import minari

    name = dataset if isinstance(dataset, str) else dataset.id
    try:
        found = minari.load_dataset(dataset) if isinstance(dataset, str) else dataset
        stored: Mapping[str, Any] = found.storage.metadata
        if _HEADER not in stored:
            raise ValueError("it was not exported by smp_gym")
        header = json.loads(stored[_HEADER])
        if header["version"] != FORMAT_VERSION:
            raise ValueError(f"version must be {FORMAT_VERSION}, got {header['version']!r}")
        rows = list(found.storage.get_episode_metadata(found.episode_indices))
        return Demonstrations(
            task=header["task"],
            configurations=np.array([row["configurations"] for row in rows]),
            gripper=np.array([row["gripper"] for row in rows]),
            durations=np.array([row["duration"] for row in rows]),
            scenes=tuple(Scene.from_json(row["options"]["scene"]) for row in rows),
            metadata=header["metadata"],
        )
    except FileNotFoundError:
        raise
    except Exception as error:
        # Damaged files make h5py, json and Minari itself raise almost anything.
        raise ValueError(f"{name} is not a data set of demonstrations: {error}") from error
