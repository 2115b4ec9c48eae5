"""Attack the public entry points with bad inputs, drawn by kind, and print what came of them.

    python scripts/attack.py --count 800 --seed 0

Every call gets one argument that is wrong. Counted is whether it was accepted all the same, took
longer than the limit, or was refused with an error that names the argument; files are damaged at
random, of which some stay as good as they were. A death ends this process.
"""

from __future__ import annotations

from smp_gym.console_script import require_for_script

require_for_script()

import json
import resource
import signal
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import torch
import typer
from rich.console import Console
from trimesh.creation import box

import smp_gym  # noqa: F401
from smp_gym.assets import jaco_urdf
from smp_gym.datasets import frozen
from smp_gym.datasets.demonstrations import Demonstrations, resample
from smp_gym.datasets.motion_bench_maker import load_obstacles
from smp_gym.observation import decode
from smp_gym.sampling import sample_scene
from smp_gym.scene import Goal, ManipulatedObject, Motion, Obstacle, Scene
from smp_gym.suites import SUITES, Cell
from smp_planner import (
    SMP,
    AdaptSettings,
    AnyOf,
    Box,
    Circle,
    Cone,
    GoalRegion,
    Orientation,
    PlannerPolicy,
    PlanningScene,
    PointCloud,
    PriorSettings,
    Rectangle,
    Robot,
    ToolViaPoint,
    ViaPoint,
    capsule_obstacles,
    cone_obstacles,
    height_map_obstacles,
    make_planner,
    mesh_obstacles,
)
from smp_planner.adaptation import adaptation
from smp_planner.benchmark.episodes import EpisodeRow
from smp_planner.benchmark.manifest import EpisodeStore, make_manifest, read_results
from smp_planner.benchmark.options import run_command
from smp_planner.benchmark.results_folder import RESULTS
from smp_planner.experiments.outcomes import print_outcomes
from smp_planner.movement_primitives import GaussianBasis, ProMP

SCENE = """scene
* things
0.5 0 0.1
0 0 0 1
3
cylinder
0.05 0.1
0 0 0
0 0 0 1
0 0 0 0
cone
0.05 0.1
0 0 0.2
0 0 0 1
0 0 0 0
mesh
3 1
0 0 0
0.1 0 0
0 0.1 0
0 1 2
0.2 0 0
0 0 0 1
0 0 0 0
0
.
"""
"""A scene in MoveIt's text format."""

LIMIT = 10.0
"""Seconds that a call may take."""

SHARE_OF_FILES = 0.3

OUTCOMES = ("named", "unnamed", "leaked", "accepted", "sound", "hung", "memory")
"""Refused with an error that names the argument, or does not; another error than bad values are
said to cause; accepted; a damaged file that is as good as it was; too long; too much memory."""

_ALIASES = {
    "name": ("method",),
    "options": ("scene", "options"),
    "path": ("none.urdf", "director"),
    "demonstrations": ("none.npz",),
    "scene.json": ("scene",),
    "arm.urdf": ("joint '", "link"),
    "max_episode_steps": ("limit",),
    "motion": ("times",),
}
"""Other words that name an argument."""

MEMORY = 16 * 2**30
"""Bytes of address space."""

Draw = Callable[[np.random.Generator], Any]


def of(*values: Any) -> Draw:
    """Return a drawing of one of some values."""
    return lambda rng: values[rng.integers(len(values))]


def no_number(rng: np.random.Generator) -> Any:
    """Draw what is no finite number."""
    return of(
        np.nan,
        np.inf,
        -np.inf,
        "one",
        None,
        1j,
        object(),
        [],
        {},
        10**400,
        b"one",
    )(rng)


def not_positive(rng: np.random.Generator) -> Any:
    """Draw what is no positive number."""
    return no_number(rng) if rng.random() < 0.6 else -float(rng.exponential())


def no_count(rng: np.random.Generator) -> Any:
    """Draw what is no count."""
    return of(
        1.5,
        -1,
        "three",
        None,
        np.nan,
        2j,
        [1],
        -(2**70),
        np.array([1.5, 2.5]),
    )(rng)


def no_vector(rng: np.random.Generator) -> Any:
    """Draw what is no vector of two, three, six or seven finite numbers."""
    vector = rng.normal(size=rng.choice([2, 3, 6, 7]))
    bad = vector.copy()
    bad[rng.integers(len(bad))] = rng.choice([np.nan, np.inf])
    return of(
        bad,
        bad.tolist(),
        vector + 1j,
        vector.astype(str),
        np.ma.masked_array(vector, [True] * len(vector)),
        [object()] * len(vector),
        [None] * len(vector),
        np.zeros((2, 2, 2)),
        np.zeros(11),
        [],
        "abc",
        None,
        5,
        [[1.0, 2.0], [3.0]],
    )(rng)


def no_name(rng: np.random.Generator) -> Any:
    """Draw what names nothing that there is."""
    return of(
        "",
        "nothing",
        3,
        None,
        b"smp",
        ("smp",),
        1.5,
        "smp\0",
        "x" * 100_000,
    )(rng)


def no_demonstrations(rng: np.random.Generator) -> Any:
    """Draw what are no demonstrations: no paths, all of one point, or quaternions."""
    unit = rng.normal(size=(3, 20, 4))
    unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
    return of(unit, np.zeros((3, 20, 2)), *(no_paths(rng) for _ in range(4)))(rng)


def no_paths(rng: np.random.Generator) -> Any:
    """Draw what are no paths in the plane."""
    paths = rng.normal(size=(3, 20, 2))
    holed = paths.copy()
    holed[rng.integers(3), rng.integers(20)] = rng.choice([np.nan, np.inf])
    return of(
        holed,
        paths + 1j,
        paths.astype(str),
        paths.astype(object),
        np.ma.masked_array(paths, paths > 0),
        paths[:1],
        paths[0],
        paths[:, :1],
        [paths[0], paths[1, :, :1]],
        [],
        None,
        7,
        "none.npz",
        "none.txt",
        {"a": paths[0]},
    )(rng)


def no_list(rng: np.random.Generator) -> Any:
    """Draw what is no list of obstacles or via-points."""
    return of(
        3,
        "walls",
        None,
        [3],
        [None],
        {"a": 1},
        object(),
        np.zeros((2, 2)),
        [[0.0, 1.0]],
    )(rng)


def no_mapping(rng: np.random.Generator) -> Any:
    """Draw what is no mapping of known names to numbers."""
    return of(["a"], {"a": 1.0}, {3: 1.0}, "a", 3, {"joint_1": "x"})(rng)


@dataclass(frozen=True)
class Entry:
    """An entry point.

    Attributes:
        name: for the table.
        call: takes keyword arguments.
        bad: for each argument how wrong values of it are drawn.
        good: the other arguments.
    """

    name: str
    call: Callable[..., Any]
    bad: Mapping[str, Draw]
    good: Mapping[str, Any] = field(default_factory=dict)


def entries(folder: Path) -> list[Entry]:
    """Return the entry points that take arguments."""
    phase = np.linspace(0.0, 1.0, 20)
    paths = [np.stack([phase, a * np.sin(np.pi * phase)], 1) for a in (0.2, 0.25, 0.3)]
    primitive = SMP.fit(paths)
    env = gym.make("smp_gym/Placement-v0", difficulty="none")
    observation, _ = env.reset(seed=0)
    scene = sample_scene("Placement", "easy", 0)
    whole = json.loads(scene.to_json())
    shown = Demonstrations.load("Placement")
    arm = Robot.from_urdf(jaco_urdf(), "j2s6s200_end_effector")
    texts = folder / "entry.scene"
    texts.write_text(SCENE)

    def make(**given: Any) -> None:
        gym.make("smp_gym/Placement-v0", **given).close()

    def observe(**given: Any) -> None:
        decode({**observation, **given}, "Placement")

    def play(**given: Any) -> None:
        env.reset(options={"scene": {**whole, **given}})

    solid = {"position": no_vector, "quaternion": no_vector}
    body = {"shape": "box", "position": (0.5, 0.0, 0.5), "size": (0.1, 0.1, 0.1)}
    settings = {
        name: not_positive if "float" in str(part.annotation) else no_count
        for name, part in AdaptSettings.model_fields.items()
        if part.annotation in (int, float)
    }
    learning = {
        name: not_positive if part.annotation is float else no_count
        for name, part in PriorSettings.model_fields.items()
        if part.annotation in (int, float)
    }
    learning["smooth_std"] = not_positive
    return [
        Entry("gymnasium.make", make, {"difficulty": no_name, "reward": no_name, "width": no_count,
              "height": of(0, 10**10, 1.5, "a", None), "camera": of(3, {"yaw": np.nan}, "a"),
              "control": no_name, "family": no_name, "sensing": no_name,
              "noise": of(-1.0, np.nan, "a", [], 1j),
              "max_episode_steps": of(0, -5, 1.5, "a", 10**9)},
              {"difficulty": "easy", "render_mode": "rgb_array"}),
        Entry("env.step", env.step, {"action": no_vector}),
        Entry("env.reset", env.reset, {"seed": of(-1, 1.5, "a", 1j), "options": of(
            {"scene": 3}, {"scenes": 1}, {"scene": "{"}, {"scene": []}, {"scene": "[" * 10**5})}),
        Entry("env.reset(scene)", play, {"start": no_vector, "goals": no_list, "obstacles": no_list,
              "task": no_name, "difficulty": no_name, "family": no_name, "seed": of(-1, 1.5, "a"),
              "manipulated": of(3, [], {"size": (0.1, np.nan, 1.0)}, {"mass": -1.0})}),
        Entry("decode", observe, {"observation": no_vector, "obstacles": no_vector,
              "desired_goal": no_vector, "achieved_goal": no_vector}),
        Entry("sample_scene", sample_scene, {"task": no_name, "difficulty": no_name,
              "seed": no_count, "family": no_name},
              {"task": "Placement", "difficulty": "none", "seed": 0}),
        Entry("Obstacle", Obstacle, {"shape": no_name, "position": no_vector, "size": no_vector,
              "quaternion": no_vector, "velocity": no_vector, "motion": of(3, "a", {})}, body),
        Entry("Motion", Motion, {"times": no_vector, "points": no_list},
              {"times": (0.0, 1.0), "points": ((0, 0, 0), (1, 1, 1))}),
        Entry("Goal", Goal, {"kind": no_name, "position": no_vector}, {"position": (0, 0, 0)}),
        Entry("ManipulatedObject", ManipulatedObject, {"size": no_vector, "mass": not_positive}),
        Entry("Demonstrations", Demonstrations, {"configurations": no_paths,
              "gripper": no_paths, "durations": no_vector, "task": no_name,
              "scenes": of((), (1,), None, "a"), "metadata": of(3, [1], None)},
              {name: getattr(shown, name) for name in
               ("task", "configurations", "gripper", "durations", "scenes")}),
        Entry("resample", resample, {"values": of(None, "a", 3, np.zeros(5), np.zeros((3, 2)),
              np.full((9, 2), 1j)), "samples": no_count},
              {"values": paths[0]}),
        Entry("SMP.fit", SMP.fit, {"demonstrations": no_demonstrations, "robot": of(3, "a", paths),
              **learning}, {"demonstrations": paths}),
        Entry("SMP.adapt", primitive.adapt, {"obstacles": no_list, "start": of(
              *((k,) for k in range(3)), (np.nan, 0.0), "ab", (1j, 0.0), ("0", "0"), 3, object()),
              "goal": of((np.inf, 0.0), (0.0,) * 3, {}, [None, 1.0]), "via_points": no_list,
              "radius": not_positive, "particles": no_count, "seed": no_count, "method": no_name,
              "settings": of(3, {}, "a")}, {"method": "promp", "particles": 2}),
        Entry("Circle", Circle, {"center": no_vector, "radius": not_positive},
              {"center": (0, 0), "radius": 1}),
        Entry("Rectangle", Rectangle, {"center": no_vector, "half_extents": no_vector,
              "angle": no_number}, {"center": (0, 0), "half_extents": (1, 1)}),
        Entry("ViaPoint", ViaPoint, {"phase": of(-0.1, 1.1, np.nan, "a", None, 1j),
              "position": of(None, "ab", [np.nan], [1j], [], [[0.0]]), "tolerance": not_positive},
              {"phase": 0.5, "position": (0, 0)}),
        Entry("Box", Box, {"lower": of(None, "ab", [np.nan, 0], [1j, 0], [], [2, 0]),
              "upper": of(None, [np.inf, 1], ["1", "1"], [1.0]), "sigma": of(0, -1, "a", np.nan)},
              {"lower": (0, 0), "upper": (1, 1)}),
        Entry("AnyOf", AnyOf, {"options": of((), None, 3, "ab"), "shares": of((1,), (-1, 2), "ab")},
              {"options": [(0, 0), (1, 1)]}),
        Entry("GoalRegion", GoalRegion, {"point": no_vector, "lower": no_vector,
              "upper": no_vector, "orientation": of((0, 0, 0, 1), "a", 3)},
              {name: np.zeros(3) for name in ("point", "lower", "upper")}),
        Entry("ToolViaPoint", ToolViaPoint, {"phase": of(-0.1, 1.1, np.nan, "a", None, 1j),
              "point": no_vector, "position": no_vector, "tolerance": of(0.0, -1.0, "a", np.nan),
              "orientation": of((0, 0, 0, 1), "a", 3)},
              {"phase": 0.5, "point": np.zeros(3), "position": np.zeros(3), "tolerance": 0.1}),
        Entry("Cone", Cone, {"axis": of((0, 0, 0), "abc", (np.nan, 0, 0), (1, 0), None),
              "direction": of((0, 0, 0), "abc", (np.inf, 0, 0), (1, 0), None),
              "angle": of(-1, 4.0, "a", np.nan, None)},
              {"axis": (0, 0, 1), "direction": (0, 0, 1), "angle": 0.1}),
        Entry("Orientation", Orientation, {"quaternion": of((0,) * 4, (0, 0, 0, 2), (0, 0, 1), "a",
              (np.nan,) * 4, None), "tolerance": of(-1, 4.0, "a", np.nan, None)},
              {"quaternion": (0, 0, 0, 1), "tolerance": 0.1}),
        Entry("PointCloud", PointCloud, {"points": no_vector, "sensor": no_vector,
              "thickness": of(-1, "a", np.nan), "inflation": of(0, -1, "a", np.nan)},
              {"points": np.eye(3), "sensor": (5.0, 5.0, 5.0)}),
        Entry("mesh_obstacles", mesh_obstacles, {"mesh": of(3, None, "none.txt"),
              "scale": no_vector, "cell": not_positive, **solid}, {"mesh": box(), "cell": 0.2}),
        Entry("capsule_obstacles", capsule_obstacles, {"radius": not_positive,
              "length": not_positive, **solid}, {"radius": 0.1, "length": 0.3}),
        Entry("cone_obstacles", cone_obstacles, {"radius": not_positive, "height": not_positive,
              "overshoot": not_positive, **solid},
              {"radius": 0.1, "height": 0.3, "overshoot": 0.01}),
        Entry("height_map_obstacles", height_map_obstacles, {"heights": of("abc", None, 3, [1.0],
              [["a"]], [[np.nan]], [[1j]], [[-1.0]], np.zeros((0, 2)), np.zeros((9, 9, 9))),
              "resolution": not_positive, "floor": no_number, "overshoot": not_positive,
              "unknown": of(-1.0, "a", np.nan, []), **solid},
              {"heights": np.eye(3), "resolution": 0.1, "floor": 0.0}),
        Entry("PlanningScene.load", PlanningScene.load, {"cell": not_positive,
              "overshoot": not_positive, "robot": of(3, "a", {}), "request": of(texts, "none.yaml"),
              "frames": of(3, "a", [], {"world": 3}, {"world": "ab"},
              {"moon": ((0, 0, 0), (1,) * 4)}, {"world": ((np.nan, 0, 0), (0, 0, 0, 1))},
              {"moon": ((0, 0, 0), (0, 0, 0, 1))})}, {"path": texts}),
        Entry("Robot.configuration", arm.configuration, {"positions": no_mapping,
              "ignored": of("a", 3, None)}, {"positions": dict.fromkeys(arm.joints, 0.0)}),
        Entry("AdaptSettings", AdaptSettings, {**settings, "edge_width": no_vector,
              "map": no_name, "modulation": no_name}),
        Entry("PriorSettings", PriorSettings, learning),
        Entry("adaptation", adaptation, {"name": no_name, "iterations": no_count,
              "step_size": of(0, -1.0, np.nan, np.inf, "a", 1j, [])}, {"name": "smp"}),
        Entry("make_planner", make_planner, {"name": no_name, "task": of("", "x", 3, b"a", 1.5),
              "settings": of({"a": 1}, 3, "a", {"margin": np.nan}, {"particles": -1}),
              "demonstrations": of(3, "a", paths)}, {"name": "promp", "task": "Placement"}),
        Entry("PlannerPolicy.make", PlannerPolicy.make, {"method": no_name,
              "task": of("", "x", 3, b"a", 1.5), "seed": of(-1, 1.5, "a", 2**80),
              "replan_every": of(0, -1, 1.5, "a"), "latency": of(-1, 1.5, "a", None)},
              {"method": "promp", "task": "Placement"}),
        Entry("Robot.from_urdf", Robot.from_urdf, {"path": of("none.urdf", folder), "tip": no_name,
              "held": no_mapping, "overshoot": not_positive, "limits": no_mapping,
              "velocities": no_mapping, "bodiless": of("a", 3, ["a"], [3]),
              "packages": of({"a": "/no/folder"}, 3, ["a"]),
              "base": of(3, "a", [], ((0, 0), (0, 0, 0, 1)), ((0, 0, np.nan), (0, 0, 0, 1)),
              ((0, 0, 0), (0, 0, 0, 2)))},
              {"path": jaco_urdf(), "tip": "j2s6s200_end_effector"}),
        Entry("ProMP.fit", ProMP.fit, {"demonstrations": no_paths,
              "smooth_std": not_positive, "smooth_length_scale": not_positive},
              {"demonstrations": paths}),
        Entry("GaussianBasis", GaussianBasis, {"count": no_count}),
    ]  # fmt: skip


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Return a file with some bytes, or its end, changed."""
    changed = bytearray(content)
    how = rng.integers(4)
    if how == 0:
        return bytes(changed[: rng.integers(len(changed))])
    if how == 1:
        place = int(rng.integers(len(changed)))
        length = int(rng.integers(1, 40))
        return bytes(changed[:place] + changed[place + length :])
    for place in rng.integers(len(changed), size=int(rng.integers(1, 6))):
        changed[place] = rng.integers(256)
    return bytes(changed) if how == 2 else bytes(changed) + rng.bytes(20)


def readers(folder: Path) -> list[tuple[str, Path, Callable[[Path], Any]]]:
    """Return the entry points that take files: name, a good file, and the reader."""
    phase = np.linspace(0.0, 1.0, 20)
    paths = [np.stack([phase, a * np.sin(np.pi * phase)], 1) for a in (0.2, 0.25)]
    shown = Demonstrations.load("Placement")
    shown.save(folder / "shown.npz")
    SMP.fit(paths).save(folder / "primitive.npz")
    np.savez(folder / "paths.npz", demonstrations=np.array(paths))
    rows = [f"{k},{t},{x},{y}" for k, p in enumerate(paths) for t, (x, y) in enumerate(p.tolist())]
    (folder / "paths.csv").write_text("\n".join(["demonstration,time,x,y", *rows]))
    PlannerPolicy.make("promp", "Placement").save(folder / "policy.zip")
    (folder / "arm.urdf").write_bytes(Path(jaco_urdf()).read_bytes())
    (folder / "scene.json").write_text(sample_scene("Placement", "easy", 0).to_json())
    (folder / "entry.scene").write_text(SCENE)
    (folder / "scene.yaml").write_text(
        "world:\n  collision_objects:\n    - id: can\n      primitives:\n        - type: cylinder\n"
        "          dimensions: [0.1, 0.05]\n      primitive_poses:\n"
        "        - {position: [0.5, 0.0, 0.1], orientation: [0.0, 0.0, 0.0, 1.0]}\n"
    )
    manifest = make_manifest([Cell("Placement", "none")], ["promp"], 0, 1)
    (key,) = manifest.episode_keys()
    with EpisodeStore(folder / "run", manifest) as store:
        fields = (key.task, key.method, key.difficulty, key.seed)
        store.append(EpisodeRow(*fields, True, False, "", "", 0.1, 1.0, 0.02, 150))
    cell = SUITES["standard"][0]
    drawn = sample_scene(cell.task, cell.difficulty, 0)
    listed = frozen.list_path(cell, folder)
    frozen.write_episodes(listed, {}, [frozen.FrozenEpisode("witness", 0, drawn, "smp")])

    def load_list(path: Path) -> None:
        frozen._load.cache_clear()
        frozen.load_episodes(cell, folder)

    return [
        ("Demonstrations.load", folder / "shown.npz", Demonstrations.load),
        ("SMP.load", folder / "primitive.npz", SMP.load),
        ("SMP.fit(.npz)", folder / "paths.npz", SMP.fit),
        ("SMP.fit(.csv)", folder / "paths.csv", SMP.fit),
        ("PlannerPolicy.load", folder / "policy.zip", PlannerPolicy.load),
        ("Robot.from_urdf", folder / "arm.urdf", lambda p: Robot.from_urdf(
            p, "j2s6s200_end_effector")),
        ("load_obstacles", folder / "scene.yaml", load_obstacles),
        ("PlanningScene.load(.yaml)", folder / "scene.yaml", PlanningScene.load),
        ("PlanningScene.load(.scene)", folder / "entry.scene", PlanningScene.load),
        ("load_episodes", listed, load_list),
        ("read_results", folder / "run" / RESULTS, lambda p: read_results(p.parent)),
        ("Scene.from_json", folder / "scene.json", lambda p: Scene.from_json(p.read_bytes())),
    ]  # fmt: skip


class Overtime(BaseException):
    """A call took longer than it may."""


def judged(call: Callable[[], Any], name: str) -> tuple[str, str]:
    """Return what came of a call with a bad argument of a name, and what was said of it."""

    def stop(*_: Any) -> None:
        raise Overtime

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    try:
        call()
        return "accepted", ""
    except Overtime:
        return "hung", ""
    except MemoryError as error:
        return "memory", str(error)
    except (ValueError, TypeError, OSError, RuntimeError, ImportError, gym.error.Error) as error:
        said = f"{type(error).__name__}: {error}"
        told = said.casefold()
        named = any(part.casefold() in told for part in (name, *_ALIASES.get(name, ())))
        return ("named" if named else "unnamed"), said
    except Exception as error:
        return "leaked", f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def attack(
    count: int, seed: int, report: Callable[[str], None] = lambda line: None
) -> dict[str, Counter[str]]:
    """Return how often what came of bad inputs, by entry point.

    Args:
        count: bad inputs to draw.
        seed: of what is drawn.
        report: is told of each that was not refused by name.
    """
    rng = np.random.default_rng(seed)
    outcomes: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        arguments, files = entries(folder), readers(folder)
        contents = {path: path.read_bytes() for _, path, _ in files}
        for _ in range(count):
            if rng.random() < SHARE_OF_FILES:
                title, path, read = files[rng.integers(len(files))]
                path.write_bytes(damaged(contents[path], rng))
                what, said = judged(partial(read, path), path.name)
                what = {"accepted": "sound"}.get(what, what)
                path.write_bytes(contents[path])
                shown = path.name
            else:
                entry = arguments[rng.integers(len(arguments))]
                title, argument = entry.name, sorted(entry.bad)[rng.integers(len(entry.bad))]
                value = entry.bad[argument](rng)
                what, said = judged(
                    partial(entry.call, **{**entry.good, argument: value}), argument
                )
                shown = f"{argument}={value!r:.80}"
            outcomes.setdefault(title, Counter())[what] += 1
            if what not in ("named", "sound"):
                report(f"{what}: {title}({shown}) {said[:300]}")
    return outcomes


def main(
    count: Annotated[int, typer.Option(help="Bad inputs to draw.", min=1)] = 800,
    seed: Annotated[int, typer.Option(help="Of what is drawn.", min=0)] = 0,
) -> None:
    """Attack the public entry points, and print a table.

    Example: python scripts/attack.py --count 800 --seed 0
    """
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    console = Console()
    outcomes = attack(count, seed, partial(console.print, markup=False))
    print_outcomes(console, outcomes, OUTCOMES, "entry point", f"{count} bad inputs")


if __name__ == "__main__":
    run_command(main)
