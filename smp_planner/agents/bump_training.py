"""Training of `mp_rl` and its kin: contextual policy search in the space of a movement primitive.

An action is an episode's whole trajectory (Kober, Oztop and Peters 2011; Otto et al. 2022, "Deep
Black-Box Reinforcement Learning with Movement Primitives"): bumps on the conditioned mean. In every
iteration a batch of scenes is drawn, 16 actions are drawn in each, and the policy follows the
clipped gradient of Schulman et al. 2017 (Eq. (7)). The planner executes the best of what is
proposed, so the advantage of an action can be what it adds to the best of several (`advantages`),
and the policy can have several heads, which learn to be different. The reward is that of the
planners' check, or, of `mp_rl_physics`, that of an episode in the physics, see
`smp_planner.agents.trajectory_rewards`.

To descend the costs that `smp` descends first, whose derivative by an action is known, comes to
clear trajectories in a tenth of the time, but of training scenes alone: of 20 others the agent then
solved 1, and without it 7. So there is no such beginning.

A sampler's scene takes longer to draw than hundreds of trajectories to check, so each is met many
times, but never twice the same: obstacles are shifted, and in a share of the visits they are those
of another scene. The folder that a training writes holds

- ``run.json``: agent, task, difficulties, seed and settings;
- ``scenes.jsonl``: the training scenes, with the CPU seconds that drawing them took;
- ``curve.csv``: rewards, CPU seconds and trajectories so far;
- ``checkpoint.pt``: what it takes to go on exactly after an interruption;
- ``agent.json`` and ``agent.safetensors``: the agent, see `smp_planner.planners.agent_file`.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from pydantic import Field, model_validator
from scipy.special import comb

from smp_gym.arrays import FloatArray, IntArray
from smp_gym.atomic_files import write_text
from smp_gym.sampling import place_without_witness, sample_scene
from smp_gym.scene import Scene
from smp_planner.agents.posed_scenes import posed, primitive_of
from smp_planner.agents.training_folder import (
    claimed,
    named_settings,
    read_checkpoint,
    write_checkpoint,
)
from smp_planner.agents.trajectory_rewards import PosedScene, RewardName, make_rewards
from smp_planner.benchmark.results_folder import write_table
from smp_planner.planners.agent_file import AgentCard, write_agent
from smp_planner.planners.bump_policy import (
    ActionDistribution,
    BumpPolicy,
    Looks,
    NetworkShape,
    hand_paths,
    look,
    rows_of,
    stacked,
)
from smp_planner.planning.bumps import (
    BumpedMean,
    bump_phases,
    bumped_mean,
    moved,
    scale_of,
)
from smp_planner.planning.problem import Problem
from smp_planner.strict_settings import StrictSettings
from smp_planner.torch_threads import one_thread

__all__ = ["BumpSettings", "BumpTraining", "CurvePoint", "advantages", "clipped_loss"]

FIRST_SEED = 40_000
"""Tuning seed of the first training scene of a training with seed 0."""

_SEEDS = 5_000
"""Seeds between the first scenes of two trainings."""


class BumpSettings(StrictSettings):
    """Settings of a training.

    Attributes:
        bumps: on the mean of each joint.
        heads: Gaussians of the policy for each component of the prior.
        best_of: number of proposals whose best counts, see `advantages`.
        scenes: training scenes with a reference trajectory, as the environments draw them.
        placed: further ones, placed without (`smp_gym.sampling.place_without_witness`).
        batch: scenes of an iteration.
        rollouts: actions in each.
        epochs: steps of the gradient for each batch.
        clip: ε of the clipped gradient.
        learning_rate: of Adam, in the beginning.
        annealing: iterations in which it falls to a tenth, along half a cosine; 0 if it stays.
        std: rad, standard deviation of actions in the beginning.
        shift: m, standard deviation of the shift of obstacles from visit to visit.
        exchanged: share of the visits with the obstacles of another scene.
        reward: "check" is that of the planners' exact check: clearance, and 1 more if nothing is
            found; "physics" that of an episode with the trajectory: 1 for success, and the share of
            its way that was done.
    """

    bumps: int = Field(default=4, ge=1, le=50)
    heads: int = Field(default=1, ge=1, le=100)
    best_of: int = Field(default=1, ge=1)
    scenes: int = Field(default=240, ge=1)
    placed: int = Field(default=0, ge=0)
    batch: int = Field(default=48, ge=1)
    rollouts: int = Field(default=16, ge=2)
    epochs: int = Field(default=6, ge=1)
    clip: float = Field(default=0.2, gt=0.0, lt=1.0)
    learning_rate: float = Field(default=3e-3, gt=0.0, allow_inf_nan=False)
    annealing: int = Field(default=0, ge=0)
    std: float = Field(default=0.2, gt=0.0, allow_inf_nan=False)
    shift: float = Field(default=0.015, ge=0.0, allow_inf_nan=False)
    exchanged: float = Field(default=0.3, ge=0.0, le=1.0)
    reward: RewardName = "check"

    @model_validator(mode="after")
    def _enough(self) -> BumpSettings:
        if self.best_of > self.rollouts:
            raise ValueError(
                f"best_of must be at most rollouts, {self.rollouts}, got {self.best_of}"
            )
        return self

    def rate(self, iteration: int) -> float:
        """Return the learning rate of an iteration."""
        if not self.annealing:
            return self.learning_rate
        share = min(iteration / self.annealing, 1.0)
        return self.learning_rate * (0.1 + 0.45 * (1.0 + math.cos(math.pi * share)))

    @classmethod
    def from_json(cls, path: Path, agent: str, task: str) -> BumpSettings:
        """Read settings: those of ``"*"`` in a JSON file, a task's, and an agent's.

        Raises:
            OSError: there is no such file.
            ValueError: it is not JSON, or a setting is unknown or out of range.
        """
        return cls.model_validate(named_settings(path, "*", task, agent))


@dataclass(frozen=True)
class CurvePoint:
    """A row of ``curve.csv``.

    Attributes:
        iteration: number of batches so far.
        trajectories: that were checked, or executed, so far.
        cpu_seconds: of the training so far, the drawing of scenes included.
        reward: mean of the batches since the last row.
        clear: share of their trajectories that met every demand, or succeeded in the physics.
        scenes_solved: share of their scenes with such a trajectory.
    """

    iteration: int
    trajectories: int
    cpu_seconds: float
    reward: float
    clear: float
    scenes_solved: float


class _Place(NamedTuple):
    """A training scene, ready to be met: the mean of each component, and what is fixed in it."""

    known: PosedScene
    means: FloatArray
    directions: FloatArray
    context: Any
    hand: FloatArray

    def trajectories(self, component: IntArray, numbers: FloatArray) -> FloatArray:
        """Return the trajectories (N, T, 6) rad of numbers (N, F) on the means of components."""
        paths = np.empty((len(numbers), *self.means.shape[1:]))
        for side in np.unique(component):
            chosen = component == side
            paths[chosen] = moved(self.means[side], self.directions[side], numbers[chosen])
        return paths


def advantages(reward: FloatArray, best_of: int = 1) -> FloatArray:
    """Return the advantages (B, N) of N actions in each scene, scaled to a root mean square of 1.

    With 1, the reward less its mean in the scene. With k > 1, what an action adds to the greatest
    reward of k proposals: the mean over all choices of k of the N that hold it, of their greatest
    reward less that of the k - 1 others. It is above 0 for what is the best of some choice, and so
    its gradient is that of the expected greatest reward (Walder & Karkhanis 2025, "Pass@K Policy
    Optimization"): what is good alone in its scene counts most, and what all do counts nothing.

    Args:
        reward: (B, N).
        best_of: k, at most N.
    """
    if best_of == 1:
        found = reward - reward.mean(axis=1, keepdims=True)
    else:
        order = reward.argsort(axis=1)
        ascending = np.take_along_axis(reward, order, axis=1)
        count = reward.shape[1]
        # Choices whose second best is the j-th of the ascending order, of those that hold another.
        second = comb(np.arange(count), best_of - 2) / comb(count - 1, best_of - 1)
        gain = ascending * np.cumsum(second) - np.cumsum(second * ascending, axis=1)
        found = np.empty_like(reward)
        np.put_along_axis(found, order, gain, axis=1)
    return np.asarray(found / (np.sqrt(np.square(found).mean()) + 1e-6))


def clipped_loss(
    found: ActionDistribution,
    gaussian: torch.Tensor,
    action: torch.Tensor,
    before: torch.Tensor,
    advantage: torch.Tensor,
    clip: float,
) -> torch.Tensor:
    """Return the clipped surrogate (Schulman et al. 2017, Eq. (7)), to be minimised.

    Args:
        found: the present distribution in B scenes.
        gaussian: (B, N) of the actions that were drawn.
        action: (B, N, F).
        before: (B, N) log-density with which they were drawn.
        advantage: (B, N).
        clip: ε.
    """
    ratio = (found.log_prob(gaussian, action) - before).exp()
    return -torch.minimum(ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage).mean()


class BumpTraining:
    """One training, in a folder; starting it again goes on exactly from the last checkpoint.

    Nobody else can train in the folder until `close`, or until the process ends.

    Args:
        folder: to write.
        agent: one of `smp_planner.planners.bump_planner.LEARNED`.
        task: one of `smp_gym.scene.TASKS`.
        difficulties: of the scenes, in turn.
        seed: of scenes, weights and actions.
        settings: see `BumpSettings`.

    Raises:
        ValueError: the folder holds another training.
        OSError: somebody else trains there (`FolderInUseError`), or it cannot be written to.
    """

    def __init__(
        self,
        folder: Path,
        *,
        agent: str,
        task: str,
        difficulties: Sequence[str],
        seed: int,
        settings: BumpSettings,
    ) -> None:
        self._folder, self._agent, self._task, self._seed = folder, agent, task, seed
        self._difficulties, self._settings = tuple(difficulties), settings
        description = {
            "agent": agent,
            "task": task,
            "difficulties": list(difficulties),
            "seed": seed,
            "settings": settings.model_dump(),
        }
        self._lock = claimed(folder, description)
        self._planner = primitive_of(task)
        self._components = self._planner.prior.components()
        self._rewards = make_rewards(settings.reward, task)
        torch.manual_seed(seed)
        actions = settings.bumps * self._planner.prior.single.dimension
        shape = NetworkShape(
            actions, len(self._components), agent != "detour", heads=settings.heads
        )
        self.policy = BumpPolicy(shape, settings.std)
        self._optimiser = torch.optim.Adam(self.policy.parameters(), settings.learning_rate)
        self.iteration, self.trajectories, self.cpu_seconds = 0, 0, 0.0
        self.curve: list[CurvePoint] = []
        self._scenes: list[Scene] = []
        self._places: list[_Place] = []
        self._restore()

    def close(self) -> None:
        """Let others train in the folder."""
        self._lock.close()

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """The training scenes, once they are drawn."""
        return tuple(self._scenes)

    def mean_trajectory(self, problem: Problem) -> FloatArray:
        """Return the trajectory (200, 6) rad of the likeliest component's mean action.

        Raises:
            ValueError: a component does not reach the goal.
        """
        means = self._means(problem)
        if means is None:
            raise ValueError("problem must have a goal within reach of all components")
        with torch.no_grad():
            found = self.policy(stacked([look(means, problem.movable)]))
            likeliest = found.choice[0].argmax().numpy()
            numbers = (found.mean[0, likeliest] * self.policy.scale).numpy().astype(np.float64)
        side = int(self.policy.shape.component_of(likeliest))
        return np.asarray(means[side].trajectories(numbers[None])[0])

    def _means(self, problem: Problem) -> list[BumpedMean] | None:
        """Return the conditioned mean of each component; None where one is out of reach."""
        phases, plans = bump_phases(self._settings.bumps), self._planner.plan_settings
        means = [bumped_mean(each, problem, plans, phases) for each in self._components]
        reached = [each for each in means if each is not None]
        return reached if len(reached) == len(means) else None

    def prepare(self, progress: Callable[[int, int], None] = lambda done, total: None) -> None:
        """Draw the training scenes that the folder does not hold, and pose all of them.

        Args:
            progress: called with the number of scenes that are drawn and of all.
        """
        path = self._folder / "scenes.jsonl"
        lines = path.read_text().splitlines() if path.exists() else []
        first, drawn = FIRST_SEED + _SEEDS * self._seed, self._settings.scenes
        wanted = drawn + self._settings.placed
        for number in range(len(lines), wanted):
            begin = time.process_time()
            difficulty = self._difficulties[number % len(self._difficulties)]
            draw = sample_scene if number < drawn else place_without_witness
            scene = draw(self._task, difficulty, first + number)
            seconds = time.process_time() - begin
            lines.append(json.dumps({"cpu": seconds, "scene": scene.to_json()}))
            progress(number + 1, wanted)
            if (number + 1) % 20 == 0 or number + 1 == wanted:
                write_text(path, "\n".join(lines) + "\n")
        entries = [json.loads(line) for line in lines[:wanted]]
        self._scenes = [Scene.from_json(entry["scene"]) for entry in entries]
        begin = time.process_time()
        self._pose()
        if self.iteration == 0:
            spent = sum(entry["cpu"] for entry in entries)
            self.cpu_seconds = spent + time.process_time() - begin

    def _pose(self) -> None:
        # A goal beyond the reach of one side would need another shape.
        found = [
            (PosedScene(scene, problem), means)
            for scene, problem in zip(self._scenes, posed(self._scenes), strict=True)
            if (means := self._means(problem))
        ]
        if self.iteration == 0:
            scale = scale_of([each for _, means in found for each in means])
            self.policy.scale.copy_(torch.from_numpy(scale))
        self._places = [self._place(known, means) for known, means in found]

    def _place(self, known: PosedScene, means: Sequence[BumpedMean]) -> _Place:
        coarse = [each.resampled(self._rewards.samples) for each in means]
        return _Place(
            known,
            np.stack([each.mean for each in coarse]),
            np.stack([each.directions for each in coarse]),
            look(means, ())[0],
            hand_paths(means),
        )

    def run(
        self,
        iterations: int,
        *,
        every: int = 20,
        progress: Callable[[int, float], None] = lambda done, solved: None,
    ) -> None:
        """Train up to a number of iterations in all, and write the agent.

        Args:
            iterations: those before an interruption included.
            every: iterations from one row of the curve, and checkpoint, to the next.
            progress: called with the iterations so far and the last share of clear trajectories.
        """
        if not self._places:
            self.prepare()
        recent: list[FloatArray] = []
        with one_thread():
            while self.iteration < iterations:
                begin = time.process_time()
                recent.append(self._iterate())
                self.iteration += 1
                self.cpu_seconds += time.process_time() - begin
                progress(self.iteration, float(recent[-1][1]))
                if self.iteration % every == 0 or self.iteration == iterations:
                    mean = np.mean(recent, axis=0).tolist()
                    self.curve.append(
                        CurvePoint(self.iteration, self.trajectories, self.cpu_seconds, *mean)
                    )
                    recent = []
                    self._keep()
        # The last checkpoint may be there without it.
        self._write_curve()
        write_agent(self._folder / "agent.json", self.policy, self.card({}))

    def card(self, scores: dict[str, Any]) -> AgentCard:
        """Return the card of the agent as it is now.

        Args:
            scores: what is known of its success.
        """
        return AgentCard(
            agent=self._agent,
            task=self._task,
            bumps=self._settings.bumps,
            network=asdict(self.policy.shape),
            training={
                "difficulties": list(self._difficulties),
                "seed": self._seed,
                "first_scene": FIRST_SEED + _SEEDS * self._seed,
                "settings": self._settings.model_dump(),
                "iterations": self.iteration,
                "trajectories": self.trajectories,
                "cpu_seconds": round(self.cpu_seconds, 1),
            },
            scores=scores,
        )

    def _visit(self, rng: np.random.Generator) -> tuple[_Place, PosedScene, Any]:
        """Return a training scene, what it is as it is met now, and what the network sees."""
        place = self._places[rng.integers(len(self._places))]
        origin = place
        if rng.random() < self._settings.exchanged:
            origin = self._places[rng.integers(len(self._places))]
        movable = origin.known.problem.movable
        shift = self._settings.shift * rng.standard_normal((len(movable), 3)) * (1.0, 1.0, 0.0)
        obstacles = tuple(
            o.model_copy(update={"position": tuple((np.array(o.position) + by).tolist())})
            for o, by in zip(movable, shift, strict=True)
        )
        met = self._rewards.met(place.known, obstacles)
        return place, met, (place.context, rows_of(place.hand, met.problem.movable))

    def _step(self, loss: torch.Tensor) -> None:
        self._optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.policy.parameters(), 1.0)
        self._optimiser.step()

    def _iterate(self) -> FloatArray:
        """Learn from one batch; return its mean reward, shares of clear trajectories and scenes."""
        settings, policy = self._settings, self.policy
        for group in self._optimiser.param_groups:
            group["lr"] = settings.rate(self.iteration)
        rng = np.random.default_rng([self._seed, 1, self.iteration])
        generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
        visits = [self._visit(rng) for _ in range(settings.batch)]
        looks: Looks = stacked([seen for _, _, seen in visits])
        with torch.no_grad():
            drawn = policy(looks)
            gaussian, action = drawn.sample(settings.rollouts, generator)
            before = drawn.log_prob(gaussian, action)
        component = policy.shape.component_of(gaussian.numpy())
        numbers = (action * policy.scale).numpy().astype(np.float64)
        reward, clear = np.empty((2, settings.batch, settings.rollouts))
        for index, (place, met, _) in enumerate(visits):
            paths = place.trajectories(component[index], numbers[index])
            reward[index], clear[index] = self._rewards.of(met, paths)
        advantage = torch.from_numpy(advantages(reward, settings.best_of).astype(np.float32))
        for _ in range(settings.epochs):
            loss = clipped_loss(policy(looks), gaussian, action, before, advantage, settings.clip)
            self._step(loss)
        self.trajectories += reward.size
        return np.array([reward.mean(), clear.mean(), clear.any(axis=1).mean()])

    def _keep(self) -> None:
        """Write curve and checkpoint."""
        content = {
            "policy": self.policy.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "iteration": self.iteration,
            "trajectories": self.trajectories,
            "cpu_seconds": self.cpu_seconds,
            "curve": [asdict(point) for point in self.curve],
        }
        write_checkpoint(self._folder, content)
        self._write_curve()

    def _write_curve(self) -> None:
        names = list(CurvePoint.__dataclass_fields__)
        rows = [[getattr(point, name) for name in names] for point in self.curve]
        write_table(self._folder / "curve.csv", names, rows)

    def _restore(self) -> None:
        content = read_checkpoint(self._folder)
        if content is None:
            return
        self.policy.load_state_dict(content["policy"])
        self._optimiser.load_state_dict(content["optimiser"])
        self.iteration, self.trajectories = content["iteration"], content["trajectories"]
        self.cpu_seconds = content["cpu_seconds"]
        self.curve = [CurvePoint(**point) for point in content["curve"]]
