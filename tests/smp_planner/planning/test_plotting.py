"""Figures of plans: what is drawn, by class, and where; pictures of notebooks."""

import io
from dataclasses import replace

import imageio.v2 as imageio
import numpy as np
import pytest

from smp_gym.scene import Obstacle
from smp_planner.collision.robot_model import jaco_model
from smp_planner.planning.plan import Plan

PHASE = np.linspace(0.0, 1.0, 30)
BALL = Obstacle(shape="sphere", position=(0.5, 0.0, 0.9), size=(0.1, 0.1, 0.1))


def plan_of(dimension, **fields):
    """Return a plan of 6 particles of two classes, the last of them in collision."""
    heights = np.array([0.3, 0.4, 0.5, -0.3, -0.4, 0.0])
    bow = heights[:, None] * np.sin(np.pi * PHASE)
    paths = np.stack([np.broadcast_to(PHASE, bow.shape), *[bow] * (dimension - 1)], axis=-1)
    free = np.array([True] * 5 + [False])
    return Plan(
        trajectories=paths,
        costs={},
        collision_free=free,
        clearance=np.where(free, 0.1, -0.1),
        missed={},
        passing=np.ones(6, np.bool_),
        duration=np.ones(6),
        executable=np.ones(6, np.bool_),
        ranks=np.array([2, 0, 1, 3, 4, 5]),
        signatures=np.array([[0, 1]] * 3 + [[0, -1]] * 3),
        display={"demonstrations": paths[5:], **fields.pop("display", {})},
        **fields,
    )


def test_particles_have_the_colour_of_their_class():
    plan = plan_of(2, display={"outlines": [np.array([(0.4, -0.1), (0.6, -0.1), (0.5, 0.1)])]})
    axes = plan.plot()
    demonstrated, *particles, chosen = axes.lines
    # Those that are good come by class, then what is not good, then the chosen one again.
    colors = [line.get_color() for line in particles]
    assert len({*colors}) == 3
    assert colors[0] == colors[1] == colors[2] != colors[3] == colors[4] != colors[5]
    assert [line.get_linestyle() for line in particles] == ["-"] * 5 + [":"]
    np.testing.assert_array_equal(chosen.get_xydata(), plan.trajectories[1])
    np.testing.assert_array_equal(demonstrated.get_xydata(), plan.trajectories[5])
    assert len(axes.patches) == 1
    labels = [text.get_text() for text in axes.figure.legends[0].get_texts()]
    classes = ["class 1: 3", "class 2: 2", "not good: 1"]
    assert labels == ["demonstrations", *classes, "chosen particle"]


def test_paths_in_space_are_drawn_with_bodies_around():
    plan = plan_of(3, display={"obstacles": (BALL,)})
    axes = plan.plot()
    assert axes.name == "3d"
    assert len(axes.lines) == 1 + 6 + 1
    assert len(axes.collections) == 1
    # The ball lies above all paths: the axes have room for both.
    assert axes.get_zlim()[0] <= -0.4
    assert axes.get_zlim()[1] >= 0.99


def test_of_a_robot_the_paths_of_the_tool_are_drawn_and_its_joints():
    tool = plan_of(3).trajectories
    display = {
        "tool_demonstrations": tool[:2],
        "joints": [f"joint_{n}" for n in range(1, 7)],
        "model": replace(jaco_model(), lower=np.full(6, -1.0), upper=np.full(6, 2.2)),
    }
    plan = plan_of(6, tool_paths=tool, display=display)
    axes = plan.plot()
    assert len(axes.lines) == 2 + 6 + 1
    np.testing.assert_allclose(np.array(axes.lines[-1].get_data_3d()).T, tool[1])
    panels = plan.plot_joints().axes
    assert [panel.get_title() for panel in panels[:2]] == ["joint_1, rad", "joint_2, rad"]
    for number, panel in enumerate(panels):
        values = [line.get_ydata() for line in panel.lines]
        np.testing.assert_array_equal(values[7], plan.trajectories[1, :, number])
        drawn = [float(value[0]) for value in values[8:]]
        # The first joint turns from 0 to 1, the others from -0.4 to 0.5: limits far from that
        # would flatten the lines.
        assert drawn == ([] if number == 0 else [-1.0])


def test_an_axes_of_ones_own_is_drawn_into():
    own = plan_of(2).plot().figure.add_subplot()
    assert plan_of(2).plot(own) is own
    assert own.get_legend() is not None


def test_other_coordinates_are_drawn_over_the_phase_only():
    plan = plan_of(5)
    with pytest.raises(ValueError, match=r"got D = 5; plot_joints draws"):
        plan.plot()
    figure = plan.plot_joints()
    assert [panel.get_title() for panel in figure.axes if panel.get_visible()] == [
        f"coordinate {n}" for n in range(5)
    ]


@pytest.mark.parametrize("dimension", [2, 3, 5])
def test_notebooks_show_a_picture(dimension):
    picture = imageio.imread(io.BytesIO(plan_of(dimension)._repr_png_()))
    assert min(picture.shape[:2]) > 200
    # Something of every colour is on it.
    assert len(np.unique(picture.reshape(-1, picture.shape[-1]), axis=0)) > 50
