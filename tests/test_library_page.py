"""The pages on the library, run block by block as they stand."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
import pytest
import trimesh

DOCS = Path(__file__).parents[1] / "docs"


def run(page: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the names that the blocks of a page define, run in a folder."""
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL)
    assert len(blocks) >= 5
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, str(page), "exec"), names)
    return names


def test_the_page_runs_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = run(DOCS / "library.md", tmp_path, monkeypatch)
    assert (tmp_path / "library.png").stat().st_size > 10_000
    assert names["free"]["smp"] == 42 > names["free"]["promp"]


def test_a_public_robot_moves_clear_of_mesh_and_cloud_within_its_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the file that was written, by finite differences and PyBullet's own distances."""
    names = run(DOCS / "own_robot.md", tmp_path, monkeypatch)
    robot, data = names["robot"], names["data"]
    header = (tmp_path / "motion.csv").read_text().partition("\n")[0].split(",")
    table = np.loadtxt(tmp_path / "motion.csv", delimiter=",", skiprows=1)
    places = [header.index(name) for name in robot.joints]
    times, positions = table[:, 0], table[:, places]
    # At the rate, up to the last sample, which is the end.
    np.testing.assert_allclose(np.diff(times)[:-1], 0.01, atol=1e-9)
    np.testing.assert_allclose(positions[0], names["arm"].demonstrations[0][0], atol=1e-5)
    np.testing.assert_allclose(positions[-1], names["arm"].demonstrations[0][-1], atol=1e-5)
    velocity = np.diff(positions, axis=0) / np.diff(times)[:, None]
    acceleration = np.diff(velocity, axis=0)[:-1] / 0.01
    client = pybullet.connect(pybullet.DIRECT)
    arm = pybullet.loadURDF(
        str(data / "kuka_iiwa" / "model.urdf"), useFixedBase=True, physicsClientId=client
    )
    found = {}
    for index in range(pybullet.getNumJoints(arm, physicsClientId=client)):
        info = pybullet.getJointInfo(arm, index, physicsClientId=client)
        found[info[1].decode()] = (index, info[8], info[9], info[11])
    indices, lower, upper, fastest = zip(*(found[name] for name in robot.joints), strict=True)
    assert (positions >= np.array(lower) - 1e-6).all()
    assert (positions <= np.array(upper) + 1e-6).all()
    assert (np.abs(velocity) <= np.array(fastest) * 1.001).all()
    assert (np.abs(acceleration) <= 3.0 * 1.01).all()
    assert (np.abs(np.diff(acceleration, axis=0)) / 0.01 <= 30.0 * 1.01).all()
    # As long as the recordings, whose gripper closes a little after the middle.
    assert 4.0 <= times[-1] <= 4.4
    gripper = table[:, header.index("signal:gripper")]
    np.testing.assert_array_equal(gripper, times >= names["closing"].time)
    share = names["closing"].time / times[-1]
    assert share == pytest.approx(0.5 + names["bends"][:, 0].mean() / 4.0, abs=0.03)
    duck = pybullet.createMultiBody(
        0,
        pybullet.createCollisionShape(
            pybullet.GEOM_MESH,
            fileName=str(data / "duck_vhacd.obj"),
            meshScale=[0.1] * 3,
            physicsClientId=client,
        ),
        basePosition=names["duck_position"].tolist(),
        baseOrientation=names["duck_turn"],
        physicsClientId=client,
    )
    points = pybullet.createMultiBody(
        0,
        pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=[1e-3, 0.25, 0.15], physicsClientId=client
        ),
        basePosition=(names["middle"] + (0.22, 0.0, 0.0)).tolist(),
        physicsClientId=client,
    )

    def least_distance(path: Any, body: int) -> float:
        least = 1.0
        for configuration in path:
            for index, angle in zip(indices, configuration, strict=True):
                pybullet.resetJointState(arm, index, angle, physicsClientId=client)
            near = pybullet.getClosestPoints(arm, body, 1.0, physicsClientId=client)
            least = min([least, *(contact[8] for contact in near)])
        return least

    assert least_distance(positions, duck) > 0.0
    assert least_distance(positions, points) > 0.0
    # The recordings run into the mesh.
    assert least_distance(names["arm"].demonstrations[0], duck) < 0.0
    # The scene of MoveIt: a table, a cone on it and a beam above.
    cone = trimesh.creation.cone(0.08, 0.3, sections=64)
    cone.apply_translation((0.0, 0.0, -0.15))
    cone.export(tmp_path / "cone.obj")
    shapes = [
        ({"shapeType": pybullet.GEOM_BOX, "halfExtents": [0.3, 0.6, 0.02]}, (0.6, 0.0, 0.2)),
        (
            {"shapeType": pybullet.GEOM_MESH, "fileName": str(tmp_path / "cone.obj")},
            (0.57, 0.0, 0.37),
        ),
        (
            {"shapeType": pybullet.GEOM_CYLINDER, "radius": 0.05, "height": 0.8},
            (0.55, 0.0, 1.0),
        ),
    ]
    level = pybullet.getQuaternionFromEuler((0.0, np.pi / 2, 0.0))
    bodies = [
        pybullet.createMultiBody(
            0,
            pybullet.createCollisionShape(**shape, physicsClientId=client),
            basePosition=place,
            baseOrientation=level if number == 2 else (0.0, 0.0, 0.0, 1.0),
            physicsClientId=client,
        )
        for number, (shape, place) in enumerate(shapes)
    ]
    plan = names["on_table"]
    np.testing.assert_allclose(plan.best[0], names["arm"].demonstrations[0][0], atol=1e-3)
    np.testing.assert_allclose(plan.best[-1], names["arm"].demonstrations[0][-1], atol=1e-3)
    for body in bodies:
        assert least_distance(plan.best, body) > 0.0
    assert least_distance(names["arm"].demonstrations[0], bodies[1]) < 0.0
    pybullet.disconnect(client)
