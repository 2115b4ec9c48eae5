"""Scene sampling: (task, version, family, difficulty, seed) -> `Scene`, solvable by construction.

A scene is drawn in four steps:

1. A *goal* is drawn, and a configuration over it is solved for.
2. A *family* of trajectories is drawn: the demonstrations carried to that goal, their mean, and
   carried demonstrations with smooth random detours. Those with detours of ordinary width are the
   *proposals*, what a primitive fitted to the demonstrations would propose; wider ones join them as
   possible *witnesses*.
3. *Obstacles* are chosen from many random candidates, so that together they block the mean and as
   many proposals as they can, while at least one member of the family keeps its clearance from all.
4. That member, checked densely against table, bin, itself, joint and velocity limits, is the
   witness: it solves the scene.

Scenes with furniture (`smp_gym.sampling.furnished`) are drawn with the same families and witnesses.
A witness is what robotics papers call a feasible reference trajectory; it is not part of the scene.

Which goals, families and obstacles belong to a task, its folder in `smp_gym.tasks` says
(``scenes``); here is the engine that tasks share. No planner and no physics engine takes part.
"""

from smp_gym.sampling.scenes import (
    place_without_witness,
    sample_scene,
    sample_with_witness,
)
from smp_gym.sampling.specification import CROWDED, SPECIFICATIONS, DifficultySpecification

__all__ = [
    "CROWDED",
    "SPECIFICATIONS",
    "DifficultySpecification",
    "place_without_witness",
    "sample_scene",
    "sample_with_witness",
]
