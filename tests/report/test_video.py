"""Videos have the episode's length, show the moment they say, and exist without OpenGL."""

import pathlib
import subprocess
import sys

import imageio.v2 as imageio
import numpy as np
import pytest
from known_run import SECONDS, crawl, known_trace

from agile_jax.report import ReportSettings, render_video
from agile_jax.report.video.camera import film, snapshots
from agile_jax.report.video.opengl import RenderError, candidates, opengl_frames
from agile_jax.report.video.video import SIM_DT, render_shot, write_mp4
from agile_jax.robot import RobotSettings, build_mujoco_model
from agile_jax.settings import BadInput

SMALL = ReportSettings(renderer="drawing", width=320, height=180)


def test_length_size_and_motion(tmp_path: pathlib.Path, scene_settings):
    path = tmp_path / "videos" / "out.mp4"
    assert render_video(scene_settings, RobotSettings(), known_trace(), path, SMALL) is None
    with imageio.get_reader(path) as reader:
        meta = reader.get_meta_data()
        frames = [np.asarray(frame).astype(int) for frame in reader]
    assert len(frames) == round(SECONDS * 25) + 1
    assert meta["fps"] == 25
    assert meta["duration"] == pytest.approx(len(frames) / 25, abs=0.02)
    assert frames[0].shape == (180, 320, 3)
    assert np.abs(frames[0] - frames[len(frames) // 2]).mean() > 2  # table and robot have moved in the picture
    assert not list(path.parent.glob(".*")), "a temporary file was left"


def test_a_long_episode_is_cut():
    time = np.arange(0, 40, 0.02)
    shot = film(time, np.zeros((len(time), 19)), 25, longest=15.0)
    assert len(shot.qpos) == 15 * 25 + 1


def test_pictures_follow_the_clock():
    """At 10 pictures a second the i-th one shows the state at i / 10 s."""
    time, qpos = crawl(0.0)
    shot = film(time, qpos, 10, 15.0)
    np.testing.assert_allclose(shot.qpos[:, 0], np.arange(31) * 0.1 * 3.0 / SECONDS, atol=0.011)
    assert np.abs(shot.look_at[:, 0] - shot.qpos[:, 0]).max() < 0.25  # the camera stays with the robot


def test_snapshots_are_before_entering_under_and_after(scene):
    time, qpos = crawl(0.0)
    x = snapshots(scene, time, qpos).qpos[:, 0]
    np.testing.assert_allclose(x, [1.25 - 0.36, 1.25, 1.5, 1.75 + 0.36], atol=0.03)


def test_without_an_obstacle_snapshots_are_spread_over_time(scene):
    time, qpos = crawl(2.0)
    x = snapshots(scene, time, qpos).qpos[:, 0]
    np.testing.assert_allclose(x, [0, 1, 2, 3], atol=0.03)


def test_the_users_choice_of_opengl_comes_first():
    assert candidates({"MUJOCO_GL": "osmesa"}) == ("osmesa",)
    assert candidates({"MUJOCO_GL": "disabled"}) == ()
    assert candidates({}, "linux") == ("egl", "osmesa")


def test_where_no_opengl_works_there_is_a_drawing_and_one_line(tmp_path, scene_settings, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    path = tmp_path / "out.mp4"
    note = render_video(scene_settings, RobotSettings(), known_trace(), path, ReportSettings(width=320, height=180))
    assert note is not None
    assert "apt-get install" in note
    assert "\n" not in note
    with imageio.get_reader(path) as reader:
        assert reader.count_frames() == round(SECONDS * 25) + 1


def test_a_backend_that_does_not_exist_is_named(scene):
    model = build_mujoco_model(scene, RobotSettings(), SIM_DT)
    shot = snapshots(scene, *crawl(0.0))
    with pytest.raises(RenderError, match="nonsense"):
        list(opengl_frames(model, shot, 64, 64, "nonsense"))


def test_a_trace_of_another_robot_is_refused(scene):
    model = build_mujoco_model(scene, RobotSettings(), SIM_DT)
    shot = film(np.arange(3) * 0.02, np.zeros((3, 7)), 25, 15.0)
    with pytest.raises(BadInput, match="19"):
        render_shot(model, shot, SMALL, list)


def test_a_failing_encoder_leaves_no_file(tmp_path):
    path = tmp_path / "odd.mp4"
    frames = iter([np.zeros((91, 121, 3), np.uint8)] * 3)  # H.264 with halved colour planes needs even sizes
    with pytest.raises(OSError, match=r"odd\.mp4"):
        write_mp4(path, frames, 25)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("module", "absent"),
    [
        ("agile_jax.report", ("jax", "matplotlib", "mujoco", "PIL")),
        ("agile_jax.report.video.opengl", ("jax", "matplotlib")),
    ],
)
def test_heavy_libraries_are_loaded_only_where_needed(module, absent):
    code = f"import sys, {module}; print([name for name in {absent!r} if name in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
