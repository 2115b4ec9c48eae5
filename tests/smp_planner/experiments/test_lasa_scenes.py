"""Scenes in the plane, as a command line describes them and as they are told."""

import numpy as np
import pytest

from smp_planner.experiments.lasa_scenes import FIGURE_1, FIGURE_2A, described, scene_of
from smp_planner.library.smp import AnyOf, Circle, ViaPoint


def test_texts_become_obstacles_via_points_and_an_end():
    scene = scene_of("GShape", ["1,-2,3"], ["0.5,4,5", "0.25,0,1", "0.5,6,7"], "8,9.5")
    assert (scene.shape, scene.goal) == ("GShape", (8.0, 9.5))
    assert scene.obstacles == (Circle((1.0, -2.0), 3.0),)
    choice, single = scene.via_points
    assert isinstance(choice, AnyOf)
    assert [option.position.tolist() for option in choice.options] == [[4.0, 5.0], [6.0, 7.0]]
    assert {option.phase for option in choice.options} == {0.5}
    assert isinstance(single, ViaPoint)
    np.testing.assert_array_equal(single.position, [0.0, 1.0])


def test_a_default_stands_in_for_its_bare_shape_only():
    assert scene_of("Sshape", default=FIGURE_1) is FIGURE_1
    assert scene_of("Sshape", ["1,2,3"], default=FIGURE_1).goal is None
    assert scene_of("GShape", default=FIGURE_1).obstacles == ()


@pytest.mark.parametrize("text", ["1,2", "1,2,3,4", "a,b,c", ""])
def test_other_texts_are_refused(text):
    with pytest.raises(ValueError, match=f"obstacle must be 3 numbers joined by ',', got '{text}'"):
        scene_of("Sshape", [text])


def test_a_scene_is_told_in_full():
    assert described(FIGURE_1) == (
        "Sshape, obstacles (-2, 33) radius 3, (38, 10) radius 3, end (0, 0); mm"
    )
    assert described(FIGURE_2A) == (
        "Sshape+WShape, obstacles none, via-point (27, 28) at phase 0.5 or (-25, 6) at phase 0.5, "
        "end (10, -12); mm"
    )
