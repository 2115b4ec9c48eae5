"""Labelled points from what a depth camera sees, and the map learned from them."""

import numpy as np
import pytest

from smp_gym.geometry.distance import signed_distance
from smp_gym.scene import Obstacle
from smp_planner.occupancy.neural import PointNetworkMap, train_map
from smp_planner.occupancy.point_cloud import label_point_cloud

BALL = Obstacle(shape="sphere", position=(0.1, 0.0, 0.3), size=(0.1, 0.1, 0.1))
SPACE = ((-0.3, -0.3, 0.0), (0.3, 0.3, 0.6))
SENSOR = np.array([0.1, 0.0, 1.3])


@pytest.fixture(scope="module")
def cloud():
    """The side of the ball that a camera above it sees, by the exact equation of a sphere."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = np.array(BALL.position) + 0.1 * directions
    towards = SENSOR - points
    return points[(directions * towards).sum(axis=1) > 0.0]


def test_labels_are_those_of_the_body_in_front_and_within_its_thickness(cloud):
    points, labels = label_point_cloud(
        cloud, SENSOR, 4000, np.random.default_rng(1), thickness=0.08, workspace=SPACE
    )
    assert points.shape == (4000, 3)
    assert 0.1 < labels.mean() < 0.9
    assert (points >= SPACE[0]).all()
    assert (points <= SPACE[1]).all()
    distance = signed_distance(points, [BALL])
    seen = points[:, 2] > BALL.position[2]
    # The cloud has gaps of some millimetres.
    sure = np.abs(distance - 0.02) > 0.005
    core = seen & (distance > -0.03)
    np.testing.assert_array_equal(labels[core & sure], (distance < 0.02)[core & sure])
    # What is deeper behind the surface than its thickness was not seen.
    below = points[:, 2] < BALL.position[2] - 0.15
    assert not labels[below].any()


def test_a_network_learns_the_visible_surface_from_them(cloud):
    points, labels = label_point_cloud(
        cloud, SENSOR, 8000, np.random.default_rng(1), workspace=SPACE
    )
    network = train_map(points, labels, inflation=0.02, hidden=(32, 32), steps=1500)
    known = PointNetworkMap.of(network, SPACE)
    top = cloud[cloud[:, 2] > 0.33]
    outward = (top - np.array(BALL.position)) / 0.1
    for gap in (0.0, 0.03, 0.06):
        error = known.signed_distance(top + gap * outward) - gap
        assert np.percentile(np.abs(error), 95) < 0.012


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cloud": np.zeros((3, 2))}, "points"),
        ({"cloud": np.zeros(3)}, r"cloud must have shape \(N, 3\)"),
        ({"cloud": np.full((2, 3), np.nan)}, "finite"),
        ({"cloud": np.full((2, 3), 9.0)}, "cloud must hold a point in the workspace"),
        ({"sensor": np.zeros((2, 3))}, "sensor must have shape"),
        ({"sensor": np.array([0.1, 0.0, 0.4])}, "sensor must not be a point of the cloud"),
        ({"count": 0}, "count must be at least 1, got 0"),
        ({"thickness": -0.1}, "thickness must not be negative, got -0.1"),
        ({"inflation": 0.0}, "inflation must be positive, got 0.0"),
    ],
)
def test_bad_input_is_refused(change, message):
    given = {
        "cloud": np.array([[0.1, 0.0, 0.4], [0.11, 0.0, 0.4], [0.12, 0.0, 0.4]]),
        "sensor": SENSOR,
        "count": 10,
        "rng": np.random.default_rng(0),
        "workspace": SPACE,
    } | change
    with pytest.raises(ValueError, match=message):
        label_point_cloud(**given)
