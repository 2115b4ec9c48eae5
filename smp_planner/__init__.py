"""Movement primitives adapted to new scenes by Stein variational gradient descent.

The front door: `SMP` learns from the user's demonstrations and plans without an environment,
`PlannerPolicy` plans and acts in the environments of `smp_gym`, `make_planner` gives the planner
inside. What is named here is loaded at its first use.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from smp_gym.optional_packages import require

if TYPE_CHECKING:
    from smp_planner.library.height_map import height_map_obstacles
    from smp_planner.library.mesh_obstacles import mesh_obstacles
    from smp_planner.library.planning_scene import PlanningScene
    from smp_planner.library.smp import (
        SMP,
        AdaptSettings,
        AnyOf,
        Box,
        Circle,
        Cone,
        GoalRegion,
        Orientation,
        Plan,
        PointCloud,
        PriorSettings,
        Rectangle,
        Robot,
        ToolViaPoint,
        ViaPoint,
    )
    from smp_planner.library.solids import capsule_obstacles, cone_obstacles
    from smp_planner.planners import make_planner
    from smp_planner.policy.planner_policy import PlannerPolicy

__all__ = [
    "SMP",
    "AdaptSettings",
    "AnyOf",
    "Box",
    "Circle",
    "Cone",
    "GoalRegion",
    "Orientation",
    "Plan",
    "PlannerPolicy",
    "PlanningScene",
    "PointCloud",
    "PriorSettings",
    "Rectangle",
    "Robot",
    "ToolViaPoint",
    "ViaPoint",
    "__version__",
    "capsule_obstacles",
    "cone_obstacles",
    "height_map_obstacles",
    "make_planner",
    "mesh_obstacles",
]

try:
    __version__ = version("smp-gym")
except PackageNotFoundError:  # A checkout on the path that is not installed.
    __version__ = "unknown"

require("planner", "smp_planner")

_HOMES = {
    "PlannerPolicy": "smp_planner.policy.planner_policy",
    "PlanningScene": "smp_planner.library.planning_scene",
    "capsule_obstacles": "smp_planner.library.solids",
    "cone_obstacles": "smp_planner.library.solids",
    "height_map_obstacles": "smp_planner.library.height_map",
    "make_planner": "smp_planner.planners",
    "mesh_obstacles": "smp_planner.library.mesh_obstacles",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES.get(name, "smp_planner.library.smp")), name)
