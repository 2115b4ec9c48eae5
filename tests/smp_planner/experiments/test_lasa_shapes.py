"""Large obstacles before the shapes of LASA: what they leave open, and what is measured."""

import numpy as np
import pytest

from smp_gym.datasets import lasa
from smp_planner.experiments.lasa_scenes import learn
from smp_planner.experiments.lasa_shapes import METHODS, RADII, crowded_scene, shapes_rows


@pytest.mark.parametrize("shape", ["Sshape", "Multi_Models_1", "Line"])
def test_obstacles_lie_across_the_shape_and_leave_its_ends_free(shape):
    primitive = learn(shape)
    demonstrations = np.stack(primitive.demonstrations)
    for seed in range(5):
        scene = crowded_scene(primitive, shape, seed)
        assert scene == crowded_scene(primitive, shape, seed)
        assert len(scene.obstacles) == 2
        for circle in scene.obstacles:
            assert RADII[0] <= circle.radius <= RADII[1]
            apart = np.linalg.norm(demonstrations - np.array(circle.center), axis=-1)
            assert apart[:, [0, -1]].min() > circle.radius
            # What is in nobody's way is no obstacle.
            assert apart.min() < circle.radius
    assert crowded_scene(primitive, shape, 0) != crowded_scene(primitive, shape, 1)


def test_every_shape_has_a_scene():
    for shape in lasa.shape_names():
        assert crowded_scene(learn(shape), shape, 0).obstacles


def test_rows_are_of_each_scene_and_method():
    chosen = {name: METHODS[name] for name in ("smp", "promp")}
    rows = shapes_rows(["Worm"], chosen, 2, 12)
    assert [(row["method"], row["seed"]) for row in rows] == [
        ("noise floor", 0),
        ("smp", 0),
        ("promp", 0),
        ("noise floor", 1),
        ("smp", 1),
        ("promp", 1),
    ]
    assert all(row["free"] == 12.0 for row in rows if row["method"] == "smp")
    assert all(row["free"] < 12.0 for row in rows if row["method"] != "smp")
