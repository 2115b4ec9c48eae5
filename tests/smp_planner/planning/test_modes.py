"""Against curves of known winding, signed crossings of a ray, and deformations that stay clear."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import entropy

from smp_planner.planning.modes import best_of_each, group, signatures_2d, signatures_3d

PHASE = np.linspace(0.0, 1.0, 201)
CENTERS = np.array([[0.25, 0.1], [0.5, -0.15], [0.7, 0.2], [0.5, 3.0]])


def ray_crossings(path, center):
    """Winding number of the path closed by a straight edge: signed crossings of the ray to +x."""
    loop = np.concatenate([path, path[:1]]) - center
    number = 0
    for (ax, ay), (bx, by) in pairwise(loop):
        if (ay > 0.0) != (by > 0.0) and ax + (bx - ax) * ay / (ay - by) > 0.0:
            number += 1 if by > ay else -1
    return number


def bulges(rng, count, size=0.5):
    """(count, T, 2) random curves that begin and end in nothing."""
    waves = np.sin(np.pi * np.arange(1, 5)[:, None] * PHASE)
    return size * np.einsum("nkd,kt->ntd", rng.standard_normal((count, 4, 2)), waves)


def clearance(paths, center):
    """(N,) distance from the nearest edge, by densely sampled edges and the sampling's error."""
    a, b = paths[:, :-1], paths[:, 1:]
    share = np.linspace(0.0, 1.0, 9)[:, None, None, None]
    distances = np.linalg.norm(a + share * (b - a) - center, axis=-1).min(axis=0)
    return (distances - np.linalg.norm(b - a, axis=-1) / 16.0).min(axis=-1)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


STRAIGHT = np.stack([PHASE, np.zeros_like(PHASE)], axis=1)


@pytest.mark.parametrize("turns", [-3, -1, 1, 2])
def test_a_circle_turns_as_often_as_it_is_made_to(turns):
    angle = 2.0 * np.pi * turns * PHASE
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    np.testing.assert_array_equal(
        signatures_2d(circle[None], [[0.3, 0.1], [-0.8, 0.0], [1.5, 0.0]]), [[turns, turns, 0]]
    )


def test_the_loops_of_a_limacon_turn_once_and_twice():
    # r = 1/2 + cos a: the inner loop lies around (1/2, 0), the outer one around both places.
    angle = 2.0 * np.pi * PHASE + 0.1
    limacon = (0.5 + np.cos(angle))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    np.testing.assert_array_equal(
        signatures_2d(limacon[None], [[0.25, 0.0], [1.0, 0.0], [-0.5, 0.0]]), [[2, 1, 0]]
    )


def test_a_path_around_one_obstacle_passes_left_or_right():
    above = np.stack([PHASE, np.sin(np.pi * PHASE)], axis=1)
    below = above * [1.0, -1.0]
    centers = [[0.5, 0.2], [0.5, -0.2], [0.5, 0.0], [0.5, 2.0], [2.0, 0.0]]
    np.testing.assert_array_equal(
        signatures_2d([above, below, STRAIGHT], centers[:2]), [[-1, 0], [0, 1], [0, 0]]
    )
    # The third centre lies on the straight connection: it counts as on its left.
    np.testing.assert_array_equal(
        signatures_2d([above, below], centers), [[-1, 0, -1, 0, 0], [0, 1, 0, 0, 0]]
    )


def test_the_numbers_are_those_of_signed_crossings(rng):
    paths = STRAIGHT + bulges(rng, 60)
    found = signatures_2d(paths, CENTERS)
    expected = [[ray_crossings(path, center) for center in CENTERS] for path in paths]
    np.testing.assert_array_equal(found, expected)
    assert len(np.unique(found)) > 2


def test_deformations_change_the_number_only_by_crossing_the_centre(rng):
    steps = 250
    kept = changed = 0
    for base, bulge in zip(STRAIGHT + bulges(rng, 30), bulges(rng, 30, 0.3), strict=True):
        path = base + np.linspace(0.0, 1.0, steps)[:, None, None] * bulge
        # No point of an edge moves farther than this from one step to the next.
        moved = np.linalg.norm(bulge, axis=-1).max() / (steps - 1)
        for center in CENTERS[:3]:
            before, after = signatures_2d(path[[0, -1]], center[None])[:, 0]
            if (clearance(path, center) > moved).all():
                assert before == after
                kept += 1
            elif before != after:
                changed += 1
    assert kept > 20
    assert changed > 5


def test_one_crossing_changes_the_number_by_one():
    heights = np.linspace(-1.0, 1.0, 20)
    paths = np.stack([np.stack([PHASE, h * np.sin(np.pi * PHASE)], axis=1) for h in heights])
    found = signatures_2d(paths, [[0.5, 0.3]])[:, 0]
    np.testing.assert_array_equal(found, np.where(heights > 0.3, -1, 0))


def test_reversed_paths_have_the_negative_numbers(rng):
    paths = STRAIGHT + bulges(rng, 30)
    found = signatures_2d(paths, CENTERS)
    np.testing.assert_array_equal(signatures_2d(paths[:, ::-1], CENTERS), -found)
    on_it = [[0.5, 0.0]]
    np.testing.assert_array_equal(
        signatures_2d(paths[:, ::-1], on_it), -1 - signatures_2d(paths, on_it)
    )


def test_the_order_of_paths_and_obstacles_does_not_matter(rng):
    paths = STRAIGHT + bulges(rng, 30)
    order, centers = rng.permutation(30), rng.permutation(4)
    found = signatures_2d(paths, CENTERS)
    np.testing.assert_array_equal(
        signatures_2d(paths[order], CENTERS[centers]), found[order][:, centers]
    )
    modes, again = group(found), group(found[order])
    np.testing.assert_array_equal(again.signatures, modes.signatures)
    np.testing.assert_array_equal(again.shares, modes.shares)
    np.testing.assert_array_equal(again.labels, modes.labels[order])


def test_motions_of_the_plane_and_mirrors(rng):
    paths = STRAIGHT + bulges(rng, 20)
    centers = np.concatenate([CENTERS, [[0.5, 0.0]]])
    found = signatures_2d(paths, centers)
    for angle in rng.uniform(0.0, 2.0 * np.pi, 8):
        turn = 3.0 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        moved = signatures_2d(paths @ turn.T + [4.0, -7.0], centers @ turn.T + [4.0, -7.0])
        np.testing.assert_array_equal(moved, found)
    mirror = [1.0, -1.0]
    np.testing.assert_array_equal(
        signatures_2d(paths * mirror, CENTERS * mirror), -signatures_2d(paths, CENTERS)
    )


def test_ends_that_differ_a_little_divide_no_class(rng):
    above = np.stack([PHASE, np.sin(np.pi * PHASE)], axis=1)
    sides = np.where(np.arange(40)[:, None, None] < 20, [1.0, 1.0], [1.0, -1.0])
    ends = rng.uniform(-0.1, 0.1, (2, 40, 1, 2))
    paths = above * sides + ends[0] * (1.0 - PHASE)[:, None] + ends[1] * PHASE[:, None]
    # The straight connections of the paths' own ends pass this obstacle on both sides.
    middle = np.array([0.5, 0.0])
    own = (paths[:, 0] + paths[:, -1])[:, 1] / 2.0
    assert own.min() < 0.0 < own.max()
    modes = group(signatures_2d(paths, middle[None]))
    assert {tuple(m) for m in modes.members} == {tuple(range(20)), tuple(range(20, 40))}


def test_paths_are_joined_to_the_mean_ends(rng):
    ends = rng.uniform(-0.4, 0.4, (2, 40, 1, 2))
    paths = STRAIGHT + bulges(rng, 40)
    paths += ends[0] * (1.0 - PHASE)[:, None] + ends[1] * PHASE[:, None]
    start, end = paths[:, :1].mean(axis=0), paths[:, -1:].mean(axis=0)
    expected = [
        [ray_crossings(np.concatenate([start, path, end]), center) for center in CENTERS]
        for path in paths
    ]
    np.testing.assert_array_equal(signatures_2d(paths, CENTERS), expected)


def test_a_commutator_is_not_told_from_no_turn():
    # Around the first obstacle, the second, and both back in the same order: no winding in all,
    # though no deformation undoes it.
    angle = 2.0 * np.pi * np.linspace(0.0, 1.0, 65)
    left = np.stack([np.cos(angle) - 1.0, np.sin(angle)], axis=1)
    right = np.stack([1.0 - np.cos(angle), np.sin(angle)], axis=1)
    path = np.concatenate([left, right, left[::-1], right[::-1]])
    np.testing.assert_array_equal(signatures_2d(path[None], [[-1.0, 0.0], [1.0, 0.0]]), [[0, 0]])
    assert np.abs(signatures_2d(left[None], [[-1.0, 0.0]])).item() == 1


ARCS = {
    "left": [0.0, 1.0, 0.0],
    "right": [0.0, -1.0, 0.0],
    "over": [0.0, 0.0, 1.0],
    "under": [0.0, 0.0, -1.0],
}


def arc(side, size=0.3):
    """(T, 3) from the origin to (1, 0, 0), bent to a side."""
    straight = np.stack([PHASE, 0.0 * PHASE, 0.0 * PHASE], axis=1)
    return straight + size * np.sin(np.pi * PHASE)[:, None] * np.array(side)


BAR = np.array([[0.5, 0.0, 0.0]])


def test_in_space_a_path_passes_left_right_over_or_under():
    paths = np.stack([arc(side) for side in ARCS.values()])
    found = signatures_3d(paths, BAR, 0.1)
    # The arcs over and under cross the obstacle's axis, where there is no winding number.
    np.testing.assert_array_equal(found[:, 0], [[-1, 0], [0, 0], [0, 1], [0, -1]])
    assert group(found).count == 4


def test_the_level_is_that_between_the_samples():
    rising = [[0.0, 0.0, -0.6], [1.0, 0.1, 1.0]]
    assert signatures_3d([rising], BAR, 0.1).tolist() == [[[0, 1]]]
    assert signatures_3d([rising], BAR, 0.3)[0, 0, 1] == 0


def test_over_an_obstacle_either_side_of_the_axis_is_one_class():
    paths = np.stack([arc([0.0, aside, 1.0]) for aside in np.linspace(-0.15, 0.15, 20)])
    assert len(np.unique(signatures_2d(paths[..., :2], BAR[:, :2]))) == 2
    assert group(signatures_3d(paths, BAR, 0.1, 0.06)).count == 1


def test_beyond_its_radius_nothing_is_over_an_obstacle():
    high_left, high_right = arc([0.0, 1.0, 1.0]), arc([0.0, -1.0, 1.0])
    np.testing.assert_array_equal(
        signatures_3d([high_left, high_right], BAR, 0.1, 0.2)[:, 0], [[-1, 0], [0, 0]]
    )
    np.testing.assert_array_equal(
        signatures_3d([high_left, high_right], BAR, 0.1)[:, 0], [[0, 1], [0, 1]]
    )


def test_beside_vertical_walls_the_winding_is_that_of_the_plan_view(rng):
    flat = STRAIGHT + bulges(rng, 30)
    heights = 0.5 * np.sin(5.0 * PHASE)
    paths = np.concatenate([flat, np.broadcast_to(heights[:, None], (30, 201, 1))], axis=-1)
    centers = np.concatenate([CENTERS, np.zeros((4, 1))], axis=1)
    found = signatures_3d(paths, centers, 1.0)
    np.testing.assert_array_equal(found[..., 0], signatures_2d(flat, CENTERS))
    np.testing.assert_array_equal(found[..., 1], 0)


def test_the_scene_may_be_turned_with_its_axes(rng):
    paths = np.stack([arc(side) for side in ARCS.values()]) + 0.01 * rng.standard_normal((4, 1, 3))
    centers = BAR + np.array([[0.0, 0.0, 0.0], [0.1, 0.1, 0.1], [-0.1, 0.05, -0.2]])
    heights, radii = [0.1, 0.05, 0.12], [0.06, 0.3, np.inf]
    found = signatures_3d(paths, centers, heights, radii)
    assert len(np.unique(found)) == 3
    for turn in Rotation.random(5, random_state=0):
        axis = turn.apply([0.0, 0.0, 2.0])
        moved = turn.apply(paths.reshape(-1, 3)).reshape(paths.shape)
        around = turn.apply(centers)
        np.testing.assert_array_equal(signatures_3d(moved, around, heights, radii, axis), found)
    # An axis of its own each: what is beside a lying bar across the path is over a standing one.
    both = signatures_3d(
        paths[2:3], np.repeat(BAR, 2, axis=0), 0.1, axis=[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
    )
    assert both[0, 0].tolist() == [0, 1]
    assert both[0, 1, 1] == 0


def test_shares_and_entropy_are_those_of_the_weights(rng):
    signatures = rng.integers(0, 3, (200, 2))
    weights = rng.uniform(0.0, 1.0, 200)
    modes = group(signatures, weights)
    assert modes.count == len({tuple(row) for row in signatures}) == 9
    for signature, members, share in zip(
        modes.signatures, modes.members, modes.shares, strict=True
    ):
        same = (signatures == signature).all(axis=1)
        np.testing.assert_array_equal(members, np.flatnonzero(same))
        assert share == pytest.approx(weights[same].sum() / weights.sum())
    assert (np.diff(modes.shares) <= 0.0).all()
    assert modes.shares.sum() == pytest.approx(1.0)
    assert modes.entropy == pytest.approx(entropy(modes.shares))
    assert 0.0 < modes.entropy < np.log(9)


def test_entropy_of_equal_classes_and_of_one():
    assert group(np.arange(7)).entropy == pytest.approx(np.log(7))
    assert group(np.zeros(7, np.int64)).entropy == 0.0
    assert group([0, 1], [1.0, 0.0]).entropy == 0.0
    without = group(signatures_2d(STRAIGHT[None], np.empty((0, 2))))
    assert without.count == 1


def test_the_cheapest_of_each_class():
    modes = group([[1], [0], [1], [0], [1], [2]])
    assert modes.signatures.tolist() == [[1], [0], [2]]
    costs = [3.0, 5.0, 1.0, 4.0, 1.0, np.inf]
    assert best_of_each(modes, costs).tolist() == [2, 3, 5]


def with_nan(array):
    array = np.array(array, np.float64)
    array.flat[0] = np.nan
    return array


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: signatures_2d(STRAIGHT, CENTERS), r"paths must have shape \('any', 'any', 2\)"),
        (lambda: signatures_2d(STRAIGHT[None, :1], CENTERS), "paths must be .*two points"),
        (lambda: signatures_2d(np.empty((0, 5, 2)), CENTERS), "paths must be one or more"),
        (lambda: signatures_2d(with_nan(STRAIGHT[None]), CENTERS), "paths must be finite"),
        (lambda: signatures_2d(STRAIGHT[None], CENTERS[0]), "centers must have shape"),
        (lambda: signatures_2d(STRAIGHT[None], with_nan(CENTERS)), "centers must be finite"),
        (lambda: signatures_2d(STRAIGHT[None], [[0.3033, 0.0]]), r"paths\[0\].*centers\[0\]"),
        (lambda: signatures_2d(STRAIGHT[None], [[3.0, 3.0], [1.0, 0.0]]), r"centers\[1\]"),
        (lambda: signatures_3d(arc(ARCS["over"])[None], BAR, 0.4), r"paths\[0\].*centers\[0\]"),
        (lambda: signatures_3d(STRAIGHT[None], BAR, 0.1), "paths must have shape"),
        (lambda: signatures_3d(arc(ARCS["left"])[None], BAR, -0.1), "half_heights must be"),
        (lambda: signatures_3d(arc(ARCS["left"])[None], BAR, [0.1, 0.1]), "half_heights must have"),
        (lambda: signatures_3d(arc(ARCS["left"])[None], BAR, 0.1, 0.0), "radii must be positive"),
        (lambda: signatures_3d(arc(ARCS["left"])[None], BAR, 0.1, axis=[0, 0, 0]), "axis must be"),
        (lambda: signatures_3d(arc(ARCS["left"])[None], BAR, 0.1, axis=[0, 1]), "axis must have"),
        (lambda: group(np.empty((0, 2), np.int64)), "signatures must have shape"),
        (lambda: group([0.5, 1.0]), "signatures must be integers"),
        (lambda: group([0, 1], [1.0]), "weights must have shape"),
        (lambda: group([0, 1], [1.0, -1.0]), "weights must not be negative"),
        (lambda: group([0, 1], [0.0, 0.0]), "weights must not be negative nor all zero"),
        (lambda: group([0, 1], [1.0, np.inf]), "weights must be finite"),
        (lambda: best_of_each(group([0, 1]), [1.0]), "costs must have shape"),
        (lambda: best_of_each(group([0, 1]), [1.0, np.nan]), "costs must not be nan"),
    ],
)
def test_bad_inputs_are_refused_by_name(call, message):
    with pytest.raises(ValueError, match=message):
        call()
