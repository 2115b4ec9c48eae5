"""Figures 3 to 6: what they show, and that what they promise is playable."""

import gymnasium
import imageio.v2 as imageio
import numpy as np

from smp_gym.robot.kinematics import GRASP_CENTER, end_effector_pose
from smp_gym.rollout import rollout
from smp_gym.scene import PAD_DEPTH
from smp_gym.tasks.double_sided_placement.rules import NOMINAL_PADS, START_CONFIGURATION
from smp_planner.experiments.particle_figures import (
    SHIFT,
    draw_before_and_after,
    modulated_scene,
)
from smp_planner.experiments.table_two.scenes import load_scenes
from smp_planner.policy.planner_policy import PlannerPolicy


def _count(picture, color):
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return int((np.abs(picture.astype(int) - rgb).max(axis=-1) < 12).sum())


def test_adaptation_turns_what_fails_into_what_succeeds(tmp_path):
    path = tmp_path / "particles.png"
    draw_before_and_after([load_scenes()["Placement"]], path)
    picture = imageio.imread(path)[..., :3]
    before, after = np.array_split(picture, 2)
    assert _count(before, "#ea8585") > 500
    assert _count(before, "#7fa3ee") < 0.2 * _count(before, "#ea8585")
    assert _count(after, "#7fa3ee") > 500
    assert _count(after, "#ea8585") < 0.2 * _count(after, "#7fa3ee")


def test_the_new_start_and_ends_are_elsewhere_and_both_sides_are_reached():
    scene = modulated_scene()
    left, right = (np.array(goal.position) for goal in scene.goals)
    np.testing.assert_allclose(left, np.array(NOMINAL_PADS[0]) - (0.0, SHIFT, 0.0))
    np.testing.assert_allclose(right, (*NOMINAL_PADS[1][:2], PAD_DEPTH))
    grasp = np.append(GRASP_CENTER, 1.0)
    new, old = (end_effector_pose(np.array(q)) @ grasp for q in (scene.start, START_CONFIGURATION))
    assert np.linalg.norm(new - old) > 0.08
    env = gymnasium.make("smp_gym/DoubleSidedPlacement-v0")
    observation, _ = env.reset(options={"scene": scene})
    policy = PlannerPolicy.make("smp", scene.task)
    (plan,) = policy.planner.plan([policy.problem(observation)])
    sides = plan.signatures[plan.best_of_modes, 0]
    assert set(sides) == {0, 1}
    best = plan.best_of_modes[[int(np.flatnonzero(sides == side)[0]) for side in (0, 1)]]
    tracks = [policy.track(plan, int(particle)) for particle in best]
    assert all(rollout(env, track, scene=scene).success for track in tracks)
    env.close()
