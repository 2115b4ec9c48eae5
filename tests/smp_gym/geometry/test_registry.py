"""A capsule from outside the packages goes through the public seams only."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from smp_gym.geometry.registry import REGISTRY, ROUND, SHAPES, bound, distance, gradient

HERE = Path(__file__).parent
ROOT = Path(__file__).parents[3]
SIZES = {"box": (0.1, 0.2, 0.3), "cylinder": (0.1, 0.1, 0.3), "sphere": (0.2, 0.2, 0.2)}


def _installed(folder, names):
    """Lay out a distribution with a module of shapes, as an installer would."""
    shutil.copy(HERE / "capsule.py", folder)
    info = folder / "capsule-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: capsule\nVersion: 1.0\n")
    lines = "".join(f"{name} = {value}\n" for name, value in names.items())
    (info / "entry_points.txt").write_text(f"[smp_gym.shapes]\n{lines}")
    return os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}


def test_a_capsule_is_taken_by_environment_checks_and_planner(tmp_path):
    environment = _installed(tmp_path, {"capsule": "capsule:Capsule"})
    ended = subprocess.run(
        [sys.executable, HERE / "use_capsule.py"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert "taken" in ended.stdout


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"other": "capsule:revolved"}, "must be a subclass of Shape"),
        ({"a": "capsule:Capsule", "b": "capsule:Capsule"}, "names of their own"),
    ],
)
def test_what_is_no_new_shape_is_refused(tmp_path, names, message):
    ended = subprocess.run(
        [sys.executable, "-c", "import smp_gym"],
        env=_installed(tmp_path, names),
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode != 0
    assert message in ended.stderr


@pytest.mark.parametrize("name", SIZES)
def test_the_choice_among_shapes_is_that_of_the_shape(name):
    shape, size = REGISTRY[name], np.array(SIZES[name])
    index = SHAPES.index(name)
    for a, b, c in np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3)):
        assert distance(index, a, b, c, size) == shape.distance(a, b, c, size)
        assert gradient(index, a, b, c, size) == shape.gradient(a, b, c, size)
        if ROUND[index]:
            turned = np.hypot(a, b)
            assert shape.distance(turned, 0.0, c, size) == pytest.approx(
                shape.distance(a, b, c, size), abs=1e-12
            )
    assert bound(index, size) == shape.bound(size)


@pytest.mark.parametrize("name", SIZES)
def test_bounds_hold_all_of_a_body_and_are_touched(name):
    rng = np.random.default_rng(1)
    shape, size = REGISTRY[name], np.array(SIZES[name])
    surface = np.concatenate(shape.faces(size))
    assert np.abs([shape.distance(*point, size) for point in surface]).max() < 1e-12
    assert np.linalg.norm(surface, axis=1).max() == pytest.approx(shape.bound(size))
    assert np.linalg.norm(surface[:, :2], axis=1).max() == pytest.approx(shape.radius(size))
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    turned = surface @ rotation.T
    assert (np.abs(turned).max(axis=0) <= shape.half_extents(rotation, size) + 1e-12).all()
    radius, half = shape.upright(rotation, size)
    assert np.linalg.norm(turned[:, :2], axis=1).max() <= radius + 1e-12
    assert np.abs(turned[:, 2]).max() == pytest.approx(half, rel=0.02)
    assert np.array_equal(shape.fitted(size), size)
