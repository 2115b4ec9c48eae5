"""The library without an environment: what is asked of a plan, and what is refused."""

import numpy as np
import pytest

from smp_gym.scene import Obstacle
from smp_planner.adaptation import ADAPTATIONS, adaptation
from smp_planner.library.smp import (
    SMP,
    AdaptSettings,
    AnyOf,
    Box,
    Circle,
    GoalRegion,
    Rectangle,
    ViaPoint,
)

PHASE = np.linspace(0.0, 1.0, 60)
OBSTACLES = [Circle((60.0, 60.0), 12.0), Rectangle((150.0, -60.0), (14.0, 9.0), 0.5)]
ENDS = {"start": (0.0, 0.0), "goal": (200.0, 0.0)}
SHORT = adaptation("smp", iterations=30)
UNSEEN = AdaptSettings(retries=0)


def wave(bend, sign=1.0):
    side = sign * 60.0 * np.sin(2 * np.pi * PHASE) + bend * np.sin(np.pi * PHASE)
    return np.stack([200.0 * PHASE, side], axis=1)


@pytest.fixture(scope="module")
def waves():
    return [wave(bend) for bend in np.random.default_rng(0).normal(0.0, 8.0, 7)]


@pytest.fixture(scope="module")
def primitive(waves):
    return SMP.fit(waves)


@pytest.fixture(scope="module")
def plan(primitive):
    return primitive.adapt(OBSTACLES, **ENDS)


@pytest.fixture(scope="module")
def two_modes(waves):
    return SMP.fit([*waves, *(d * [1.0, -1.0] for d in waves)])


def distance_to_obstacles(points):
    """Return (...) signed distances to `OBSTACLES`, from the plane's own geometry."""
    circle, box = OBSTACLES
    to_circle = np.linalg.norm(points - circle.center, axis=-1) - circle.radius
    cosine, sine = np.cos(box.angle), np.sin(box.angle)
    turned = (points - box.center) @ np.array([[cosine, -sine], [sine, cosine]])
    beyond = np.abs(turned) - box.half_extents
    to_box = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) + np.minimum(beyond.max(-1), 0.0)
    return np.minimum(to_circle, to_box)


def densely(paths, count=50):
    share = np.linspace(0.0, 1.0, count)[:, None, None, None]
    return (
        (paths[:, :-1] + share * np.diff(paths, axis=1))
        .swapaxes(0, 1)
        .reshape(len(paths), -1, paths.shape[-1])
    )


def test_paths_are_free_where_the_prior_s_are_not(primitive, plan):
    assert plan.trajectories.shape == (42, 200, 2)
    # Another machine rounds otherwise, and so has other draws, of which one may fail.
    assert plan.good.sum() >= 40
    assert not plan.message
    assert (distance_to_obstacles(densely(plan.trajectories[plan.good])) > 0.0).all()
    prior = primitive.adapt(OBSTACLES, **ENDS, method="promp")
    assert prior.collision_free.sum() < 21


def test_clearance_is_that_of_the_plane(primitive, plan):
    prior = primitive.adapt(OBSTACLES, **ENDS, method="promp")
    for found in (plan, prior):
        expected = distance_to_obstacles(densely(found.trajectories)).min(axis=1)
        tolerance = 2e-4 * primitive.extent
        np.testing.assert_allclose(found.clearance, expected, rtol=0, atol=tolerance)
        clear = np.abs(expected) > tolerance
        np.testing.assert_array_equal(found.collision_free[clear], expected[clear] > 0.0)


def test_a_disc_keeps_its_radius_clear(primitive):
    plan = primitive.adapt(OBSTACLES, **ENDS, radius=6.0)
    near = distance_to_obstacles(densely(plan.trajectories)).min(axis=1)
    assert plan.collision_free.sum() > 35
    assert (near[plan.collision_free] > 6.0).all()


def test_several_ways_round_are_found(primitive, plan):
    assert plan.signatures.shape == (42, 3)
    counts = [primitive.adapt(OBSTACLES, **ENDS, seed=seed).modes.count for seed in range(6)]
    assert np.mean(counts) >= 2.0


def test_the_chosen_path_is_good(plan):
    assert plan.good[plan.chosen]
    np.testing.assert_array_equal(plan.best, plan.trajectories[plan.chosen])


def test_points_are_met_exactly(primitive):
    plan = primitive.adapt(
        start=(3.0, -4.0),
        goal=(210.0, 10.0),
        via_points=[ViaPoint(0.5, (90.0, 20.0))],
        method=SHORT,
    )
    np.testing.assert_allclose(plan.trajectories[:, 0], np.tile([3.0, -4.0], (42, 1)), atol=1e-6)
    np.testing.assert_allclose(plan.trajectories[:, -1], np.tile([210.0, 10.0], (42, 1)), atol=1e-6)
    middle = (plan.trajectories[:, 99] + plan.trajectories[:, 100]) / 2
    np.testing.assert_allclose(middle, np.tile([90.0, 20.0], (42, 1)), atol=0.05)


def test_tolerances_and_boxes_are_kept(primitive):
    box = Box((195.0, 20.0), (215.0, 40.0))
    plan = primitive.adapt(
        OBSTACLES, start=(0.0, 0.0), goal=box, via_points=[ViaPoint(0.5, (110.0, 10.0), 3.0)]
    )
    assert plan.good.sum() >= 40
    good = plan.trajectories[plan.good]
    middle = (good[:, 99] + good[:, 100]) / 2
    slack = 0.005 * primitive.extent
    assert (np.linalg.norm(middle - [110.0, 10.0], axis=1) < 3.0 + slack).all()
    ends = good[:, -1]
    assert ((ends > box.lower - slack) & (ends < box.upper + slack)).all()
    assert np.std(ends, axis=0).min() > 1.0


def test_likelihood_alone_pulls_as_hard_as_its_sigma_says(primitive):
    settings = AdaptSettings(modulation="likelihood", sigma=0.02, retries=0)
    plan = primitive.adapt(goal=(200.0, 30.0), settings=settings, method=adaptation("cpromp"))
    # Gaussian prior and likelihood: the posterior of the end is known.
    mean, covariance = (t.numpy() for t in primitive.single.marginal(1.0))
    wanted = primitive.frame.inwards((200.0, 30.0))
    gain = covariance @ np.linalg.inv(covariance + 0.02**2 * np.eye(2))
    ends = primitive.frame.inwards(plan.trajectories[:, -1])
    std = np.sqrt(np.diag(covariance - gain @ covariance))
    error = ends.mean(axis=0) - (mean + gain @ (wanted - mean))
    assert (np.abs(error) < 4.0 * std / np.sqrt(42)).all()
    np.testing.assert_allclose(ends.std(axis=0), std, rtol=0.4)


def test_both_readings_of_the_box_differ_in_their_tails(primitive):
    ends = [
        primitive.adapt(
            goal=Box((200.0, 20.0), (210.0, 30.0), sigma=15.0, paper_scale=paper_scale),
            method=SHORT,
            settings=AdaptSettings(modulation="likelihood", retries=0),
        ).missed["goal"]
        for paper_scale in (False, True)
    ]
    assert ends[1].mean() < ends[0].mean()


def test_any_of_several_ends_will_do(primitive):
    goals = AnyOf([(200.0, 20.0), (200.0, -20.0)], shares=(0.75, 0.25))
    plan = primitive.adapt(start=(0.0, 0.0), goal=goals, method=SHORT)
    upper = np.abs(plan.trajectories[:, -1] - [200.0, 20.0]).max(axis=1) < 1e-6
    lower = np.abs(plan.trajectories[:, -1] - [200.0, -20.0]).max(axis=1) < 1e-6
    assert (upper | lower).all()
    assert upper.any()
    assert lower.any()
    assert plan.passing.all()


def test_each_mode_takes_its_own_via_point(two_modes):
    choice = AnyOf([ViaPoint(0.25, (55.0, 75.0), 2.0), ViaPoint(0.25, (55.0, -75.0), 2.0)])
    plan = two_modes.adapt(via_points=[choice], goal=(210.0, 20.0))
    assert np.bincount(plan.components).tolist() == [21, 21]
    assert plan.good.all()
    side = np.sign(plan.trajectories[:, 50, 1])
    np.testing.assert_array_equal(side, np.where(plan.components == 0, 1.0, -1.0))


def test_one_gaussian_for_two_modes_stands_between_them(two_modes):
    apart, together = (
        two_modes.adapt(method="promp", per_component=per_component, particles=200)
        for per_component in (True, False)
    )
    between = [np.abs(found.trajectories[:, 50, 1]) < 10.0 for found in (apart, together)]
    assert between[0].mean() < 0.03
    assert between[1].mean() > 0.06
    assert together.components is None


def test_the_number_of_modes_can_be_stated(waves, two_modes):
    assert len(two_modes.mixture.components) == 2
    both = two_modes.demonstrations
    assert len(SMP.fit(both, modes=1).mixture.components) == 1
    assert len(SMP.fit(waves, modes=2).mixture.components) == 2
    with pytest.raises(ValueError, match=r"modes must be 1 \.\. 3.*got 8"):
        SMP.fit(waves, modes=8)


def test_the_same_call_gives_the_same_plan_and_another_seed_another(primitive):
    first, second, other = (
        primitive.adapt(OBSTACLES, **ENDS, method=SHORT, seed=seed) for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first.trajectories, second.trajectories)
    assert np.abs(first.trajectories - other.trajectories).max() > 1.0


@pytest.mark.parametrize("scale", [1000.0, 1e-3])
def test_another_unit_gives_the_same_plan(waves, plan, scale):
    scaled = SMP.fit([scale * d + 5.0 * scale for d in waves])
    circle, box = OBSTACLES

    def moved(value):
        return scale * np.array(value) + 5.0 * scale

    other = scaled.adapt(
        [
            Circle(moved(circle.center), scale * circle.radius),
            Rectangle(moved(box.center), scale * np.array(box.half_extents), box.angle),
        ],
        start=moved(ENDS["start"]),
        goal=moved(ENDS["goal"]),
    )
    paths = (other.trajectories - 5.0 * scale) / scale
    np.testing.assert_allclose(paths, plan.trajectories, rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.clearance / scale, plan.clearance, rtol=0, atol=1e-9)


@pytest.mark.parametrize("method", ADAPTATIONS)
@pytest.mark.parametrize("per_component", [True, False])
def test_every_method_meets_points(primitive, method, per_component):
    plan = primitive.adapt(
        OBSTACLES, **ENDS, method=method, per_component=per_component, particles=6, settings=UNSEEN
    )
    assert plan.trajectories.shape == (6, 200, 2)
    assert plan.passing.all()


def test_paths_in_space_and_of_more_dimensions():
    rng = np.random.default_rng(1)
    line = np.stack([PHASE, 0.0 * PHASE, 0.3 * np.sin(np.pi * PHASE)], axis=1)
    spread = [line + rng.normal(0.0, 0.02, 3) * np.sin(np.pi * PHASE)[:, None] for _ in range(5)]
    ball = Obstacle(shape="sphere", position=(0.5, 0.0, 0.3), size=(0.08, 0.08, 0.08))
    space = SMP.fit(np.array(spread))
    plan = space.adapt([ball], start=line[0], goal=line[-1], radius=0.02)
    distance = np.linalg.norm(densely(plan.trajectories) - ball.position, axis=-1).min(axis=1) - 0.1
    assert plan.collision_free.sum() > 35
    np.testing.assert_allclose(plan.clearance, distance, atol=3e-4)
    assert plan.signatures.shape == (42, 3)
    many = SMP.fit([np.hstack([d, d]) for d in spread])
    assert many.adapt(goal=np.ones(6), particles=3).trajectories.shape == (3, 200, 6)
    with pytest.raises(ValueError, match="D = 6"):
        many.adapt([ball])


def test_a_constant_coordinate_gets_the_freedom_that_all_get(waves):
    flat = SMP.fit([np.hstack([d, np.full((len(d), 1), 7.0)]) for d in waves])
    plan = flat.adapt(method="promp", particles=200)
    heights = plan.trajectories[:, 100, 2]
    assert abs(heights.mean() - 7.0) < 5.0
    assert heights.std() == pytest.approx(0.1 * flat.extent, rel=0.3)


def test_missing_samples_are_taken_where_they_are_allowed(waves):
    gaps = [d.copy() for d in waves]
    gaps[0][10:15, 0] = np.nan
    with pytest.raises(ValueError, match="nan_is_missing"):
        SMP.fit(gaps)
    whole, torn = SMP.fit(waves), SMP.fit(gaps, nan_is_missing=True)
    difference = whole.single.mean - torn.single.mean
    assert difference.abs().max() < 0.01
    assert torn.adapt(OBSTACLES, **ENDS, method=SHORT).trajectories.shape == (42, 200, 2)


def test_a_learned_map_leads_round_the_obstacles(primitive):
    settings = AdaptSettings(map="points", map_points=5000, map_steps=400)
    plan = primitive.adapt(OBSTACLES[:1], **ENDS, settings=settings, particles=10)
    assert plan.collision_free.sum() >= 9
    assert plan.timings["map"] > 0.0


def test_inference_stops_early_where_particles_are_good_and_only_there(primitive):
    runs = [
        adaptation("smp", inference="svgd", iterations=200, early_stop=early_stop)
        for early_stop in (False, True)
    ]
    easy, hopeless = [Circle((60.0, 60.0), 4.0)], [Rectangle((100.0, 0.0), (5.0, 5000.0))]
    whole, short = (primitive.adapt(easy, **ENDS, method=run, particles=10) for run in runs)
    assert whole.good.all()
    assert short.good.all()
    assert np.abs(whole.trajectories - short.trajectories).max() > 0.0
    whole, short = (
        primitive.adapt(hopeless, **ENDS, method=run, particles=4, settings=UNSEEN) for run in runs
    )
    np.testing.assert_array_equal(whole.trajectories, short.trajectories)


def test_a_deadline_ends_the_iterations(primitive, plan):
    """Without it so many would take hours; one that is far off changes nothing."""
    endless = adaptation("smp", iterations=10**7)
    hurried = primitive.adapt(OBSTACLES, **ENDS, method=endless, settings=UNSEEN, deadline=0.3)
    assert hurried.trajectories.shape == plan.trajectories.shape
    assert np.isfinite(hurried.trajectories).all()
    far, free = (
        primitive.adapt(OBSTACLES, **ENDS, method=SHORT, settings=UNSEEN, particles=4, deadline=d)
        for d in (1e4, None)
    )
    np.testing.assert_array_equal(far.trajectories, free.trajectories)


def test_a_method_that_keeps_no_deadline_says_so(primitive):
    with pytest.raises(ValueError, match=r"deadline must be None for this adaptation, got 0\.5"):
        primitive.adapt(OBSTACLES, **ENDS, method="cpromp", deadline=0.5)


def test_a_hopeless_scene_is_said_to_be_one(primitive):
    wall = Rectangle((100.0, 0.0), (5.0, 5000.0))
    plan = primitive.adapt([wall], **ENDS, method=SHORT, particles=5)
    assert not plan.good.any()
    assert "0 are collision-free" in plan.message


def test_drawing(plan, tmp_path):
    axes = plan.plot()
    axes.figure.savefig(tmp_path / "plan.png")
    assert len(axes.patches) == 2
    assert len(axes.lines) == 7 + 42 + 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"start": (60.0, 65.0)}, r"start \(60, 65\) is inside or touches obstacles\[0\]"),
        ({"goal": (150.0, -60.0)}, r"goal .* obstacles\[1\]"),
        ({"goal": Box((149.0, -61.0), (151.0, -59.0))}, r"goal .* obstacles\[1\]"),
        ({"via_points": [ViaPoint(0.5, (60.0, 60.0), 5.0)]}, r"via_points\[0\] .* obstacles\[0\]"),
        ({"start": (60.0, 73.0), "radius": 3.0}, r"start .* obstacles\[0\]"),
        ({"start": (0.0, 0.0, 0.0)}, r"start must have the 2 coordinates"),
        ({"start": (np.nan, 0.0)}, "start must be finite"),
        ({"via_points": [ViaPoint(0.5, (1.0,))]}, r"via_points\[0\] must have the 2 coordinates"),
        (
            {"via_points": [ViaPoint(0.5, (90.0, 0.0)), ViaPoint(0.5, (95.0, 0.0))]},
            r"via_points\[0\] and via_points\[1\] contradict .* AnyOf",
        ),
        (
            {"start": (0.0, 0.0), "via_points": [ViaPoint(0.0, (9.0, 0.0), 1.0)]},
            "start and via_points",
        ),
        (
            {"via_points": [AnyOf([ViaPoint(0.5, (9.0, 0.0)), ViaPoint(0.6, (9.0, 0.0))])]},
            "options of one phase",
        ),
        ({"via_points": [(0.5, (9.0, 0.0))]}, "must be a ViaPoint"),
        ({"goal": GoalRegion(np.zeros(3), np.zeros(3), np.ones(3))}, "has no robot"),
        ({"goal": ViaPoint(0.5, (9.0, 0.0))}, "goal must be a point, a Box or AnyOf of such"),
        ({"start": GoalRegion(np.zeros(3), np.zeros(3), np.ones(3))}, "start must be a point"),
        ({"particles": 0}, "particles must be a whole number .*, got 0"),
        ({"radius": -1.0}, "radius must be .* at least 0.0, got -1"),
        ({"deadline": 0.0}, r"deadline must be a positive number of seconds, got 0\.0"),
        ({"deadline": float("nan")}, "deadline must be a positive .* got nan"),
        ({"deadline": "soon"}, "deadline must be a positive .* got 'soon'"),
        ({"method": "rrt"}, "method must be one of smp, promp"),
    ],
)
def test_bad_requests_are_named(primitive, arguments, message):
    with pytest.raises(ValueError, match=message):
        primitive.adapt(OBSTACLES, **arguments)


def test_obstacles_must_have_the_dimension_of_the_path(primitive):
    ball = Obstacle(shape="sphere", position=(0.0, 0.0, 0.0), size=(1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match=r"obstacles\[0\] .* must be Circle or Rectangle"):
        primitive.adapt([ball])
    space = SMP.fit(np.random.default_rng(0).normal(size=(3, 20, 3)).cumsum(axis=1))
    with pytest.raises(ValueError, match=r"obstacles\[0\] .* must be smp_gym.scene.Obstacle"):
        space.adapt([Circle((0.0, 0.0), 1.0)])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ViaPoint(1.5, (0.0, 0.0)), "phase must be .* and at most 1.0, got 1.5"),
        (lambda: ViaPoint(0.5, (0.0, np.inf)), "position must be finite"),
        (lambda: ViaPoint(0.5, (0.0, 0.0), -1.0), "tolerance must be .* at least 0.0"),
        (lambda: Box((1.0, 0.0), (0.0, 1.0)), "must not exceed"),
        (lambda: Box((0.0, 0.0), (1.0, 1.0), sigma=0.0), "sigma must be .* above 0.0"),
        (lambda: AnyOf([]), "must be places in a list"),
        (lambda: AnyOf([(0.0, 0.0)], shares=(1.0, 2.0)), "1 positive numbers"),
        (lambda: Circle((0.0, 0.0), 0.0), "radius must be a finite number above 0.0"),
        (lambda: Circle((0.0, 0.0, 0.0), 1.0), r"center must have shape \(2,\)"),
        (lambda: Rectangle((0.0, 0.0), (1.0, -1.0)), "half_extents must be positive"),
        (lambda: SMP.fit([wave(0.0)]), "at least 2, got 1"),
        (lambda: SMP.fit([wave(0.0), wave(0.0)[:, :1]]), "one dimension"),
        (lambda: SMP.fit([wave(np.nan), wave(0.0)]), "must be finite"),
        (lambda: SMP.fit(np.ones((3, 10, 2))), "must not all stand at one point"),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
