"""The demonstrator of ReachPoint: witnesses, executed."""

import gymnasium
import numpy as np

from smp_gym.datasets.demonstrations import resample
from smp_gym.sampling import sample_with_witness
from smp_gym.tasks.performance import Performance, Performer, collect


def demonstrate(report):
    return collect(performances(), np.ones(200), report)


def performances():
    env = gymnasium.make("smp_gym/ReachPoint-v3")
    for seed in range(2):
        scene, movement = sample_with_witness("ReachPoint", "none", seed)
        player = Performer(env, scene, to_the_end=True)
        for target in resample(movement, 161)[1:]:
            player.step(target, 0.0)
        fingers = player.state.robot.finger_angles
        yield Performance(scene, movement, 8.0, np.array(player.measured), fingers, player.info)
    env.close()
