"""Problems in narrow places: free by PyBullet, the same for a seed, and what solves them."""

import numpy as np
import pybullet
import pytest
from pybullet_utils.bullet_client import BulletClient
from rich.console import Console

from smp_planner.experiments.narrow_places import (
    FAMILIES,
    narrow_markdown,
    narrow_place,
    narrow_table,
    solve_narrow_places,
)
from smp_planner.experiments.public_arms import PUBLIC_ARMS, swings
from smp_planner.library.smp import SMP

KUKA = PUBLIC_ARMS["kuka_iiwa"]
READY = np.array(KUKA.ready)


@pytest.fixture(scope="module")
def robot():
    bare = KUKA.robot(0.03)
    return SMP.fit(swings(READY, READY, np.random.default_rng(0)), robot=bare).robot


@pytest.fixture(scope="module")
def bullet():
    client = BulletClient(pybullet.DIRECT)
    yield client
    client.disconnect()


def _body(bullet, obstacle):
    if obstacle.shape == "box":
        kind = {"shapeType": bullet.GEOM_BOX, "halfExtents": obstacle.size}
    else:
        height = 2.0 * obstacle.size[2]
        kind = {"shapeType": bullet.GEOM_CYLINDER, "radius": obstacle.size[0], "height": height}
    return bullet.createMultiBody(0.0, bullet.createCollisionShape(**kind), -1, obstacle.position)


@pytest.mark.parametrize("family", FAMILIES)
def test_starts_and_goals_touch_nothing(family, robot, bullet):
    place, again = (
        next(found for seed in range(20) if (found := narrow_place(robot, READY, family, seed)))
        for _ in range(2)
    )
    assert again.obstacles == place.obstacles
    np.testing.assert_array_equal(again.start, place.start)
    arm = bullet.loadURDF(str(KUKA.path()), useFixedBase=True)
    bodies = [_body(bullet, obstacle) for obstacle in place.obstacles]
    for posture in (place.start, place.goal):
        for joint, angle in enumerate(posture):
            bullet.resetJointState(arm, joint, angle)
        for body in bodies:
            assert not bullet.getClosestPoints(arm, body, 0.0)
    for body in (arm, *bodies):
        bullet.removeBody(body)


def test_results_are_kept_and_shown(tmp_path):
    out = tmp_path / "narrow.json"
    console = Console(quiet=True)
    asked = (["kuka_iiwa"], ["table_pick"], ["rrt_connect", "smp", "promp"], 1, out, console, 1)
    found = solve_narrow_places(*asked)
    (result,) = found.values()
    assert result["posed"]
    assert {"rrt_connect", "smp", "rrt_connect_seconds", "smp_seconds"} < result.keys()
    assert "cpromp" not in result
    before = out.read_bytes()
    assert solve_narrow_places(*asked) == found
    assert out.read_bytes() == before
    table = narrow_table(found)
    assert [str(cell) for cell in table.columns[1].cells] == ["table_pick", "all"]


def test_shares_are_of_the_problems_that_are_posed():
    rows = {
        "a cage 0": {"posed": True, "rrt_connect": True, "smp": True},
        "a cage 1": {"posed": True, "rrt_connect": True, "smp": False},
        "a cage 2": {"posed": True, "rrt_connect": False, "smp": True},
        "a cage 3": {"posed": False},
    }
    of_cage, of_all = (
        [str(list(column.cells)[row]) for column in narrow_table(rows).columns] for row in (0, 1)
    )
    assert of_cage == ["a", "cage", "3 of 4", "2 of 3", "2 of 3"]
    assert of_all[3] == "2 of 3 (21–94 %)"


def test_the_table_in_markdown_has_families_in_rows_and_arms_in_columns():
    solved = {"posed": True, "rrt_connect": True, "smp": True}
    rows = {
        "panda cage 0": solved,
        "ur5 cage 0": {"posed": False},
        "panda table_pick 0": solved,
        "ur5 table_pick 0": {**solved, "rrt_connect": False},
        "panda cage 1": {**solved, "smp": False},
        "ur5 cage 1": {"posed": False},
    }
    assert narrow_markdown(rows).splitlines() == [
        "| rrt_connect · smp | Panda | UR5 |",
        "| --- | --- | --- |",
        "| cage | 2 · 1 of 2 | 0 · 0 of 0 |",
        "| pick on a table | 1 · 1 of 1 | 0 · 1 of 1 |",
        "| all | 3 · 2 of 3 | 0 · 1 of 1 |",
    ]


def test_swings_begin_and_end_about_where_they_should():
    rng = np.random.default_rng(0)
    found = swings(READY, READY + 1.0, rng, count=200)
    assert found.shape == (200, 100, 7)
    assert np.abs(found[:, 0] - READY).mean() == pytest.approx(0.05 * np.sqrt(2 / np.pi), rel=0.1)
    assert np.abs(found[:, -1] - READY - 1.0).max() < 0.3
    steps = np.abs(np.diff(found, axis=1))
    assert steps[:, 0].max() < 0.1 * steps.max()
