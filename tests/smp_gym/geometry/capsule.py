"""A shape of another package: capsules along z; size is (radius, radius, half length)."""

import math

import numpy as np

from smp_gym.compiling import kernel
from smp_gym.geometry.shape import Shape, SolidArguments, revolved


@kernel
def _distance(a, b, c, size):
    beyond = max(abs(c) - (size[2] - size[0]), 0.0)
    return math.sqrt(a * a + b * b + beyond * beyond) - size[0]


@kernel
def _gradient(a, b, c, size):
    beyond = math.copysign(max(abs(c) - (size[2] - size[0]), 0.0), c)
    norm = math.sqrt(a * a + b * b + beyond * beyond)
    if norm > 0.0:
        return a / norm, b / norm, beyond / norm
    return 1.0, 0.0, 0.0


@kernel
def _bound(size):
    return float(size[2])


class Capsule(Shape):
    name = "capsule"
    measures = "(radius, radius, half length), at least the radius"
    dimensions = 2
    round = True
    distance = staticmethod(_distance)
    gradient = staticmethod(_gradient)
    bound = staticmethod(_bound)

    def fitted(self, size):
        radius = size[..., 0]
        return np.stack([radius, radius, np.maximum(radius, size[..., 2])], axis=-1)

    def of_dimensions(self, dimensions):
        length, radius = dimensions
        return np.array([radius, radius, length / 2])

    def upright(self, rotation, size):
        straight = size[2] - size[0]
        lean, up = np.hypot(*rotation[:2, 2]), abs(rotation[2, 2])
        return float(lean * straight + size[0]), float(up * straight + size[0])

    def faces(self, size):
        polar = np.linspace(-np.pi / 2, np.pi / 2, 21)
        height = size[0] * np.sin(polar) + np.sign(polar) * (size[2] - size[0])
        return revolved(height, size[0] * np.cos(polar))

    def solid(self, size):
        radius, _, half = size
        return SolidArguments("CAPSULE", radius, tuple(size), 2.0 * (half - radius))
