"""The scenes of the LASA experiments, Sec. V-A, and the settings of each method in them.

The paper does not state where its obstacles, via-points and new ends lie. Those here are ours, in
the millimetres of the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from smp_gym.datasets import lasa
from smp_planner.adaptation import Adaptation, adaptation
from smp_planner.library.smp import SMP, AdaptSettings, AnyOf, Circle, ViaPoint

__all__ = [
    "FIGURE_1",
    "FIGURE_2A",
    "FIGURE_2B",
    "LASA_METHODS",
    "LASA_SMOOTH_STD",
    "TUNING_SCENES",
    "LasaScene",
    "Method",
    "described",
    "learn",
    "scene_of",
    "settings",
]

LASA_SMOOTH_STD = 3.0
"""mm, deviation added to what the demonstrations teach, 1/17 of the S; see `ProMP.fit`."""

_SAMPLES = 1000
"""T of adapted paths: between samples, a path leaves the straight line by microns only."""


@dataclass(frozen=True)
class LasaScene:
    """Scene to which a shape is adapted; lengths in mm.

    Attributes:
        shape: of `lasa.demonstrations`.
        obstacles: circles not to touch.
        via_points: to pass.
        goal: where to end; None leaves that to the demonstrations.
    """

    shape: str
    obstacles: tuple[Circle, ...] = ()
    via_points: tuple[ViaPoint | AnyOf, ...] = ()
    goal: tuple[float, float] | None = None


@dataclass(frozen=True)
class Method:
    """An adaptation and the settings of its costs.

    Attributes:
        adaptation: with its settings.
        settings: of map and costs; lengths in extents of the demonstrations.
    """

    adaptation: Adaptation
    settings: AdaptSettings


FIGURE_1 = LasaScene(
    "Sshape", (Circle((-2.0, 33.0), 3.0), Circle((38.0, 10.0), 3.0)), goal=(0.0, 0.0)
)
"""Two obstacles across the S, one in each of its bends: paths past them are of four classes."""

_NEW_END = (10.0, -12.0)

FIGURE_2A = LasaScene(
    "Sshape+WShape",
    via_points=(
        AnyOf((ViaPoint(0.5, np.array([27.0, 28.0])), ViaPoint(0.5, np.array([-25.0, 6.0])))),
    ),
    goal=_NEW_END,
)
"""Both letters through a via-point each, to one new end."""

FIGURE_2B = LasaScene(
    "Sshape+WShape",
    (
        Circle((-2.0, 33.0), 3.0),
        Circle((38.0, 10.0), 3.0),
        Circle((-30.0, -9.0), 2.5),
        Circle((-14.0, -21.0), 3.0),
    ),
    goal=_NEW_END,
)
"""Both letters past two obstacles each, to one new end."""

TUNING_SCENES = (
    LasaScene("Sshape", (Circle((20.0, 21.0), 3.0), Circle((37.0, 12.0), 3.0)), goal=(0.0, 0.0)),
    LasaScene("Sshape", (Circle((-2.0, 30.0), 3.0), Circle((28.0, 4.0), 2.5)), goal=(0.0, 0.0)),
    LasaScene("Sshape", (Circle((-1.0, 35.5), 3.0), Circle((36.0, 7.0), 2.5)), goal=(0.0, 0.0)),
    LasaScene("Sshape", (Circle((8.0, 24.0), 2.5), Circle((37.0, 15.0), 3.5)), goal=(0.0, 0.0)),
)
"""Other obstacles across the S, on which `LASA_METHODS` were tuned."""


def settings(
    weight: float = 3.0, margin: float = 0.01, edge_width: tuple[float, float] = (0.05, 0.01)
) -> AdaptSettings:
    """Return settings of map and costs; lengths in extents.

    Args:
        weight: λ of Eq. (12).
        margin: by which obstacles are enlarged.
        edge_width: of the map in the first and the last iteration.
    """
    return AdaptSettings(
        obstacle_weight=weight, margin=margin, edge_width=edge_width, samples=_SAMPLES, retries=0
    )


LASA_METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "promp": Method(adaptation("promp"), settings()),
        "smp": Method(adaptation("smp", iterations=100), settings(weight=10.0)),
        "promp_diff": Method(
            adaptation(
                "promp_diff", iterations=1000, flow_time=0.002, longest_move=0.004, fit_std=0.0025
            ),
            settings(margin=0.18, edge_width=(0.1, 0.01)),
        ),
        "cpromp": Method(adaptation("cpromp", iterations=400), settings(weight=30.0)),
        "prompt_o": Method(adaptation("prompt_o"), settings(weight=100.0, margin=0.12)),
    }
)
"""Each as it did best on `TUNING_SCENES`, see `smp_planner.experiments.tuning`."""


def learn(shape: str, smooth_std: float = LASA_SMOOTH_STD, modes: int | None = None) -> SMP:
    """Return the primitive of a shape.

    Args:
        shape: of `lasa.demonstrations`.
        smooth_std: mm, see `ProMP.fit`.
        modes: components; None lets the demonstrations decide.

    Raises:
        ValueError: there is no such shape, or `modes` is out of range.
    """
    demonstrations = lasa.demonstrations(shape)
    extent = float(np.ptp(demonstrations, axis=(0, 1)).max())
    return SMP.fit(demonstrations, smooth_std=smooth_std / extent, modes=modes)


def scene_of(
    shape: str,
    obstacles: Sequence[str] | None = None,
    vias: Sequence[str] | None = None,
    goal: str | None = None,
    default: LasaScene | None = None,
) -> LasaScene:
    """Return the scene that a command line describes; lengths in mm.

    Args:
        shape: of `lasa.demonstrations`.
        obstacles: circles "x,y,radius".
        vias: via-points "phase,x,y", of which several of one phase are a choice.
        goal: end "x,y".
        default: returned if nothing but its shape is given.

    Raises:
        ValueError: a text is not as many numbers joined by commas.
    """
    if default is not None and shape == default.shape and not (obstacles or vias or goal):
        return default
    choices: dict[float, list[ViaPoint]] = {}
    for phase, x, y in (_numbers("via", text, 3) for text in vias or ()):
        choices.setdefault(phase, []).append(ViaPoint(phase, np.array([x, y])))
    end = None if goal is None else _numbers("goal", goal, 2)
    return LasaScene(
        shape,
        tuple(
            Circle((x, y), radius)
            for x, y, radius in (_numbers("obstacle", text, 3) for text in obstacles or ())
        ),
        tuple(AnyOf(points) if len(points) > 1 else points[0] for points in choices.values()),
        None if end is None else (end[0], end[1]),
    )


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise ValueError(f"{option} must be {count} numbers joined by ',', got {text!r}")
    return numbers


def described(scene: LasaScene) -> str:
    """Return a scene in words."""
    circles = [f"({o.center[0]:g}, {o.center[1]:g}) radius {o.radius:g}" for o in scene.obstacles]
    text = f"{scene.shape}, obstacles {', '.join(circles) or 'none'}"
    for via in scene.via_points:
        options = via.options if isinstance(via, AnyOf) else (via,)
        places = [
            f"({o.position[0]:g}, {o.position[1]:g}) at phase {o.phase:g}"
            for o in options
            if isinstance(o, ViaPoint)
        ]
        text += f", via-point {' or '.join(places)}"
    if scene.goal is not None:
        text += f", end ({scene.goal[0]:g}, {scene.goal[1]:g})"
    return text + "; mm"
