"""Figures are written, show something, show it in its colour, and are the same when drawn again."""

import json
import pathlib
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from known_run import MOMENTS, SECONDS, known_trace
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from agile_jax.expert import Trajectory
from agile_jax.report import draw_plan, plan_figure, save_figure
from agile_jax.report.figures.episode_figures import episode_figure
from agile_jax.report.figures.evaluation_figures import (
    draw_outcomes,
    draw_success_map,
    qualities,
    qualities_figure,
)
from agile_jax.report.figures.kinematic_test_figures import arrivals_figure, error_map_figure, worst_paths_figure
from agile_jax.report.figures.learning_figures import (
    draw_learning_curve,
    draw_velocity_field_side,
    velocity_field_figure,
)
from agile_jax.report.figures.motions import timed_poses
from agile_jax.report.figures.scene_drawing import box_outline
from agile_jax.report.figures.style import BLUE, GREEN, RED, new_figure
from agile_jax.report.json_files import read_metrics
from agile_jax.report.reading import Outcomes, load_columns, load_kinematic_test
from agile_jax.report.under_obstacles import underside_above
from agile_jax.scene import SceneSettings, TableSettings, make_scene
from agile_jax.settings import BadInput


@pytest.fixture
def picture(tmp_path: pathlib.Path) -> Callable[..., pathlib.Path]:
    """Saves a figure, or what a function draws on the axes of a new one."""

    def make(drawn: Figure | Callable[..., Axes], *arguments: object) -> pathlib.Path:
        if not isinstance(drawn, Figure):
            ax = new_figure(7.0, 4.0).add_subplot()
            assert drawn(ax, *arguments) is ax
            drawn = ax.figure
        return save_figure(drawn, tmp_path / f"{len(list(tmp_path.glob('*.png')))}.png")

    return make


def count_pixels(path: pathlib.Path, color: str) -> int:
    """Pixels close to a colour."""
    wanted = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
    return int((np.abs(np.asarray(Image.open(path).convert("RGB")).astype(int) - wanted).max(2) < 12).sum())


def assert_shows_something(path: pathlib.Path) -> None:
    pixels = np.asarray(Image.open(path).convert("L"))
    assert pixels.shape[0] > 300
    assert pixels.shape[1] > 600
    assert 0.01 < (pixels < 200).mean() < 0.6
    assert len(np.unique(pixels)) > 20


def straight(height: float) -> Trajectory:
    states = np.zeros((51, 8))
    states[:, 0], states[:, 2] = np.linspace(0, 3, 51), height
    return Trajectory(np.linspace(0, 4, 51), states, np.zeros((50, 4)))


def test_a_plan_is_drawn_green_then_red_and_again_alike(picture, scene):
    one = picture(plan_figure(scene, {"under": straight(0.16)}))
    two = picture(plan_figure(scene, {"under": straight(0.16), "over": straight(0.28)}))
    assert_shows_something(two)
    assert count_pixels(one, GREEN) > 500
    assert count_pixels(one, RED) == 0
    assert count_pixels(two, RED) > 300
    assert picture(plan_figure(scene, {"under": straight(0.16)})).read_bytes() == one.read_bytes()


def test_one_view_is_drawn_of_a_trajectory_and_of_a_recorded_episode(picture, scene):
    """Both without a file between: what the expert returns, and what the physics recorded."""
    trace = known_trace(sideways=0.4)
    for motion in (straight(0.16), trace):
        assert count_pixels(picture(draw_plan, scene, motion, "side"), GREEN) > 300
    ax = draw_plan(new_figure(4.0, 4.0).add_subplot(), scene, {"plan": straight(0.16), "robot": trace})
    lines = {line.get_label(): line.get_xydata() for line in ax.lines}
    np.testing.assert_array_equal(lines["plan\n4.00 s"], straight(0.16).states[:, :2])
    np.testing.assert_array_equal(lines[f"robot\n{SECONDS:.2f} s"], trace.qpos[:, :2])


def test_a_recorded_yaw_is_read_from_the_quaternion():
    yaw = np.linspace(3.0, 3.4, MOMENTS)  # past half a turn, without a jump
    trace = known_trace()
    trace.qpos[:, 3:7] = np.stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)], -1)
    np.testing.assert_allclose(timed_poses(trace)[1][:, 3], yaw, atol=1e-12)


def test_figures_leave_the_state_of_pyplot_alone():
    code = "import sys, agile_jax.report as r; r.draw_plan, r.episode_figure; print('matplotlib.pyplot' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"


def test_silhouettes_of_a_turned_box():
    """A unit square turned by 45 degrees is sqrt(2) wide from every side."""
    center, half = np.array([1.0, 2.0, 0.3]), np.array([0.5, 0.5, 0.1])
    side = box_outline(center, half, np.pi / 4, "side")
    np.testing.assert_allclose([side.min(0), side.max(0)], [[1 - np.sqrt(0.5), 0.2], [1 + np.sqrt(0.5), 0.4]])
    front = box_outline(center, half, np.pi / 4, "front")
    np.testing.assert_allclose([front.min(0), front.max(0)], [[2 - np.sqrt(0.5), 0.2], [2 + np.sqrt(0.5), 0.4]])


def test_outcomes_are_counted_and_coloured(picture, scene):
    start = np.column_stack([np.linspace(0, 1, 40), np.linspace(-1, 1, 40), np.full(40, 0.26), np.zeros(40)])
    good = picture(draw_outcomes, scene, Outcomes(start, np.zeros(40, int)))
    bad = picture(draw_outcomes, scene, Outcomes(start, np.ones(40, int)))
    assert_shows_something(good)
    assert count_pixels(bad, RED) > 10 * max(1, count_pixels(good, RED))


def test_the_map_of_success_marks_the_cell_that_failed(picture, scene):
    x, y = np.meshgrid(np.linspace(0.01, 0.99, 21), np.linspace(-0.99, 0.99, 21))
    start = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.26), np.zeros(x.size)])
    bad = (np.hypot(x - 0.6, y - 0.1) < 0.1).ravel().astype(int)
    assert 0 < bad.sum() < 20
    paths = [picture(draw_success_map, scene, Outcomes(start, outcome)) for outcome in (np.zeros_like(bad), bad)]
    pictures = [np.asarray(Image.open(path).convert("RGB")).astype(int) for path in paths]
    redder = (pictures[1][..., 0] - pictures[1][..., 2]) > (pictures[0][..., 0] - pictures[0][..., 2]) + 40
    assert redder.sum() > 500


def test_qualities_are_those_of_the_columns(tmp_path, picture):
    columns = {
        "outcome": np.array([0, 0, 1]),
        "arrival_time": np.array([2.0, 3.0, np.nan]),
        "expert_arrival_time": np.array([2.0, 2.4, 3.0]),  # at the same tolerance
        "min_clearance": np.array([0.01, np.inf, -0.001]),
        "work": np.array([981.0, 0.0, 5.0]),
        "distance": np.array([2.0, 1.0, 0.0]),
    }
    np.savez(tmp_path / "some.npz", **columns)
    read = qualities(load_columns(tmp_path / "some.npz"), mass=10.0)
    found = {quality.label: quality.values for quality in read}
    assert list(found) == [
        "arrival time over the expert's",
        "least clearance of the robot [mm]",
        "cost of transport",
    ]
    np.testing.assert_allclose(found["arrival time over the expert's"], [1.0, 1.25])
    np.testing.assert_allclose(found["least clearance of the robot [mm]"], [10.0, -1.0])
    np.testing.assert_allclose(found["cost of transport"], [5.0, 0.0])
    assert_shows_something(picture(qualities_figure(read)))
    assert qualities({}, mass=10.0) == []


@pytest.mark.parametrize("clear", [True, False])
def test_an_episode_over_time(picture, scene, clear):
    trace = known_trace()
    distance = np.full(MOMENTS, np.inf) if clear else trace.clearance
    path = picture(episode_figure(scene, trace._replace(clearance=distance), np.full(12, 33.5)))
    assert_shows_something(path)
    assert count_pixels(path, BLUE) > 500


def test_an_episode_of_one_moment(picture, scene):
    trace = type(known_trace())(*(values[:1] for values in known_trace()))
    unknown = trace._replace(clearance=np.array([np.nan]))
    assert_shows_something(picture(episode_figure(scene, unknown, np.full(12, 33.5))))


def test_learning_curve(picture):
    rows: list[dict[str, object]] = [
        {"epoch": e, "train_mse": 0.1 / (e + 1), "validation_mse": 0.12 / (e + 1)} for e in range(60)
    ]
    rows[7]["train_mse"] = float("nan")
    path = picture(draw_learning_curve, rows, 0.002)
    pixels = np.asarray(Image.open(path).convert("L"))
    assert (pixels < 200).mean() > 0.005
    assert count_pixels(path, BLUE) > 500


def test_a_torn_last_line_is_left_out_and_another_is_refused(tmp_path):
    path = tmp_path / "metrics.jsonl"
    path.write_text(json.dumps({"epoch": 0}) + "\n" + '{"epo')
    assert read_metrics(path) == [{"epoch": 0}]
    path.write_text('{"epo\n' + json.dumps({"epoch": 0}) + "\n")
    with pytest.raises(BadInput, match="line 1"):
        read_metrics(path)


def test_velocity_field_is_not_drawn_inside_the_obstacle(picture, scene):
    seen = []

    def velocity(poses):
        seen.append(poses.copy())
        return np.tile([0.5, 0.1, 0.0, 0.0], (len(poses), 1))

    assert_shows_something(picture(velocity_field_figure(scene, velocity, {"nominal": 0.28, "crawl": 0.16})))
    assert {float(z) for poses in seen for z in poses[:, 2]} == {0.28, 0.16}


def test_velocity_field_from_the_side_covers_the_plane_of_the_target(picture, scene):
    seen = []

    def velocity(poses):
        seen.append(poses.copy())
        return np.tile([0.5, 0.1, 0.05, 0.0], (len(poses), 1))

    assert_shows_something(picture(draw_velocity_field_side, scene, velocity))
    (poses,) = seen
    assert (poses[:, [1, 3]] == scene.target[[1, 3]]).all()
    assert poses[:, 2].min() == scene.lower[2]
    assert poses[:, 2].max() == scene.upper[2]


def test_kinematic_test_figures_show_failures_and_worst_paths(tmp_path, picture, scene):
    generator = np.random.default_rng(0)
    starts = generator.uniform([-0.5, -1, 0.2, -0.1], [0.5, 1, 0.3, 0.1], (60, 4))
    arrival = np.append(np.full(58, 3.1), [np.inf, np.inf])
    columns = {
        "start": starts,
        "expert_time": np.append(np.full(59, 3.0), np.nan),
        "arrival_time": arrival,
        "outcome": np.append(np.zeros(58, np.int8), [1, 3]).astype(np.int8),
        "min_clearance": generator.random(60),
        "worst": np.array([58, 59, 3]),
        "worst_poses": starts[[58, 59, 3], None] + generator.random((3, 50, 4)).cumsum(1) * 0.02,
    }
    np.savez(tmp_path / "test.npz", **columns)
    found = load_kinematic_test(tmp_path / "test.npz")
    np.testing.assert_allclose(found.ratio[:58], 3.1 / 3)
    assert_shows_something(picture(arrivals_figure(scene, found)))
    assert_shows_something(picture(worst_paths_figure(scene, found)))
    above = worst_paths_figure(scene, found).axes[0]
    for drawn, limits in ((found.worst_poses[..., 0], above.get_xlim()), (found.worst_poses[..., 1], above.get_ylim())):
        assert limits[0] < drawn.min()  # nothing is cut off
        assert drawn.max() < limits[1]
    errors = generator.random(60) * 1e-3
    assert_shows_something(picture(error_map_figure(scene, starts, errors)))


def test_the_underside_is_known_where_the_table_is():
    table = TableSettings(kind="table", position=(1.0, 2.0), size=(1.0, 0.2), underside=0.25, yaw=float(np.pi / 2))
    scene = make_scene(SceneSettings(obstacles=(table,)))
    # turned by 90 degrees the table reaches 0.1 m along x and 0.5 m along y
    positions = np.array([[1.05, 2.4, 0.2], [1.4, 2.05, 0.2], [1.05, 2.4, 0.3]])
    np.testing.assert_array_equal(underside_above(scene, positions), [0.25, np.nan, np.nan])
