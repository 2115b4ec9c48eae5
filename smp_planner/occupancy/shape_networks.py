"""The default map of Eq. (12): one small network per obstacle shape, composed over the scene.

A network learns the signed distance of one shape in the obstacle's own frame, once for all scenes
(`shape_training`); the scene is the minimum over its obstacles, and `occupancy` makes of it the
sigmoid output of Eq. (12). So there is nothing to train when a scene changes.

What a network sees is folded by the shape's symmetries: the offsets of the point from the faces of
the body (of a box |local| - half-extents; of a cylinder the radial and the axial one; of a sphere
the radial one), sorted in falling order and cut off at minus the truncation distance. Distance
depends on nothing else, so any half-extents will do, from a 5 mm wall to a table: a face that is
deeper than the truncation distance has no say in a distance cut off there. Sorting moves the
creases of the inner distance, which a smooth network cannot follow, to the border of the domain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smp_gym.arrays import Float32Array
from smp_gym.compiling import kernel
from smp_gym.geometry.distance import PackedObstacles, check_points, signed_distance, to_local
from smp_gym.scene import Obstacle
from smp_gym.untrusted_files import read_file
from smp_planner.occupancy.analytic import AnalyticMap
from smp_planner.occupancy.archive import read_archive, write_archive
from smp_planner.occupancy.occupancy_map import window

__all__ = ["NETWORK_SHAPES", "ShapeNetworkMap", "ShapeNetworks", "default_networks", "face_offsets"]

_BOX, _CYLINDER = 0, 1
NETWORK_SHAPES = ("box", "cylinder", "sphere")
"""Shapes with a network, the first of `smp_gym.scene.SHAPES`; of others the distance is exact."""

_HEADER = {"format": "smp-shape-networks", "version": 1, "shapes": list(NETWORK_SHAPES)}

_BATCH_POINTS = 128
"""Points that go through a network together, so that its inner loops run over whole vectors."""

# Lambert's continued fraction of tanh, cut to a quotient of polynomials in the square.
_N0, _N1, _N2 = np.float32(135135.0), np.float32(17325.0), np.float32(378.0)
_D0, _D1, _D2, _D3 = np.float32(135135.0), np.float32(62370.0), np.float32(3150.0), np.float32(28.0)
_HALF, _TWO, _LIMIT = np.float32(0.5), np.float32(2.0), np.float32(4.5)


@dataclass(frozen=True)
class ShapeNetworks:
    """Networks with two tanh layers of H units, one for each of the S `NETWORK_SHAPES`.

    Inputs and output are in units of the truncation distance.

    Attributes:
        truncation: m.
        weight1: (S, H, 3) float32, as all below.
        bias1: (S, H).
        weight2: (S, H, H).
        bias2: (S, H).
        weight3: (S, H).
        bias3: (S,).
    """

    truncation: float
    weight1: Float32Array
    bias1: Float32Array
    weight2: Float32Array
    bias2: Float32Array
    weight3: Float32Array
    bias3: Float32Array

    def __post_init__(self) -> None:
        if not (math.isfinite(self.truncation) and self.truncation > 0.0):
            raise ValueError(f"ShapeNetworks.truncation must be positive, got {self.truncation}")
        shapes, hidden = len(NETWORK_SHAPES), np.shape(self.bias1)[-1]
        expected = {
            "weight1": (shapes, hidden, 3),
            "bias1": (shapes, hidden),
            "weight2": (shapes, hidden, hidden),
            "bias2": (shapes, hidden),
            "weight3": (shapes, hidden),
            "bias3": (shapes,),
        }
        for name, shape in expected.items():
            array = np.ascontiguousarray(getattr(self, name), np.float32)
            if array.shape != shape:
                raise ValueError(f"ShapeNetworks.{name} must be {shape}, got {array.shape}")
            if not np.isfinite(array).all():
                raise ValueError(f"ShapeNetworks.{name} must be finite")
            object.__setattr__(self, name, array)

    @property
    def arrays(self) -> tuple[Float32Array, ...]:
        """Tuple of the six arrays in the order above."""
        return tuple(getattr(self, f.name) for f in fields(self)[1:])

    def save(self, path: str | Path) -> None:
        """Write an `.npz` without pickled objects, which `load` gives back exactly."""
        write_archive(
            path, _HEADER, {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        )

    @classmethod
    def load(cls, path: str | Path) -> ShapeNetworks:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, is something else, or is of another version.
        """
        return cls._parse(read_file(path), str(path))

    @classmethod
    def _parse(cls, content: bytes, source: str) -> ShapeNetworks:
        arrays = read_archive(content, source, _HEADER)
        names = {f.name for f in fields(cls)}
        if set(arrays) != names or arrays["truncation"].shape != ():
            raise ValueError(f"{source} must hold {sorted(names)}, got {sorted(arrays)}")
        return cls(float(arrays.pop("truncation")), **arrays)


@lru_cache(maxsize=1)
def default_networks() -> ShapeNetworks:
    """Return the networks that come with the package."""
    file = resources.files("envs_assets") / "occupancy" / "shape_networks.npz"
    return ShapeNetworks._parse(file.read_bytes(), str(file))


@kernel
def _offsets(a, b, c, shape, size, truncation):  # type: ignore[no-untyped-def]
    """Return the offsets of a local point from the body's faces: folded, cut off and sorted, m."""
    if shape == _BOX:
        u, v, w = abs(a) - size[0], abs(b) - size[1], abs(c) - size[2]
    elif shape == _CYLINDER:
        u, v, w = math.sqrt(a * a + b * b) - size[0], abs(c) - size[2], -truncation
    else:
        u, v, w = math.sqrt(a * a + b * b + c * c) - size[0], -truncation, -truncation
    u, v, w = max(u, -truncation), max(v, -truncation), max(w, -truncation)
    if u < v:
        u, v = v, u
    if v < w:
        v, w = w, v
    if u < v:
        u, v = v, u
    return u, v, w


@kernel
def _all_offsets(points, shape, sizes, truncation):  # type: ignore[no-untyped-def]
    result = np.empty((len(points), 3))
    for i in range(len(points)):
        a, b, c = points[i]
        result[i, 0], result[i, 1], result[i, 2] = _offsets(a, b, c, shape, sizes[i], truncation)
    return result


def face_offsets(
    points: NDArray[np.float64], shape: str, sizes: NDArray[np.float64], truncation: float
) -> NDArray[np.float64]:
    """Return the inputs of a network for points near bodies of one shape.

    Args:
        points: (N, 3) m, each in the frame of its own body.
        shape: one of `NETWORK_SHAPES`.
        sizes: (N, 3) m, half-extents of the bodies, as in `Obstacle.size`.
        truncation: m.

    Returns:
        (N, 3), in units of the truncation, falling in each row; -1 is the least entry.
    """
    return np.asarray(
        _all_offsets(points, NETWORK_SHAPES.index(shape), sizes, truncation) / truncation,
        np.float64,
    )


@kernel(fastmath=True, error_model="numpy")
def _tanh(x):  # type: ignore[no-untyped-def]
    # The fraction is good to 5e-5 up to 4.5; applied to x / 2 and doubled by the addition theorem
    # this becomes 1e-7, and unlike the library's tanh it runs on whole vectors.
    t = min(max(_HALF * x, -_LIMIT), _LIMIT)
    s = t * t
    n = t * (_N0 + s * (_N1 + s * (_N2 + s)))
    d = _D0 + s * (_D1 + s * (_D2 + s * _D3))
    return _TWO * n * d / (n * n + d * d)


@kernel(fastmath=True, error_model="numpy")
def _forward(inputs, count, w1, b1, w2, b2, w3, b3):  # type: ignore[no-untyped-def]
    """Return the (count,) float32 outputs of one network for inputs (3, >= count) float32."""
    hidden = len(b1)
    first = np.empty((hidden, _BATCH_POINTS), np.float32)
    second = np.empty(_BATCH_POINTS, np.float32)
    total = np.empty(_BATCH_POINTS, np.float32)
    result = np.empty(count, np.float32)
    for start in range(0, count, _BATCH_POINTS):
        n = min(_BATCH_POINTS, count - start)
        x, y, z = inputs[0, start:], inputs[1, start:], inputs[2, start:]
        for h in range(hidden):
            row, wx, wy, wz, bias = first[h], w1[h, 0], w1[h, 1], w1[h, 2], b1[h]
            for i in range(n):
                row[i] = _tanh(bias + wx * x[i] + wy * y[i] + wz * z[i])
        total[:n] = b3
        for h in range(hidden):
            second[:n] = b2[h]
            for g in range(hidden):
                row, weight = first[g], w2[h, g]
                for i in range(n):
                    second[i] += weight * row[i]
            weight = w3[h]
            for i in range(n):
                total[i] += weight * _tanh(second[i])
        result[start : start + n] = total[:n]
    return result


@kernel
def _lower(values, points, truncation, bodies, networks):  # type: ignore[no-untyped-def]
    """Lower values (N,) to the composed map's distance at points (N, 3)."""
    shape, rotation, position, size = bodies
    w1, b1, w2, b2, w3, b3 = networks
    inputs = np.empty((3, len(points)), np.float32)
    where = np.empty(len(points), np.int64)
    for n in range(len(shape)):
        s, m = shape[n], 0
        for i in range(len(points)):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            a, b, c = to_local(x, y, z, rotation[n], position[n])
            u, v, w = _offsets(a, b, c, s, size[n], truncation)
            if u < truncation:
                inputs[0, m], inputs[1, m], inputs[2, m] = u, v, w
                where[m] = i
                m += 1
        inputs[:, :m] /= np.float32(truncation)
        output = _forward(inputs, m, w1[s], b1[s], w2[s], b2[s], w3[s], b3[s])
        for i in range(m):
            distance = max(truncation * output[i], -truncation)
            if distance < values[where[i]]:
                values[where[i]] = distance


@kernel
def _fill(values, planes, origin, spacing, truncation, half_extents, bodies, networks):  # type: ignore[no-untyped-def]
    """Lower the nodes on planes of a grid, (first, end), to the composed map's distance."""
    shape, rotation, position, size = bodies
    w1, b1, w2, b2, w3, b3 = networks
    scale = np.float32(1.0 / truncation)
    for n in range(len(shape)):
        s = shape[n]
        reach = half_extents[n] + truncation
        i0, i1 = window(values.shape[0], origin[0], spacing, position[n, 0], reach[0])
        i0, i1 = max(i0, planes[0]), min(i1, planes[1])
        j0, j1 = window(values.shape[1], origin[1], spacing, position[n, 1], reach[1])
        k0, k1 = window(values.shape[2], origin[2], spacing, position[n, 2], reach[2])
        column = k1 - k0
        nodes = max(i1 - i0, 0) * max(j1 - j0, 0) * max(column, 0)
        inputs = np.empty((3, nodes), np.float32)
        slot = np.empty(nodes, np.int32)
        node, m = 0, 0
        for i in range(i0, i1):
            x = origin[0] + spacing * i
            for j in range(j0, j1):
                y = origin[1] + spacing * j
                for k in range(k0, k1):
                    a, b, c = to_local(x, y, origin[2] + spacing * k, rotation[n], position[n])
                    u, v, w = _offsets(a, b, c, s, size[n], truncation)
                    slot[node] = -1
                    if u < truncation:
                        u, v, w = (
                            scale * np.float32(u),
                            scale * np.float32(v),
                            scale * np.float32(w),
                        )
                        # Columns over a wide body such as a table see all the same: ask once.
                        last = slot[node - column] if node >= column else np.int32(-1)
                        if (
                            last >= 0
                            and inputs[0, last] == u
                            and inputs[1, last] == v
                            and inputs[2, last] == w
                        ):
                            slot[node] = last
                        else:
                            inputs[0, m], inputs[1, m], inputs[2, m] = u, v, w
                            slot[node] = m
                            m += 1
                    node += 1
        output = _forward(inputs, m, w1[s], b1[s], w2[s], b2[s], w3[s], b3[s])
        node = 0
        for i in range(i0, i1):
            for j in range(j0, j1):
                for k in range(k0, k1):
                    if slot[node] >= 0:
                        distance = max(truncation * output[slot[node]], -truncation)
                        if distance < values[i, j, k]:
                            values[i, j, k] = distance
                    node += 1


@dataclass(frozen=True)
class ShapeNetworkMap:
    """Shape networks composed over a scene by minimum, an `OccupancyMap`.

    Attributes:
        obstacles: bodies at the pose they have now; may be empty.
        networks: one for each of `NETWORK_SHAPES`; other bodies have their exact distance.
    """

    obstacles: tuple[Obstacle, ...]
    networks: ShapeNetworks

    @property
    def truncation(self) -> float:
        """Distance, m, at which the map is cut off: that of its networks."""
        return self.networks.truncation

    @property
    def _parts(self) -> tuple[tuple[Obstacle, ...], tuple[Obstacle, ...]]:
        """Obstacles with a network for their shape, and those without."""
        known = tuple(o for o in self.obstacles if o.shape in NETWORK_SHAPES)
        return known, tuple(o for o in self.obstacles if o.shape not in NETWORK_SHAPES)

    def signed_distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the learned signed distance; see `OccupancyMap.signed_distance`."""
        array = check_points(points)
        learned, exact = self._parts
        values = np.minimum(signed_distance(array.reshape(-1, 3), exact), self.truncation)
        bodies = PackedObstacles.of(learned).arrays[:4]
        values = np.maximum(values, -self.truncation)
        _lower(values, array.reshape(-1, 3), self.truncation, bodies, self.networks.arrays)
        return values.reshape(array.shape[:-1])

    def fill(
        self,
        values: Float32Array,
        origin: NDArray[np.float64],
        spacing: float,
        planes: tuple[int, int] | None = None,
    ) -> None:
        """Lower the nodes of a grid to the learned distance; see `OccupancyMap.fill`."""
        learned, exact = self._parts
        AnalyticMap(exact, self.truncation).fill(values, origin, spacing, planes)
        packed = PackedObstacles.of(learned)
        bodies, extents = packed.arrays[:4], packed.half_extents
        _fill(
            values,
            planes or (0, len(values)),
            origin,
            spacing,
            self.truncation,
            extents,
            bodies,
            self.networks.arrays,
        )
