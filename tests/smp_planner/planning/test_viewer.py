"""Pages of plans: what viser serves, asked of its server, and moved by its controls."""

import time
import urllib.request

import numpy as np
import pytest

from smp_gym.robot import kinematics
from smp_gym.scene import Obstacle
from smp_planner import SMP, Circle
from smp_planner.collision.robot_model import jaco_model
from smp_planner.planning.viewer import Exhibit, Lines, Motion, exhibit_of, show

PHASE = np.linspace(0.0, 1.0, 40)
BOX = Obstacle(shape="box", position=(0.5, -0.3, 0.1), size=(0.05, 0.1, 0.2))


@pytest.fixture(scope="module")
def plan():
    bows = (-0.1, 0.0, 0.1, 0.2)
    paths = [np.stack([PHASE, b * np.sin(np.pi * PHASE), 0.1 * PHASE], axis=1) for b in bows]
    ball = Obstacle(shape="sphere", position=(0.5, 0.05, 0.05), size=(0.08, 0.08, 0.08))
    return SMP.fit(paths).adapt([ball, BOX], start=(0.0, 0.0, 0.0), goal=(1.0, 0.0, 0.1),
                                particles=6, method="promp")  # fmt: skip


@pytest.fixture
def served():
    pages = []

    def serve(exhibit):
        pages.append(show(exhibit, port=18431))
        return pages[-1]

    yield serve
    for page in pages:
        page.close()


def test_a_page_holds_what_the_plan_does(plan, served):
    exhibit = exhibit_of(plan)
    shown = sum(len(lines.paths) for label, lines in exhibit.lines.items() if ":" in label)
    assert shown == 4 + 6
    np.testing.assert_array_equal(exhibit.lines["chosen particle"].paths[0], plan.best)
    assert list(exhibit.obstacles) == list(plan.display["obstacles"])
    page = served(exhibit)
    assert b"<title>Viser</title>" in urllib.request.urlopen(page.address, timeout=10).read()
    assert page.address.startswith("http://127.0.0.1:")
    assert [name for name in page.nodes if name.startswith("obstacles")] == [
        "obstacles/0",
        "obstacles/1",
    ]
    node = page.nodes["lines/chosen particle"]
    pieces = np.stack([plan.best[:-1], plan.best[1:]], axis=1)
    np.testing.assert_allclose(node.points, pieces, atol=1e-6)
    page.controls["chosen particle"].value = False
    assert until(lambda: not node.visible)


def test_the_slider_moves_the_robot(served):
    spheres = kinematics.arm_spheres()
    turning = np.zeros((11, 6)) + kinematics.JOINT_LOWER.clip(-3.0) + 1.0
    turning[:, 0] = np.linspace(-0.5, 0.5, 11)
    centers = kinematics.sphere_centers(turning, spheres)
    motion, still = Motion(centers, spheres.radius), Motion(centers[:1], spheres.radius)
    lines = {"path": Lines([centers[:, -1]], "#f28c1c")}
    page = served(Exhibit("arm", lines, [BOX], motions={"turning": motion, "still": still}))
    assert list(page.controls) == ["path", "trajectory", "phase"]
    count = len(spheres.radius)
    assert until(lambda: near(page, count, centers[0]))
    page.controls["phase"].value = 0.5
    assert until(lambda: near(page, count, centers[5]))
    page.controls["trajectory"].value = "still"
    assert until(lambda: near(page, count, centers[0]))


def near(page, count, centers):
    shown = [page.nodes[f"robot/{number}"].position for number in range(count)]
    return np.allclose(shown, centers, atol=1e-6)


def until(true, seconds=10.0):
    """Return whether something comes true: controls act in a thread of the server."""
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.01)
    return true()


def test_faces_are_those_of_the_body(served):
    mesh = served(Exhibit("box", {}, [BOX])).nodes["obstacles/0"]
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    low, high = np.array(BOX.position) - BOX.size, np.array(BOX.position) + BOX.size
    np.testing.assert_allclose([vertices.min(axis=0), vertices.max(axis=0)], [low, high], atol=1e-6)
    corners = vertices[faces]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    a, b, c = 2 * np.array(BOX.size)
    assert areas.sum() / 2 == pytest.approx(2 * (a * b + b * c + a * c), rel=1e-5)


def test_the_model_of_a_robot_gives_its_spheres(plan):
    model = jaco_model()
    paths = np.zeros((6, 5, 6)) + kinematics.JOINT_LOWER.clip(-3.0) + 1.0
    arm = plan.changed(
        trajectories=paths,
        tool_paths=np.zeros((6, 5, 3)),
        display={"model": model, "tool_demonstrations": []},
    )
    motion = exhibit_of(arm).motions["chosen particle"]
    expected = kinematics.sphere_centers(paths[0], kinematics.arm_spheres())
    np.testing.assert_allclose(motion.centers, expected, atol=1e-9)
    np.testing.assert_array_equal(motion.radii, kinematics.arm_spheres().radius)


def test_paths_in_the_plane_are_refused():
    flat = [np.stack([PHASE, bow * np.sin(np.pi * PHASE)], axis=1) for bow in (0.1, 0.2)]
    plan = SMP.fit(flat).adapt([Circle((0.5, 0.1), 0.05)], particles=2, method="promp")
    with pytest.raises(ValueError, match=r"in space and of robots .*D = 2; plot draws"):
        plan.watch()
