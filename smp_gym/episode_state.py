"""The state of an episode as plain data: from where it began, and all that was done since."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smp_gym.observation import ObjectState, RobotState
from smp_gym.scene import Scene

__all__ = ["EpisodeState", "fingerprint"]


@dataclass(frozen=True, eq=False)
class EpisodeState:
    """One moment of one episode; made by `ManipulationEnv.save_state`.

    It holds no snapshot of the physics engine. Such snapshots leave out in which order bodies came
    near each other and what the solver carries over from step to step, so that an episode continued
    from one can differ in the last bits. An episode played again from its start does not.

    It is independent of the environment that made it, can be pickled, and takes 56 bytes for each
    step that was played.

    Attributes:
        scene: of the episode.
        actions: (steps, 7) what moved the arm since the start: joint velocities as fractions of
            their limits and the gripper's rate, whatever the control mode was.
        generator: state of the environment's ``np_random``.
        generator_seed: the seed that it was made with.
        fingerprint: of the moment's robot and object state, by which a restored one is checked.
    """

    scene: Scene
    actions: NDArray[np.float64]
    generator: Mapping[str, Any]
    generator_seed: int
    fingerprint: bytes


def fingerprint(robot: RobotState, manipulated: ObjectState) -> bytes:
    """Return a digest of all bits of a measured state."""
    digest = hashlib.blake2b(digest_size=16)
    for part in (robot, manipulated):
        for value in vars(part).values():
            digest.update(np.asarray(value, np.float64).tobytes())
    return digest.digest()
