"""The pictures: projection, hidden lines, bodies, and the files that are written."""

from dataclasses import replace
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from smp_gym.datasets.demonstrations import Demonstrations
from smp_gym.geometry.faces import body_faces
from smp_gym.scene import Goal, ManipulatedObject, Obstacle, Scene
from smp_planner.benchmark.camera import Camera, Painter
from smp_planner.benchmark.episode_pictures import FRAME_RATE, scene_figure, write_video
from smp_planner.benchmark.episodes import EpisodeRow, PlayedEpisode
from smp_planner.planning.plan import Plan

ALONG_X = Camera((0.0, 0.0, 0.0), azimuth=0.0, elevation=0.0, distance=2.0)
TILTED = (0.1, 0.2, 0.3, np.sqrt(1 - 0.14))


def test_camera_projects_like_a_pinhole() -> None:
    points = np.array([[0.0, 0.3, 0.2], [1.0, 0.3, 0.2], [-2.0, 0.3, 0.2]])
    flat, depth = ALONG_X.project(points)
    np.testing.assert_allclose(depth, [2.0, 1.0, 4.0], atol=1e-12)
    np.testing.assert_allclose(flat, [[0.3, 0.2], [0.6, 0.4], [0.15, 0.1]], atol=1e-12)


def test_points_on_a_ray_fall_together() -> None:
    camera = Camera((0.3, 0.1, 0.2), azimuth=-40.0, elevation=30.0, distance=2.0)
    near = np.array([0.5, -0.2, 0.4])
    far = near + 0.7 * (near - camera.position)
    np.testing.assert_allclose(camera.project(near)[0], camera.project(far)[0], atol=1e-12)
    np.testing.assert_allclose(camera.project(np.array(camera.target))[0], 0.0, atol=1e-12)
    assert np.linalg.norm(camera.position - camera.target) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("shape", "size", "volume"),
    [
        ("box", (0.1, 0.2, 0.3), 8 * 0.006),
        ("cylinder", (0.1, 0.1, 0.3), np.pi * 0.01 * 0.6),
        ("sphere", (0.1, 0.1, 0.1), 4 / 3 * np.pi * 0.001),
    ],
)
def test_bodies_have_their_volume_and_place(
    shape: str, size: tuple[float, float, float], volume: float
) -> None:
    body = Obstacle.model_validate(
        {"shape": shape, "position": (0.4, -0.1, 0.2), "quaternion": TILTED, "size": size}
    )
    points = np.concatenate(body_faces(body))
    assert ConvexHull(points).volume == pytest.approx(volume, rel=0.03)
    np.testing.assert_allclose(
        (points.min(axis=0) + points.max(axis=0)) / 2, body.position, atol=2e-3
    )


def _picture(painter: Painter) -> NDArray[np.uint8]:
    figure = Figure(figsize=(4, 4), dpi=50)
    canvas = FigureCanvasAgg(figure)
    painter.paint(figure.add_axes((0, 0, 1, 1)))
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def _shows_red(picture: NDArray[np.uint8]) -> bool:
    return bool(((picture[..., 0] > 200) & (picture[..., 1:] < 60).all(axis=-1)).any())


@pytest.mark.parametrize(("x", "seen"), [(0.5, True), (-0.5, False)])
def test_lines_behind_a_body_are_hidden(x: float, seen: bool) -> None:
    painter = Painter(ALONG_X)
    painter.body(Obstacle(shape="box", position=(0, 0, 0), size=(0.2, 0.5, 0.5)), "blue")
    painter.line(np.array([[x, -0.2, 0.0], [x, 0.2, 0.0]]), "red", 3.0)
    assert _shows_red(_picture(painter)) is seen


def _played() -> PlayedEpisode:
    demonstrations = Demonstrations.load("Placement")
    trajectories = demonstrations.configurations
    count = len(trajectories)
    plan = Plan(
        trajectories=trajectories,
        costs={},
        collision_free=np.arange(count) % 2 == 0,
        clearance=np.zeros(count),
        missed={},
        passing=np.ones(count, bool),
        duration=np.full(count, 10.0),
        executable=np.ones(count, bool),
        ranks=(np.arange(count) - 2) % count,
        signatures=np.zeros((count, 1), np.int64),
    )
    scene = Scene(
        task="Placement",
        start=tuple(trajectories[0, 0].tolist()),
        manipulated=ManipulatedObject(),
        goals=(Goal(position=(0.52, 0.32, 0.01)),),
        obstacles=(Obstacle(shape="sphere", position=(0.5, 0, 0.3), size=(0.05, 0.05, 0.05)),),
    )
    row = EpisodeRow(
        task="Placement",
        method="smp",
        difficulty="medium",
        seed=3,
        success=False,
        collision=True,
        cause="collision",
        contact="palm – obstacle_0",
        goal_error=0.1,
        path_length=1.0,
        clearance=0.0,
        steps=100,
    )
    return PlayedEpisode(row, scene, plan, np.zeros((101, 3)))


def test_scene_figure_of_an_agent_shows_what_it_did(tmp_path: Path) -> None:
    path = tmp_path / "scene.png"
    executed = np.linspace((0.3, -0.3, 0.3), (0.5, 0.3, 0.3), 50)
    scene_figure(replace(_played(), plan=None, object_path=executed), path)
    picture = imageio.imread(path)[..., :3].astype(int)
    left = picture[:, : int(0.65 * picture.shape[1])]
    assert (np.abs(left - (0xF5, 0x9E, 0x0B)).max(axis=-1) < 12).sum() > 50


def test_scene_figure_shows_every_kind_of_line(tmp_path: Path) -> None:
    path = tmp_path / "scene.png"
    scene_figure(_played(), path)
    picture = imageio.imread(path)[..., :3].astype(int)
    left = picture[:, : int(0.65 * picture.shape[1])]
    for color in ("#7fa3ee", "#ea8585", "#f59e0b", "#4b5563"):
        rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
        assert (np.abs(left - rgb).max(axis=-1) < 12).sum() > 50, color


def test_video_has_all_frames_in_real_time(tmp_path: Path) -> None:
    frames = [np.full((120, 160, 3), 5 * i, np.uint8) for i in range(40)]
    path = tmp_path / "episode.mp4"
    write_video(frames, path)
    with imageio.get_reader(path) as reader:
        assert reader.get_meta_data()["fps"] == FRAME_RATE == 20
        back = np.array([frame.mean() for frame in reader])
        assert reader.get_data(0).shape == (120, 160, 3)
    assert len(back) == 40 + FRAME_RATE
    np.testing.assert_allclose(back[:40], [5 * i for i in range(40)], atol=4)


def test_a_video_needs_frames(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least one"):
        write_video([], tmp_path / "empty.mp4")


def test_a_missing_ffmpeg_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "nothing"))
    with pytest.raises(OSError, match="nothing"):
        write_video([np.zeros((32, 32, 3), np.uint8)], tmp_path / "film.mp4")
    assert not list(tmp_path.iterdir())
