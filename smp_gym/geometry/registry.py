"""The registry of obstacle shapes, and the kernels that choose among them.

A shape of one's own is a subclass of `Shape`, named as an entry point of the group
``smp_gym.shapes`` in its package's metadata. Shapes are fixed when a process starts, because the
kernels are compiled with all of them in, and observations have a flag for each. Shapes of other
packages follow the built-in ones, in the order of their names.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

import numpy as np

from smp_gym.compiling import kernel
from smp_gym.geometry.box import Box
from smp_gym.geometry.cylinder import Cylinder
from smp_gym.geometry.shape import Kernel, Shape
from smp_gym.geometry.sphere import Sphere

__all__ = ["BUILT_IN", "REGISTRY", "ROUND", "SHAPES", "bound", "distance", "gradient"]

ENTRY_POINTS = "smp_gym.shapes"
"""Group of entry points that name the shapes of other packages."""

BUILT_IN: tuple[Shape, ...] = (Box(), Cylinder(), Sphere())


def _registered() -> dict[str, Shape]:
    shapes = list(BUILT_IN)
    for entry in sorted(entry_points(group=ENTRY_POINTS), key=lambda entry: entry.name):
        made: Any = entry.load()
        if not (isinstance(made, type) and issubclass(made, Shape)):
            raise TypeError(f"{entry.value} must be a subclass of Shape, got {made!r}")
        shapes.append(made())
    named = {shape.name: shape for shape in shapes}
    if len(named) != len(shapes):
        raise ValueError(f"shapes must have names of their own, got {[s.name for s in shapes]}")
    return named


REGISTRY = _registered()
"""All shapes by name."""

SHAPES = tuple(REGISTRY)
"""Names of the shapes, in the order of the one-hot code of an observation row."""

ROUND = np.array([shape.round for shape in REGISTRY.values()])
"""(len(SHAPES),) whether a shape is round about its own z axis."""


def _chosen(kernels: list[Kernel], index: int = 0) -> Kernel:
    """Return a kernel that passes all but the shape on to the one of that index."""
    first = kernels[index]
    if index + 1 == len(kernels):

        @kernel
        def last(shape, *args):  # type: ignore[no-untyped-def]
            return first(*args)

        return last
    others = _chosen(kernels, index + 1)

    @kernel
    def choice(shape, *args):  # type: ignore[no-untyped-def]
        if shape == index:
            return first(*args)
        return others(shape, *args)

    return choice


distance = _chosen([shape.distance for shape in REGISTRY.values()])
"""Kernel ``(shape, a, b, c, size)``: signed distance, m, of a body to a point of its own frame."""

gradient = _chosen([shape.gradient for shape in REGISTRY.values()])
"""Kernel ``(shape, a, b, c, size)``: gradient of `distance`, three floats."""

bound = _chosen([shape.bound for shape in REGISTRY.values()])
"""Kernel ``(shape, size)``: radius of the bounding ball around the centre, m."""
