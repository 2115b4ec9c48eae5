import math

import numpy as np
import pytest
from pydantic import ValidationError

from smp_gym.scene import (
    BIN_HEIGHT,
    BIN_INNER_HALF_WIDTH,
    MAX_OBSTACLES,
    Goal,
    ManipulatedObject,
    Obstacle,
    Scene,
    fixtures,
)

START = (-0.78, 3.53, 0.98, 0.06, 2.66, -0.04)
BALL = Obstacle(shape="sphere", position=(0.5, 0.0, 0.3), size=(0.05, 0.05, 0.05))


def scene(**changes):
    values = {
        "task": "Placement",
        "difficulty": "easy",
        "seed": 7,
        "start": START,
        "manipulated": ManipulatedObject(),
        "goals": (Goal(position=(0.52, 0.32, 0.01)),),
        "obstacles": (
            BALL,
            Obstacle(
                shape="box",
                position=(0.1 + 0.2, 1 / 3, 0.25),
                quaternion=(0.0, 0.0, math.sin(0.3), math.cos(0.3)),
                size=(0.03, 0.04, 0.05),
            ),
        ),
    }
    return Scene(**(values | changes))


def test_json_gives_back_the_scene_to_the_last_bit():
    assert Scene.from_json(scene().to_json()) == scene()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"task": "Juggling"}, "Placement"),
        ({"difficulty": "brutal"}, "medium"),
        ({"start": (0.0, 0.0)}, "start"),
        ({"start": (math.nan,) * 6}, "start"),
        ({"goals": ()}, "goals"),
        ({"obstacles": (BALL,) * (MAX_OBSTACLES + 1)}, "obstacles"),
        ({"seed": -1}, "seed"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_bad_scene_is_refused_with_the_name_of_what_is_wrong(change, named):
    with pytest.raises(ValidationError, match=named):
        scene(**change)


@pytest.mark.parametrize(
    "change",
    [
        {"size": (0.05, 0.05, 0.0)},
        {"size": (0.05, -0.05, 0.05)},
        {"size": (0.05, math.inf, 0.05)},
        {"shape": "cone"},
        {"shape": "cylinder", "size": (0.05, 0.04, 0.1)},
        {"size": (0.05, 0.05, 0.06)},
        {"position": (0.0, math.nan, 0.0)},
        {"quaternion": (0.0, 0.0, 0.0, 2.0)},
        {"quaternion": (0.0, 0.0, 0.0, 0.0)},
    ],
)
def test_a_bad_obstacle_is_refused(change):
    with pytest.raises(ValidationError):
        Obstacle.model_validate(BALL.model_dump() | change)


def test_text_that_is_no_scene_is_refused():
    for text in ("", "{", "[]", '{"task": "Placement"}'):
        with pytest.raises(ValidationError):
            Scene.from_json(text)


def test_the_bin_is_a_closed_box_open_at_the_top():
    table, *boxes = fixtures(scene())
    assert table.position[2] + table.size[2] == 0.0
    x, y, z = scene().goals[0].position

    def free_way(origin, direction):
        """Walk until a box is entered."""
        for distance in np.arange(0.0, 0.5, 1e-4):
            point = np.add(origin, distance * np.asarray(direction))
            if any((np.abs(point - b.position) < b.size).all() for b in boxes):
                return distance
        return math.inf

    middle = (x, y, z + BIN_HEIGHT / 2)
    for direction in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)):
        assert free_way(middle, direction) == pytest.approx(BIN_INNER_HALF_WIDTH, abs=2e-4)
    assert free_way(middle, (0, 0, -1)) == pytest.approx(BIN_HEIGHT / 2, abs=2e-4)
    assert free_way(middle, (0, 0, 1)) == math.inf
    top = max(box.position[2] + box.size[2] for box in boxes)
    assert top == pytest.approx(z + BIN_HEIGHT)
