"""The demonstrator of ReachPoint: witnesses, executed."""

import gymnasium
import numpy as np

from smp_gym.datasets.demonstrations import resample
from smp_gym.observation import state_field
from smp_gym.sampling import sample_with_witness
from smp_gym.tasks.performance import Performance, collect, measured, perform


def demonstrate(report):
    return collect(performances(), np.ones(200), report)


def stopped(moment):
    """Success, which ends an episode, does not end the movement."""
    return moment.info["collided"] or moment.truncated


def performances():
    env = gymnasium.make("smp_gym/ReachPoint-v3")
    for seed in range(2):
        scene, movement = sample_with_witness("ReachPoint", "none", seed)
        targets = resample(movement, 161)[1:]
        moments = perform(env, scene, targets, np.zeros(len(targets)), ends=stopped)
        fingers = state_field(moments[0].observation, "finger_angles")
        yield Performance(scene, movement, 8.0, measured(moments), fingers, moments[-1].info)
    env.close()
