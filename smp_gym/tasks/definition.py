"""Task definitions: the entry of a task in the registry, and the protocol of its rules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from smp_gym.arrays import AnyFloatArray, BoolArray

if TYPE_CHECKING:
    from smp_gym.datasets.demonstrations import Demonstrations
    from smp_gym.sampling.draws import SceneSampler
    from smp_gym.scene import GoalKind, Scene
    from smp_gym.tasks.goals import GoalCodec
    from smp_gym.tasks.performance import Report
    from smp_gym.tasks.status import Status

__all__ = ["Task", "TaskDefinition"]


@dataclass(frozen=True)
class TaskDefinition:
    """A task as the registry knows it; its parts are imported from its package when asked for.

    Attributes:
        name: as it stands in the environment ids.
        package: dotted name of the package that holds ``rules``, ``scenes`` and ``demonstrator``.
        version: of its dynamics, rewards and scenes; part of the ids and of what determines a
            scene.
        goal_kinds: kinds of goals that this task brings, beside those of `smp_gym.scene`.
    """

    name: str
    package: str
    version: int = 0
    goal_kinds: tuple[GoalKind, ...] = ()

    @property
    def rules(self) -> Task:
        """``RULES`` of ``rules``: goals, success, reward terms, contacts."""
        rules: Task = self._part("rules", "RULES")
        return rules

    @property
    def sampler(self) -> SceneSampler:
        """``SAMPLER`` of ``scenes``."""
        sampler: SceneSampler = self._part("scenes", "SAMPLER")
        return sampler

    @property
    def demonstrate(self) -> Callable[[Report], Demonstrations]:
        """``demonstrate`` of ``demonstrator``: executes and records the task's demonstrations."""
        demonstrate: Callable[[Report], Demonstrations] = self._part("demonstrator", "demonstrate")
        return demonstrate

    def _part(self, module: str, name: str) -> Any:
        return getattr(import_module(f"{self.package}.{module}"), name)


class Task(Protocol):
    """The rules of a task: what the environment asks after every step.

    Goal vectors (..., G) are laid out as `goals` says.
    """

    @property
    def name(self) -> str:
        """Name, one of `smp_gym.tasks.task_names`."""
        ...

    @property
    def goals(self) -> GoalCodec:
        """Fields of the goal vectors, and how the goals of a scene stand in them."""
        ...

    @property
    def object_in_hand(self) -> AnyFloatArray:
        """(4, 4) pose of object or pen's tip in the end-effector frame once the hand holds it."""
        ...

    def check_scene(self, scene: Scene) -> None:
        """Raise ValueError if an episode of this task cannot be played in the scene."""
        ...

    def supports(self, scene: Scene) -> tuple[tuple[float, float, float], ...]:
        """Return the places (`Goal.position`, m) of the bodies that the object may be set down on.

        There are at most `smp_gym.observation.MAX_SUPPORTS`.
        """
        ...

    def permitted_contacts(self, held: bool) -> frozenset[tuple[str, str]]:
        """Return the pairs of groups that may touch, names in alphabetical order.

        The groups are ``arm`` (base and links 1 to 5), ``hand`` (palm and fingers), ``object``,
        ``obstacle``, ``table``, ``bin`` and ``pad``. Any other contact is a collision.

        Args:
            held: whether the hand grips the object.
        """
        ...

    def achieved_goal(self, status: Status) -> dict[str, Any]:
        """Return the values of the achieved goal by field name."""
        ...

    def failure(self, status: Status) -> str:
        """Return the cause for which the episode can no longer succeed, or an empty string."""
        ...

    def success(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return whether goals (..., G) are reached, (...)."""
        ...

    def collided(self, achieved: AnyFloatArray) -> BoolArray:
        """Return whether goals (..., G) tell of a collision, (...)."""
        ...

    def lost(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> BoolArray:
        """Return whether goals (..., G) tell of an episode that is over without success, (...).

        It may depend on the desired goal for the verdict only, not for the moment: an episode that
        ends here with one desired goal must end with any, as success or as failure. So hindsight
        relabelling, which keeps the ends of episodes, stays exact.
        """
        ...

    def demands_all(self, desired: AnyFloatArray) -> BoolArray:
        """Return whether desired goals (..., G) demand all that those of an episode do, (...).

        Hindsight replaces them by achieved ones, some of which are subgoals: there is more to do.
        """
        ...

    def potential(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> AnyFloatArray:
        """Return the potential (...) whose differences make up the dense reward."""
        ...

    def details(self, achieved: AnyFloatArray, desired: AnyFloatArray) -> dict[str, Any]:
        """Return further results that goals (G,) hold, for the step's info."""
        ...
