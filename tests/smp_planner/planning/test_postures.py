"""Inverse kinematics for goals and via-poses, checked by forward kinematics."""

import numpy as np
import pytest

from smp_gym.robot.kinematics import JOINT_LOWER, JOINT_UPPER, UnreachableError, end_effector_pose
from smp_planner.planning.postures import pose_chain, reaching


def test_configurations_reach_the_regions(placement, crowded, checker, postures, held, region):
    x, y, z = crowded.goals[0].position
    here, there = region((x, y, z + 0.2)), region((x + 0.1, y + 0.1, z + 0.25))
    start = placement(crowded).start
    rng = np.random.default_rng(0)
    seeds = postures[rng.integers(len(postures), size=64)] + 0.2 * rng.standard_normal((64, 6))
    seeds[:, 0] += 2 * np.pi
    found = reaching((here, there), checker.robot, seeds, start, rng)
    assert len(found) > 50
    points = (end_effector_pose(found) @ held)[:, :3, 3]
    inside = [((points >= g.lower) & (points <= g.upper)).all(axis=1) for g in (here, there)]
    assert (inside[0] | inside[1]).all()
    assert inside[0].sum() > 20
    assert inside[1].sum() > 20
    assert (found >= checker.robot.lower).all()
    assert (found <= checker.robot.upper).all()
    assert (np.abs(found - start)[:, [0, 3, 5]] <= np.pi + 1e-9).all()


def test_what_is_out_of_reach_gives_none(checker, postures, region):
    far = region((3.0, 0.0, 0.5))
    rng = np.random.default_rng(0)
    assert reaching((far,), checker.robot, postures, postures[0], rng).shape == (0, 6)


def test_fewer_seeds_than_regions_are_no_error(checker, postures, region):
    regions = (region((-0.1, -0.5, 0.3)), region((0.1, -0.5, 0.3)))
    rng = np.random.default_rng(0)
    assert len(reaching(regions, checker.robot, postures[:1], postures[0], rng)) == 1


def test_seeds_are_checked(checker, postures, region):
    rng = np.random.default_rng(0)
    for seeds in (postures[0], postures[:0], np.full((1, 6), np.nan)):
        with pytest.raises(ValueError, match="seeds"):
            reaching((region((0.0, -0.5, 0.3)),), checker.robot, seeds, postures[0], rng)


def test_a_chain_takes_its_poses_and_keeps_its_branch():
    shares = np.linspace(0.0, 1.0, 5)[:, None]
    first, last = np.array([-0.9, 3.8, 0.8, 0.2, 1.9, 0.1]), np.array([-1.2, 4.2, 1.0, 0, 1.6, 0.2])
    expected = first + shares * (last - first)
    poses = end_effector_pose(expected)
    chain = pose_chain(list(poses), last + 0.05)
    np.testing.assert_allclose(end_effector_pose(chain), poses, atol=1e-4)
    np.testing.assert_allclose(chain, expected, atol=1e-3)
    other = pose_chain(list(poses), last + np.array([np.pi, -2.0, 3.0, np.pi, 1.0, 0.0]))
    np.testing.assert_allclose(end_effector_pose(other), poses, atol=1e-4)
    assert ((other >= JOINT_LOWER) & (other <= JOINT_UPPER)).all()


def test_a_pose_out_of_reach_is_told():
    far = np.eye(4)
    far[0, 3] = 2.0
    with pytest.raises(UnreachableError):
        pose_chain([far], np.zeros(6))
