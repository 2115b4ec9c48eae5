"""The command ``smp-bench watch``: one episode as a page in the browser, in three dimensions."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from smp_planner.benchmark.cell_options import (
    Difficulty,
    Family,
    Latency,
    Lists,
    Noise,
    ReplanEvery,
    Sensing,
    fail,
    replanning,
)
from smp_planner.benchmark.drawing_command import Half, Method, one_episode

if TYPE_CHECKING:
    from smp_gym.arrays import FloatArray
    from smp_planner.benchmark.episodes import EpisodeKey, PlayMethods
    from smp_planner.planning.viewer import Exhibit

__all__ = ["exhibit_of_episode", "watch"]


def exhibit_of_episode(player: PlayMethods, key: EpisodeKey) -> Exhibit:
    """Play an episode and return the content of a page for it.

    Lines are paths of the grasped object's centre, or of the pen's tip. The arm follows the
    executed trajectory, or the one that was planned.

    Args:
        player: that plays the method.
        key: names the episode.
    """
    import gymnasium

    from smp_gym.datasets.demonstrations import Demonstrations
    from smp_gym.registration import environment_id
    from smp_gym.robot import kinematics
    from smp_gym.rollout import FieldRecorder
    from smp_gym.scene import fixtures
    from smp_planner.benchmark.episode_pictures import carried_point, object_paths
    from smp_planner.benchmark.episodes import play_episode
    from smp_planner.planning.particle_groups import CHOSEN
    from smp_planner.planning.viewer import Exhibit, Lines, Motion, lines_of

    recorder = FieldRecorder("configuration")
    env = gymnasium.make(environment_id(key.task), **key.cell.make_arguments())
    try:
        played = play_episode(key, env, player.policy(key), (recorder,), player.lists)
    finally:
        env.close()
    scene, plan, row = played.scene, played.plan, played.row
    spheres = kinematics.arm_spheres()

    def motion(configurations: FloatArray) -> Motion:
        return Motion(kinematics.sphere_centers(configurations, spheres), spheres.radius)

    point = carried_point(scene)
    title = f"**{key.cell.name}**, {key.method}, {key.half} seed {key.seed}: {row.outcome}."
    motions = {"executed": motion(recorder.values)}
    lines = {"executed": Lines([object_paths(recorder.values, point)], CHOSEN, 5.0)}
    if plan is not None:
        shipped = Demonstrations.load(key.task).configurations
        paths = object_paths(plan.trajectories, point)
        lines |= lines_of(plan, paths, object_paths(shipped, point))
        motions["chosen particle"] = motion(plan.best)
        title += f"\n\n{int(plan.good.sum())} of {len(paths)} particles are good."
    goals = fixtures(scene)[1:]
    return Exhibit(title, lines, scene.obstacles, goals, motions=motions)


def watch(
    task: Annotated[str, typer.Option(help="Name of the task.")] = "Placement",
    method: Method = "smp",
    difficulty: Difficulty = None,
    family: Family = None,
    sensing: Sensing = None,
    noise: Noise = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the episode.")] = 0,
    half: Half = "",
    lists: Lists = None,
    replan_every: ReplanEvery = None,
    latency: Latency = None,
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 lets other machines see the page.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Of the page; if taken, the next free one.")
    ] = 8080,
) -> None:
    """Play one episode and show it in the browser, in three dimensions, until Ctrl-C.

    Needs viser, which the extra viewer brings.

    Example: [green]smp-bench watch --method smp --seed 7[/green]
    """
    from smp_gym.optional_packages import require
    from smp_planner.planning.viewer import show

    try:
        require("viewer", "smp-bench watch", "viser")
    except ModuleNotFoundError as error:
        raise fail(str(error), 2) from None
    single = {"difficulty": difficulty, "family": family, "sensing": sensing, "noise": noise}
    try:
        socket.getaddrinfo(host, port)
    except (OSError, UnicodeError) as error:
        raise typer.BadParameter(
            f"is no address: {error}, got {host!r}", param_hint="--host"
        ) from None
    replanned = replanning(replan_every, latency)
    manifest, key = one_episode(task, method, seed, half, lists, single, replanned)
    with Console(stderr=True).status("playing the episode"):
        exhibit = exhibit_of_episode(manifest.player, key)
    page = show(exhibit, host=host, port=port)
    Console(highlight=False).print(f"{page.address}  (Ctrl-C ends)", soft_wrap=True)
    page.server.sleep_forever()
