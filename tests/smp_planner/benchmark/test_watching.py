"""What `smp-bench watch` shows of an episode that is played."""

import gymnasium
import numpy as np
import pytest

import smp_gym  # noqa: F401
from smp_gym.geometry.distance import signed_distance
from smp_gym.robot import kinematics
from smp_gym.suites import Cell
from smp_planner.benchmark.episodes import EpisodeKey
from smp_planner.benchmark.manifest import make_manifest
from smp_planner.benchmark.watching_command import exhibit_of_episode

CELL = Cell("Placement", "easy")
DEPTH = Cell("Placement", "easy", sensing="depth")


def shown(method, history=None, cell=CELL):
    manifest = make_manifest((cell,), (method,), 3, 1)
    return exhibit_of_episode(manifest.player, EpisodeKey.of(cell, method, 3), history)


def test_an_agent_that_plans_nothing_is_shown_as_it_moved():
    exhibit = shown("random")
    assert list(exhibit.lines) == list(exhibit.motions) == ["executed"]
    motion = exhibit.motions["executed"]
    (path,) = exhibit.lines["executed"].paths
    assert len(path) == len(motion.centers) == len(motion.poses) > 1
    # The centre of what is grasped is fixed to the last link.
    point = kinematics.END_EFFECTOR[:3, :3] @ kinematics.GRASP_CENTER
    point = point + kinematics.END_EFFECTOR[:3, 3]
    np.testing.assert_allclose(
        motion.poses[:, 6, :3, :3] @ point + motion.poses[:, 6, :3, 3], path, atol=1e-9
    )
    assert {mesh.link for mesh in exhibit.meshes} == set(range(7))


@pytest.mark.parametrize("method", ["random", "rrt_connect", "cpromp", "promp"])
def test_methods_that_keep_no_particles_are_refused_before_anything_is_played(method):
    with pytest.raises(ValueError, match="history must be None for"):
        shown(method, 5)


@pytest.mark.parametrize("method", ["random", "promp"])
def test_points_that_a_camera_sees_lie_on_the_obstacles(method):
    """Those are not observed, so that nothing else of them is shown."""
    exhibit = shown(method, cell=DEPTH)
    (points,) = exhibit.clouds
    env = gymnasium.make("smp_gym/Placement-v0", **DEPTH.make_arguments())
    try:
        env.reset(seed=3)
        bodies = env.unwrapped.scene.obstacles
    finally:
        env.close()
    assert len(points) > 50
    assert np.percentile(np.abs(signed_distance(points, bodies)), 90) < 0.02
    assert not exhibit.obstacles
    assert not shown("random").clouds
