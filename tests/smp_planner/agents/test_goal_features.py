"""What the networks of an agent see, against the observation's own layout."""

import numpy as np
import pytest
import torch

from smp_gym.env import ManipulationEnv
from smp_gym.observation import observation_space, state_field
from smp_planner.agents.exploration import GripperOpenings
from smp_planner.agents.goal_features import GoalFeatures

FLAGS = ("collided", "released", "at_rest", "supported")


def as_tensors(observations):
    return {key: torch.tensor(np.stack([o[key] for o in observations])) for key in observations[0]}


@pytest.mark.parametrize("task", ["Placement", "DoubleSidedPlacement"])
def test_goals_that_differ_in_hidden_fields_look_alike(task):
    env = ManipulationEnv(task, "none")
    observation, _ = env.reset(seed=0)
    other = {key: value.copy() for key, value in observation.items()}
    for name in FLAGS:
        other["desired_goal"][env.task.goals.columns(name)] = 0.25
    seen = as_tensors([observation, other])
    one, same = GoalFeatures(observation_space(task), task, FLAGS)(seen)
    assert torch.equal(one, same)
    one, differs = GoalFeatures(observation_space(task), task)(seen)
    assert not torch.equal(one, differs)
    env.close()


def test_offsets_lead_from_the_object_to_its_goal_and_to_the_bin():
    env = ManipulationEnv("Placement", "none")
    observation, _ = env.reset(seed=0)
    # As hindsight does it: another goal, the bin stays.
    observation["desired_goal"][:3] = (0.3, -0.2, 0.5)
    features = GoalFeatures(observation_space("Placement"), "Placement", FLAGS)
    row = features(as_tensors([observation]))[0]
    assert row.shape == (features.features_dim,)
    object_position = state_field(observation, "object_position")
    offsets = row[-(7 + 6) :].double().numpy() / 5.0
    np.testing.assert_allclose(offsets[:3], (0.3, -0.2, 0.5) - object_position, atol=1e-5)
    bin_position = np.array(env.scene.goals[0].position)
    np.testing.assert_allclose(offsets[7:10], bin_position - object_position, atol=1e-5)
    np.testing.assert_array_equal(offsets[3:7], 0.0)
    env.close()


def test_openings_are_as_frequent_and_as_long_as_said():
    noise = GripperOpenings(probability=0.05, decisions=4, seed=0)
    rows = np.array([noise() for _ in range(20_000)])
    assert not rows[:, :6].any()
    opened = rows[:, 6] == -2.0
    assert (opened | (rows[:, 6] == 0.0)).all()
    # Openings of 4 decisions, each after 1 / 0.05 - 1 = 19 decisions without in the mean.
    assert opened.mean() == pytest.approx(4 / 23, abs=0.01)
    edges = np.flatnonzero(np.diff(opened.astype(int)))
    lengths = np.diff(edges)[opened[edges[:-1] + 1]]
    assert (lengths % 4 == 0).all()
    opening = next(n for n in range(1000) if noise()[6])
    assert opening >= 0
    noise.reset()
    assert sum(noise()[6] != 0 for _ in range(3)) < 3
