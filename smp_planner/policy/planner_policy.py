"""`PlannerPolicy`: any planner as a policy with the interface of a stable-baselines3 agent.

The policy plans when an episode begins and then executes one trajectory of the plan. All it knows
of the world it reads from the observation, so it runs wherever an agent runs: behind wrappers, in
`DummyVecEnv` and `SubprocVecEnv`, in `evaluate_policy` and `EvalCallback`.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from smp_gym.arrays import checked_seed
from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.observation import DecodedObservation, decode, observation_space, space_of
from smp_planner.batch.problem_tables import checked_device
from smp_planner.library.link_meshes import jaco_meshes
from smp_planner.planners import learned_from
from smp_planner.planners.registry import Method, resolve
from smp_planner.planning.pipeline import checked_deadline
from smp_planner.planning.plan import Plan
from smp_planner.planning.problem import Planner, Problem
from smp_planner.policy.grasping import learn_grasping
from smp_planner.policy.observed_problem import checkpoint_phases, problem_from
from smp_planner.policy.policy_file import SavedPolicy, read_policy, write_policy
from smp_planner.policy.pursuit import Pursuit, highest_rate
from smp_planner.policy.replanned_execution import (
    LATENCY,
    Replanner,
    Replanning,
    begin,
    foreseen,
    pursue,
)
from smp_planner.policy.tracking import GripperEvent, Track, gripper_event

__all__ = ["Execution", "PlannerPolicy"]

Actions = NDArray[np.float32]


@dataclass(frozen=True)
class Execution:
    """State of the policy in one episode.

    Attributes:
        plan: the plan that was made.
        particle: which of its particles is executed.
        track: that particle's trajectory with its timing.
        digest: fingerprint of the observation that was planned from.
        pursuit: state of the execution, where plans are made anew; `plan`, `particle` and `track`
            are the first then.
    """

    plan: Plan
    particle: int
    track: Track
    digest: int
    pursuit: Pursuit | None = None


def _plan_options(planner: Planner, device: str | None, deadline: float | None) -> dict[str, Any]:
    """Return the arguments of `Planner.plan` beside the problems, those that are given."""
    if device is not None:
        checked_device(device)
    options = {"device": device, "deadline": checked_deadline(deadline)}
    given = {name: value for name, value in options.items() if value is not None}
    if len(given) > 1:
        raise ValueError(f"deadline must be None on a device, got {deadline} and {device!r}")
    for name, value in given.items():
        if name not in inspect.signature(planner.plan).parameters:
            raise ValueError(
                f"{name} must be None for {type(planner).__name__}, whose plan(problems) takes "
                f"none; got {value!r}"
            )
    return given


def _replanning(planner: Planner, every: int | None, latency: int) -> Replanning | None:
    """Return when plans are made anew; None if they are not."""
    # The latency is checked in any case.
    checked = Replanning(1 if every is None else every, latency)
    if every is None:
        return None
    if not (isinstance(planner, Replanner) and planner.can_replan):
        raise ValueError(
            "replan_every needs a planner that can go on from a plan, of the methods here smp and "
            f"promp; got {type(planner).__name__}"
        )
    return checked


class PlannerPolicy:
    """A policy that executes the plans of a planner.

    Its actions are joint velocities: observations of an environment that takes actions for
    something else (``control="end_effector"``) are refused.

    Args:
        planner: what plans.
        demonstrations: of the task; they teach when the hand opens or closes and, where an object
            is grasped or a stroke drawn, how.
        seed: from which, together with an episode's first observation, all randomness is drawn.
            Neither the order of calls nor what was played before matters.
        replan_every: control steps after which a plan is made anew, at the latest; it is at once
            where an obstacle is not where it was expected or the arm lags. None plans once.
        latency: control steps from asking for a plan, the first included, to its taking effect,
            whatever time planning took.
        device: on which the plans of all episodes that begin in one call of `predict` are made
            together, "cuda" or "cpu"; None plans them on the processor, each as it is planned
            alone. Plans are made anew on the processor in any case.
        deadline: s, for all plans that one call of `predict` makes for episodes that begin; actions
            then depend on the machine. None by default.

    Raises:
        ValueError: `replan_every` or `latency` is no positive whole number, there is no such
            device, `deadline` is no positive number, or the planner cannot make plans anew or does
            not take one of these.
    """

    def __init__(
        self,
        planner: Planner,
        demonstrations: Demonstrations,
        seed: int = 0,
        *,
        replan_every: int | None = None,
        latency: int = LATENCY,
        device: str | None = None,
        deadline: float | None = None,
    ) -> None:
        self.replanning = _replanning(planner, replan_every, latency)
        self._plan_options = _plan_options(planner, device, deadline)
        self.planner = planner
        self.demonstrations = demonstrations
        self.task = demonstrations.task
        self.observation_space: spaces.Dict = observation_space(self.task)
        self.action_space = spaces.Box(-1.0, 1.0, (7,), np.float32)
        self._most = highest_rate(demonstrations)
        self._event: GripperEvent | None = gripper_event(demonstrations.gripper)
        self._grasping = learn_grasping(demonstrations)
        drawing = demonstrations.scenes[0].goals[0].kind == "stroke"
        self._phases = checkpoint_phases(demonstrations) if drawing else None
        self.set_random_seed(seed)
        self._made_by: tuple[str, Mapping[str, Any]] | None = None

    @classmethod
    def make(
        cls,
        method: str,
        task: str | None = None,
        *,
        demonstrations: Demonstrations | None = None,
        settings: Mapping[str, Any] | None = None,
        seed: int = 0,
        replan_every: int | None = None,
        latency: int = LATENCY,
        device: str | None = None,
        deadline: float | None = None,
    ) -> PlannerPolicy:
        """Return a policy by the name of its method.

        Args:
            method: name of a method, or ``name=module:Class``; see
                `smp_planner.planners.registry.resolve`.
            task: whose shipped demonstrations to learn from; or give `demonstrations`.
            demonstrations: what to learn from, in place of the shipped ones.
            settings: settings of the method by name.
            seed: see the class, as the next four.
            replan_every: when plans are made anew.
            latency: when they take effect.
            device: on which the plans of episodes are made together.
            deadline: of these.

        Raises:
            ValueError: unknown method, task or setting, the message lists what exists; or see the
                class.
        """
        demonstrations = learned_from(task, demonstrations)
        options = {
            "replan_every": replan_every,
            "latency": latency,
            "device": device,
            "deadline": deadline,
        }
        return cls._of(resolve(method), demonstrations, settings or {}, seed, options)

    @classmethod
    def _of(
        cls,
        method: Method,
        demonstrations: Demonstrations,
        settings: Mapping[str, Any],
        seed: int,
        options: Mapping[str, Any],
    ) -> PlannerPolicy:
        policy = cls(method.make(demonstrations, settings), demonstrations, seed, **options)
        policy._made_by = method.spec, method.settings(demonstrations.task, settings)
        return policy

    def set_random_seed(self, seed: int | None = None) -> None:
        """Set the policy's seed; None means 0."""
        self.seed = 0 if seed is None else checked_seed(seed)

    def predict(
        self,
        observation: Mapping[str, NDArray[Any]] | NDArray[Any],
        state: Sequence[Execution | None] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[Actions, tuple[Execution, ...]]:
        """Return actions, and the state to hand back with the next observation.

        A plan is made when an observation says that nothing of its episode has elapsed, or when
        there is no state; those of environments that begin together are made in one call of the
        planner. `episode_start` does not decide: `evaluate_policy` leaves it True for environments
        that have played their share.

        Args:
            observation: one observation or a batch of E, as dict or flattened.
            state: what the last call returned, or None.
            episode_start: accepted for the interface, unused.
            deterministic: True executes the best particle, False draws one of the collision-free
                and executable ones.

        Returns:
            Actions (7,) or (E, 7), and one `Execution` per environment.

        Raises:
            ValueError: the observation is not from an environment of this task, or from one of
                another control mode, or a goal in it is out of reach.
        """
        rows, batched = self._rows(observation)
        if state is not None and len(state) != len(rows):
            raise ValueError(
                f"state must have one entry for each of {len(rows)} observations, got {len(state)}"
            )
        decoded = [self._decoded(row) for row in rows]
        executions: list[Execution | None] = [None] * len(rows) if state is None else list(state)
        digests = {
            i: self._digest(rows[i])
            for i in range(len(rows))
            if executions[i] is None or decoded[i].elapsed_steps == 0
        }
        due = [
            i
            for i, digest in digests.items()
            if executions[i] is None or executions[i].digest != digest  # type: ignore[union-attr]
        ]
        problems = [self._problem(decoded[i], digests[i]) for i in due]
        plans = self._plans(problems)
        for i, problem, plan in zip(due, problems, plans, strict=True):
            executions[i] = self._execution(plan, problem, decoded[i], deterministic)
        ready = tuple(e for e in executions if e is not None)
        moved = [self._acted(execution, row) for execution, row in zip(ready, decoded, strict=True)]
        actions = np.stack([action for _, action in moved])
        return (actions if batched else actions[0]), tuple(execution for execution, _ in moved)

    def _acted(self, execution: Execution, row: DecodedObservation) -> tuple[Execution, Actions]:
        """Return the state after one environment step, and its action (7,)."""
        if execution.pursuit is None:
            action = execution.track.action(row.elapsed_steps, row.robot.reference)
            return execution, action
        assert self.replanning is not None
        assert isinstance(self.planner, Replanner)
        pursuit, action = pursue(execution.pursuit, row, self.planner, self._event, self.replanning)
        return replace(execution, pursuit=pursuit), action

    def problem(self, observation: Mapping[str, NDArray[Any]] | NDArray[Any]) -> Problem:
        """Return the problem that one observation poses, as `predict` hands it to the planner.

        Args:
            observation: as dict or flattened, not a batch.

        Raises:
            ValueError: the observation is not from an environment of this task, from one of
                another control mode, or a batch.
        """
        rows, batched = self._rows(observation)
        if batched:
            raise ValueError(f"observation must be one, got a batch of {len(rows)}")
        return self._problem(self._decoded(rows[0]), self._digest(rows[0]))

    def plan(self, observation: Mapping[str, NDArray[Any]] | NDArray[Any]) -> Plan:
        """Return the plan for one observation, as `predict` makes it; see `problem`."""
        (plan,) = self._plans([self.problem(observation)])
        return plan

    def _plans(self, problems: Sequence[Problem]) -> list[Plan]:
        """Return the plans of the problems of episodes that begin, made in one call."""
        plans = self.planner.plan(problems, **self._plan_options) if problems else []
        beside = {
            "demonstrations": self.demonstrations.configurations,
            "meshes": partial(jaco_meshes, self._phases is not None),
        }
        return [
            plan.changed(display={"problem": problem, **beside, **plan.display})
            for plan, problem in zip(plans, problems, strict=True)
        ]

    def _problem(self, decoded: DecodedObservation, digest: int) -> Problem:
        problem = problem_from(decoded, digest, self._phases, grasping=self._grasping)
        return (
            problem if self.replanning is None else foreseen(problem, self.replanning, self._most)
        )

    def track(self, plan: Plan, particle: int, first_step: int = 0) -> Track:
        """Return the timed trajectory of one particle of a plan, as the policy would execute it.

        Args:
            plan: of this policy's planner.
            particle: index of the particle.
            first_step: environment step at which execution begins.
        """
        return Track(
            trajectory=plan.trajectories[particle],
            duration=float(plan.duration[particle]),
            event=self._event,
            first_step=first_step,
        )

    def _rows(self, observation: Any) -> tuple[list[Any], bool]:
        """Split a batch into single observations."""
        if isinstance(observation, Mapping):
            arrays = {key: np.asarray(value) for key, value in observation.items()}
            dimensions = {array.ndim for array in arrays.values()}
            if dimensions == {2} and len({len(array) for array in arrays.values()}) == 1:
                count = len(next(iter(arrays.values())))
                return [{k: a[i] for k, a in arrays.items()} for i in range(count)], True
            return [arrays], False
        array = np.asarray(observation)
        return (list(array), True) if array.ndim == 2 else ([array], False)

    def _decoded(self, row: Any) -> DecodedObservation:
        decoded = decode(row, self.task)
        if decoded.control != "joint_velocity":
            raise ValueError(
                f"the observation is from an environment with control={decoded.control!r}: a "
                "planner acts in joint velocities, make the environment with "
                "control='joint_velocity'"
            )
        return decoded

    def _digest(self, row: Any) -> int:
        """Return a fingerprint of observation and seed, the same for raw and flattened."""
        flat = spaces.flatten(space_of(row, self.task), row) if isinstance(row, Mapping) else row
        content = np.ascontiguousarray(flat, np.float32).tobytes()
        seed = self.seed.to_bytes(8, "little", signed=False)
        return int.from_bytes(hashlib.blake2b(content + seed, digest_size=8).digest(), "little")

    def _execution(
        self, plan: Plan, problem: Problem, decoded: DecodedObservation, deterministic: bool
    ) -> Execution:
        particle = plan.chosen
        if not deterministic:
            candidates = np.flatnonzero(plan.good if plan.solved else plan.collision_free)
            if len(candidates):
                particle = int(np.random.default_rng([problem.seed, 1]).choice(candidates))
        track = self.track(plan, particle, decoded.elapsed_steps)
        pursuit = None
        if self.replanning is not None:
            pursuit = begin(plan, problem, particle, decoded.elapsed_steps, self.replanning)
        return Execution(plan, particle, track, problem.seed, pursuit)

    def save(self, path: str | Path) -> None:
        """Write method, settings, demonstrations and seed to one file, without pickle.

        Raises:
            ValueError: the policy was made from a planner, not from a method.
        """
        if self._made_by is None:
            raise ValueError(
                "a policy that was given its planner cannot be saved: make it with "
                "PlannerPolicy.make(method, …)"
            )
        write_policy(Path(path), SavedPolicy(*self._made_by, self.seed, self.demonstrations))

    @classmethod
    def load(
        cls,
        path: str | Path,
        factory: Callable[..., Planner] | None = None,
        *,
        replan_every: int | None = None,
        latency: int = LATENCY,
        device: str | None = None,
        deadline: float | None = None,
    ) -> PlannerPolicy:
        """Read what `save` wrote; runs no code from the file, nor any that the file names.

        Args:
            path: of the file.
            factory: what makes the planner, where the method was given as ``name=module:Class``:
                that class.
            replan_every: see the class, as the next three; a file does not say them.
            latency: when plans take effect.
            device: on which the plans of episodes are made together.
            deadline: of these.

        Raises:
            ValueError: the file is damaged, not a policy, or of another version, its method is
                unknown here, or the user's own and `factory` is not given.
        """
        saved = read_policy(Path(path))
        if factory is not None:
            method = Method(saved.method.partition("=")[0], saved.method, factory)
        elif "=" in saved.method:
            raise ValueError(
                f"{path} is a policy of the method {saved.method!r}, whose code a file must not "
                "run: import the class and give it, PlannerPolicy.load(path, factory=Class)"
            )
        else:
            method = resolve(saved.method)
        options = {
            "replan_every": replan_every,
            "latency": latency,
            "device": device,
            "deadline": deadline,
        }
        return cls._of(method, saved.demonstrations, saved.settings, saved.seed, options)
