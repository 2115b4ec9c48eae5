"""Train a reinforcement-learning agent on a task: stable-baselines3's SAC, as a rule with HER.

The hyper-parameters are data, a JSON file per environment id in `envs_assets/agents/`:
``environments`` (how many are stepped in turn), ``observations`` (which entries of the observation
the agent sees, or null for all), ``sac`` (arguments of `stable_baselines3.SAC`) and ``her``
(arguments of `HerReplayBuffer`, or null to train on the goals as they are).

The folder that is written holds

- ``run.json``: task, difficulty, seed and hyper-parameters;
- ``evaluations.csv``: success on the same tuning episodes again and again, with Wilson intervals;
- ``learning_curve.png``: that as a figure;
- ``agent.zip``: the agent that did best on the tuning episodes, for `SAC.load`;
- ``result.json``: how it does on episodes that neither training nor the choice of it has seen;
- ``checkpoint/``: what it takes to go on after an interruption, or with more steps; large.
  stable-baselines3 pickles: go on only in folders of your own.
"""

from __future__ import annotations

import csv
import json
import shutil
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, astuple, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import torch
import typer
from gymnasium.wrappers import FilterObservation
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

import smp_gym  # noqa: F401  (registers the environments)
from smp_gym.assets import asset_path
from smp_gym.observation import MAX_EPISODE_STEPS, observation_space
from smp_gym.scene import DIFFICULTIES, EVALUATION_SEEDS_START, TASKS
from smp_planner.benchmark.summary import rate_interval

_CHECKPOINT, _CHECKPOINT_NEW = "checkpoint", "checkpoint.new"
_MODEL, _REPLAY_BUFFER = "model.zip", "replay_buffer.pkl"
_REPLAY_ARGUMENTS = ["replay_buffer_class", "replay_buffer_kwargs"]
_INTERRUPTED = 130


@dataclass(frozen=True)
class Settings:
    """Hyper-parameters of one agent.

    Attributes:
        environments: stepped in turn, in this process.
        observations: entries of the observation that the agent sees; None for all. Where there are
            no obstacles, leaving out their rows of zeros makes learning faster.
        sac: arguments of `stable_baselines3.SAC`.
        her: arguments of `stable_baselines3.HerReplayBuffer`; None for none.
    """

    environments: int
    observations: list[str] | None
    sac: dict[str, Any]
    her: dict[str, Any] | None

    @classmethod
    def from_json(cls, path: Path) -> Settings:
        """Read hyper-parameters.

        Raises:
            ValueError: the file is not JSON, or its entries are not those of this class.
        """
        try:
            entries = json.loads(path.read_text())
        except json.JSONDecodeError as error:
            raise ValueError(f"{path} must be JSON: {error}") from None
        names = [field.name for field in fields(cls)]
        if not isinstance(entries, dict) or set(entries) != set(names):
            found = sorted(entries) if isinstance(entries, dict) else type(entries).__name__
            raise ValueError(f"{path} must have the entries {', '.join(names)}; got {found}")
        settings = cls(**entries)
        if not (isinstance(settings.environments, int) and settings.environments >= 1):
            raise ValueError(
                f"environments in {path} must be at least 1, got {settings.environments!r}"
            )
        known = list(observation_space(TASKS[0]))
        if settings.observations is not None and not (
            isinstance(settings.observations, list)
            and settings.observations
            and set(settings.observations) <= set(known)
        ):
            raise ValueError(
                f"observations in {path} must be null or of {', '.join(known)}; "
                f"got {settings.observations!r}"
            )
        if settings.her is not None:
            needed = settings.environments * MAX_EPISODE_STEPS
            if settings.sac.get("learning_starts", 0) < needed:
                raise ValueError(
                    f"sac.learning_starts in {path} must be at least {needed}, for HER samples "
                    f"from whole episodes; got {settings.sac.get('learning_starts', 0)}"
                )
        return settings


@dataclass(frozen=True)
class Evaluation:
    """Success on a list of episodes, acting deterministically; a row of ``evaluations.csv``.

    Attributes:
        steps: environment steps trained.
        episodes: how many were played.
        successes: how many of them succeeded.
        rate: of success.
        low: lower end of its Wilson interval.
        high: upper end.
        collisions: how many ended in a collision.
        mean_steps: mean length of the episodes, environment steps.
    """

    steps: int
    episodes: int
    successes: int
    rate: float
    low: float
    high: float
    collisions: int
    mean_steps: float

    @classmethod
    def from_row(cls, row: Mapping[str, str]) -> Evaluation:
        """Parse a row of ``evaluations.csv``."""
        kinds = {"int": int, "float": float}
        return cls(**{field.name: kinds[str(field.type)](row[field.name]) for field in fields(cls)})


def environment_id(task: str, *, dense: bool) -> str:
    """Return the Gymnasium id of a task with the sparse or the dense reward."""
    return f"smp_gym/{task}{'Dense' if dense else ''}-v0"


def _only(env: gymnasium.Env[Any, Any], observations: list[str] | None) -> gymnasium.Env[Any, Any]:
    return FilterObservation(env, observations) if observations else env


def evaluate(model: SAC, env: gymnasium.Env[Any, Any], seeds: range) -> Evaluation:
    """Play the episodes of some seeds."""
    successes = collisions = steps = 0
    for seed in seeds:
        observation, info = env.reset(seed=seed)
        over = False
        while not over:
            action, _ = model.predict(observation, deterministic=True)
            observation, _, terminated, truncated, info = env.step(action)
            steps += 1
            over = terminated or truncated
        successes += info["is_success"]
        collisions += info["collided"]
    rate = rate_interval(successes, len(seeds))
    return Evaluation(
        steps=model.num_timesteps,
        episodes=len(seeds),
        successes=successes,
        rate=rate["value"],
        low=rate["low"],
        high=rate["high"],
        collisions=collisions,
        mean_steps=steps / len(seeds),
    )


def read_evaluations(path: Path) -> list[Evaluation]:
    """Return the rows of a file of evaluations; none if there is no file."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return [Evaluation.from_row(row) for row in csv.DictReader(file)]


def write_evaluations(path: Path, evaluations: list[Evaluation]) -> None:
    """Write evaluations as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(field.name for field in fields(Evaluation))
        writer.writerows(astuple(evaluation) for evaluation in evaluations)


def draw_curve(path: Path, evaluations: list[Evaluation], title: str) -> None:
    """Draw the rate of success over the steps trained, its interval as a band."""
    figure = Figure(figsize=(6.4, 4.0), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    steps = [evaluation.steps / 1000 for evaluation in evaluations]
    low, high = ([getattr(e, end) for e in evaluations] for end in ("low", "high"))
    axes.fill_between(steps, low, high, color="#7fa3ee", alpha=0.35, lw=0, label="95 % interval")
    axes.plot(steps, [e.rate for e in evaluations], color="#2b4c9b", label="success")
    collisions = [e.collisions / e.episodes for e in evaluations]
    axes.plot(steps, collisions, color="#d97706", lw=1, ls="--", label="collision")
    axes.set(xlabel="environment steps / 1000", ylabel="share of episodes", title=title)
    axes.set_ylim(-0.02, 1.02)
    axes.set_xlim(left=0)
    axes.grid(color="#dcd8cf", lw=0.6)
    axes.legend(frameon=False)
    figure.savefig(path)


def make_model(env: VecEnv, settings: Settings, seed: int) -> SAC:
    """Return an untrained agent.

    Raises:
        ValueError: SAC knows no argument of such a name.
    """
    arguments: dict[str, Any] = dict(settings.sac)
    if settings.her is not None:
        arguments["replay_buffer_class"] = HerReplayBuffer
        arguments["replay_buffer_kwargs"] = settings.her
    try:
        return SAC("MultiInputPolicy", env, seed=seed, device="cpu", **arguments)
    except TypeError as error:
        raise ValueError(f"the hyper-parameters do not fit: {error}") from None


def save_checkpoint(model: SAC, folder: Path) -> None:
    """Write agent and replay buffer, so that an interruption leaves the last ones or these."""
    new, old = folder / _CHECKPOINT_NEW, folder / _CHECKPOINT
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    model.save(new / _MODEL)
    model.save_replay_buffer(new / _REPLAY_BUFFER)
    shutil.rmtree(old, ignore_errors=True)
    new.rename(old)


def load_checkpoint(folder: Path, env: VecEnv) -> SAC | None:
    """Return the agent of the checkpoint with its replay buffer, or None if there is none."""
    checkpoint = folder / _CHECKPOINT
    if not checkpoint.exists():
        return None
    model = SAC.load(checkpoint / _MODEL, env=env, device="cpu")
    with warnings.catch_warnings():
        # The episodes that were under way are cut: what they lacked is never known.
        warnings.filterwarnings("ignore", message=".*trajectory")
        model.load_replay_buffer(checkpoint / _REPLAY_BUFFER, truncate_last_traj=True)
    return model


class Periodically(BaseCallback):
    """Calls a function with the agent after every so many steps, another after each of them."""

    def __init__(
        self, period: int, function: Callable[[SAC], None], each: Callable[[int], None]
    ) -> None:
        super().__init__()
        self._period, self._function, self._each = period, function, each

    def _on_training_start(self) -> None:
        self._next = (self.num_timesteps // self._period + 1) * self._period

    def _on_step(self) -> bool:
        self._each(self.num_timesteps)
        if self.num_timesteps >= self._next:
            self._next += self._period
            assert isinstance(self.model, SAC)
            self._function(self.model)
        return True


class Training:
    """One training, in a folder; starting it again goes on from the last checkpoint.

    Args:
        folder: to write.
        task: one of `smp_gym.scene.TASKS`.
        difficulty: one of `smp_gym.scene.DIFFICULTIES`.
        dense: train on the dense reward.
        seed: of weights, exploration and training episodes.
        settings: hyper-parameters.

    Raises:
        ValueError: the folder holds another training, or the hyper-parameters do not fit.
    """

    def __init__(
        self,
        folder: Path,
        *,
        task: str,
        difficulty: str,
        dense: bool,
        seed: int,
        settings: Settings,
    ) -> None:
        self._folder = folder
        self._id = environment_id(task, dense=dense)
        self._title = f"{self._id}, difficulty {difficulty}"
        self._claim_folder(
            {
                "environment": self._id,
                "difficulty": difficulty,
                "seed": seed,
                "settings": asdict(settings),
            }
        )
        view = partial(_only, observations=settings.observations)
        self._test_env = view(gymnasium.make(self._id, difficulty=difficulty))
        env = make_vec_env(
            self._id,
            n_envs=settings.environments,
            env_kwargs={"difficulty": difficulty},
            wrapper_class=view,
        )
        self.model = load_checkpoint(folder, env) or make_model(env, settings, seed)
        # After a restart other episodes than those that came first.
        env.seed(seed + self.model.num_timesteps)
        self.evaluations = [
            evaluation
            for evaluation in read_evaluations(folder / "evaluations.csv")
            if evaluation.steps <= self.model.num_timesteps
        ]

    def _claim_folder(self, run: dict[str, Any]) -> None:
        path = self._folder / "run.json"
        if path.exists():
            if json.loads(path.read_text()) != run:
                raise ValueError(f"{self._folder} holds another training, see {path}")
        else:
            self._folder.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(run, indent=2) + "\n")

    def run(
        self, steps: int, *, every: int, episodes: int, progress: Callable[[int, float], None]
    ) -> None:
        """Train up to a number of environment steps in all.

        Args:
            steps: environment steps, those before an interruption included.
            every: steps from one evaluation to the next.
            episodes: how many each evaluation plays: the tuning seeds from 0 on.
            progress: told the steps so far and the last rate of success.
        """

        def measure(model: SAC) -> None:
            evaluation = evaluate(model, self._test_env, range(episodes))
            self.evaluations.append(evaluation)
            if evaluation.rate >= max(e.rate for e in self.evaluations):
                # An agent that only acts needs no replay buffer, nor an environment to load it.
                model.save(self._folder / "agent.zip", exclude=_REPLAY_ARGUMENTS)
            write_evaluations(self._folder / "evaluations.csv", self.evaluations)
            draw_curve(self._folder / "learning_curve.png", self.evaluations, self._title)
            save_checkpoint(model, self._folder)

        def tell(done: int) -> None:
            progress(done, self.evaluations[-1].rate if self.evaluations else 0.0)

        remaining = steps - self.model.num_timesteps
        if remaining > 0:
            callback = Periodically(every, measure, tell)
            self.model.learn(remaining, callback=callback, reset_num_timesteps=False)
            if self.evaluations[-1:] and self.evaluations[-1].steps == self.model.num_timesteps:
                return
            measure(self.model)

    def finish(self, episodes: int) -> Evaluation:
        """Measure the best agent on evaluation seeds."""
        model = SAC.load(self._folder / "agent.zip", device="cpu")
        seeds = range(EVALUATION_SEEDS_START, EVALUATION_SEEDS_START + episodes)
        result = evaluate(model, self._test_env, seeds)
        (self._folder / "result.json").write_text(json.dumps(asdict(result), indent=2) + "\n")
        return result


def main(
    task: Annotated[str, typer.Option(help=f"One of {', '.join(TASKS)}.")] = "Placement",
    difficulty: Annotated[str, typer.Option(help=f"One of {', '.join(DIFFICULTIES)}.")] = "none",
    dense: Annotated[bool, typer.Option(help="Train on the dense reward.")] = False,
    steps: Annotated[int, typer.Option(min=1, help="Environment steps in all.")] = 300_000,
    seed: Annotated[int, typer.Option(min=0, help="Of weights, exploration, episodes.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; by default below results/agents/.")
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(help="Hyper-parameters; by default the task's in envs_assets/agents/."),
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Steps between evaluations.")] = 10_000,
    episodes: Annotated[int, typer.Option(min=1, help="Of each evaluation.")] = 50,
    final_episodes: Annotated[int, typer.Option(min=1, help="Of the last one.")] = 200,
    threads: Annotated[int, typer.Option(min=1, max=2, help="Of PyTorch.")] = 1,
) -> None:
    """Train an agent; the same command goes on after an interruption."""
    console = Console(highlight=False)
    for name, value, allowed in (("task", task, TASKS), ("difficulty", difficulty, DIFFICULTIES)):
        if value not in allowed:
            raise typer.BadParameter(
                f"must be one of {', '.join(allowed)}; got {value!r}", param_hint=f"--{name}"
            )
    name = f"{task}{'Dense' if dense else ''}"
    folder = out or Path("results") / "agents" / f"{name}-{difficulty}-{seed}"
    torch.set_num_threads(threads)
    try:
        training = Training(
            folder,
            task=task,
            difficulty=difficulty,
            dense=dense,
            seed=seed,
            settings=Settings.from_json(settings or asset_path("agents", f"{name}.json")),
        )
    except (OSError, ValueError) as error:
        raise typer.BadParameter(str(error)) from None
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    try:
        with Progress(*columns, console=console) as bar:
            row = bar.add_task("success", total=steps)

            def progress(done: int, rate: float) -> None:
                bar.update(row, completed=done, description=f"success {rate:4.0%}")

            training.run(steps, every=every, episodes=episodes, progress=progress)
        result = training.finish(final_episodes)
    except KeyboardInterrupt:
        console.print("interrupted; the same command goes on from the last checkpoint")
        raise typer.Exit(_INTERRUPTED) from None
    console.print(
        f"{name}, {difficulty}: {result.successes} of {result.episodes} evaluation episodes, "
        f"{result.rate:.1%} ({result.low:.1%}–{result.high:.1%}), after {result.steps} steps; "
        f"see {folder}"
    )


if __name__ == "__main__":
    typer.run(main)
