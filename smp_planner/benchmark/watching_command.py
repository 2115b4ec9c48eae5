"""The command ``smp-bench watch``: one episode as a page in the browser, in three dimensions."""

from __future__ import annotations

import socket
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from smp_planner.benchmark.cell_options import fail
from smp_planner.benchmark.one_episode import plays_one_episode

if TYPE_CHECKING:
    from smp_gym.arrays import FloatArray
    from smp_gym.rollout import Moment, Policy
    from smp_planner.benchmark.episodes import EpisodeKey, PlayMethods
    from smp_planner.benchmark.manifest import Manifest
    from smp_planner.planning.viewer import Exhibit

__all__ = ["exhibit_of_episode", "watch"]


def exhibit_of_episode(player: PlayMethods, key: EpisodeKey, history: int | None = None) -> Exhibit:
    """Play an episode and return the content of a page for it.

    Lines are paths of the grasped object's centre, or of the pen's tip. The arm follows the
    executed trajectory, or the one that was planned first.

    Args:
        player: that plays the method.
        key: names the episode.
        history: iterations after which particles are shown on their way, for which the first plan
            is made once more; None shows none.

    Raises:
        ValueError: the method keeps no particles on their way.
    """
    import gymnasium

    from smp_gym.registration import environment_id
    from smp_gym.rollout import FieldRecorder
    from smp_gym.scene import fixtures
    from smp_planner.benchmark.episode_pictures import carried_point, object_paths
    from smp_planner.benchmark.episodes import play_episode
    from smp_planner.collision.robot_model import jaco_model
    from smp_planner.library.link_meshes import jaco_meshes
    from smp_planner.planning.particle_groups import EXECUTED
    from smp_planner.planning.viewer import Exhibit, Lines, exhibit_of, motion_of
    from smp_planner.policy.planner_policy import PlannerPolicy

    policy = player.policy(key)
    if history is not None:
        _check_history(policy, key.method, history)
    recorder, seen = FieldRecorder("configuration"), _SeenPoints(key.task)
    env = gymnasium.make(environment_id(key.task), **key.cell.make_arguments())
    try:
        played = play_episode(key, env, policy, (recorder, seen), player.lists)
    finally:
        env.close()
    scene, plan, row = played.scene, played.plan, played.row
    point, goals = carried_point(scene), fixtures(scene)[1:]
    title = f"**{key.cell.name}**, {key.method}, {key.half} seed {key.seed}: {row.outcome}."
    if plan is None:
        return Exhibit(
            title,
            {"executed": Lines([object_paths(recorder.values, point)], EXECUTED, 5.0)},
            scene.obstacles,
            goals,
            clouds=seen.clouds,
            motions={"executed": motion_of(jaco_model(), recorder.values)},
            meshes=jaco_meshes(scene.manipulated is None),
        )
    if history is not None:
        assert isinstance(policy, PlannerPolicy)
        (again,) = policy.planner.plan([plan.display["problem"]], history=history)  # type: ignore[call-arg]
        plan = plan.changed(history=again.history)
    exhibit = exhibit_of(plan, recorder.values, point)
    return replace(
        exhibit,
        title=f"{title}\n\n{exhibit.title}",
        obstacles=scene.obstacles,
        goals=goals,
        motions={name: exhibit.motions[name] for name in ("executed", "chosen particle")},
    )


class _SeenPoints:
    """Records the point cloud of the first observation, if it has one.

    Args:
        task: of the environment.
    """

    def __init__(self, task: str) -> None:
        self._task = task
        self.clouds: list[FloatArray] = []

    def __call__(self, moment: Moment) -> None:
        """Take the points (N, 3) m from the first observation."""
        from smp_gym.observation import decode

        if moment.step == 0:
            points = decode(moment.observation, self._task).points
            self.clouds = [] if points is None else [points]


def _check_history(policy: Policy, method: str, history: int) -> None:
    """Raise ValueError unless the planner of a policy keeps particles on their way."""
    from smp_planner.planners.primitive_planner import PrimitivePlanner
    from smp_planner.planning.pipeline import checked_history

    planner = getattr(policy, "planner", None)
    if not isinstance(planner, PrimitivePlanner):
        raise ValueError(f"history must be None for {method!r}, which moves no particles")
    checked_history(history, planner.adaptation)


@plays_one_episode
def watch(
    manifest: Manifest,
    key: EpisodeKey,
    history: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Show the particles on their way, too, on a slider: every so many iterations. "
            "Default: not.",
        ),
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 lets other machines see the page.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Of the page; if taken, the next free one.")
    ] = 8080,
) -> None:
    """Play one episode and show it in the browser, in three dimensions, until Ctrl-C.

    Needs viser, which the extra viewer brings.

    Shown are obstacles, points that a depth camera sees (--sensing depth), demonstrations,
    particles by homotopy class, the executed trajectory beside the planned one, and the arm, moved
    by a slider.

    Example: [green]smp-bench watch --method smp --seed 7 --history 10[/green]
    """
    from smp_gym.optional_packages import require
    from smp_planner.planning.viewer import show

    try:
        require("viewer", "smp-bench watch", "viser")
    except ModuleNotFoundError as error:
        raise fail(str(error), 2) from None
    try:
        socket.getaddrinfo(host, port)
    except (OSError, UnicodeError) as error:
        raise typer.BadParameter(
            f"is no address: {error}, got {host!r}", param_hint="--host"
        ) from None
    with Console(stderr=True).status("playing the episode"):
        exhibit = exhibit_of_episode(manifest.player, key, history)
    page = show(exhibit, host=host, port=port)
    Console(highlight=False).print(f"{page.address}  (Ctrl-C ends)", soft_wrap=True)
    page.server.sleep_forever()
