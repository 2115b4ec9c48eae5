"""ReachPoint: bring the pen's tip to a point in the air. A task outside of the package."""

from smp_gym.scene import GoalKind
from smp_gym.tasks import TaskDefinition

TASK = TaskDefinition("ReachPoint", package=__name__, version=3, goal_kinds=(GoalKind("point"),))
