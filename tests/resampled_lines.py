"""Lines resampled by numpy's interpolation, the reference for what is compiled."""

import numpy as np


def piecewise_linear(line, count):
    """Return `count` points of a line (M, 3) at equal steps of its arc."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.linspace(0.0, arc[-1], count)
    return np.stack([np.interp(at, arc, axis) for axis in line.T], axis=-1)
