"""Obstacles at any yaw, turning robots, several obstacles, the plane, the norm bound, later attempts."""

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, check_start, compare_dimensions, make_expert, minimum_time
from agile_jax.expert.problem import Problem
from agile_jax.expert.search.routes import RouteSearch
from agile_jax.expert.space.footprint import footprint, footprint_range
from agile_jax.expert.space.polygons import clip, planar_separation
from agile_jax.expert.space.regions import make_free_space, regions_around
from agile_jax.geometry import rectangle_distance
from agile_jax.scene import SceneSettings, clearance, make_scene, planar_scene, sample_starts

TABLE = {"kind": "table", "position": [1.5, 0.0], "size": [0.5, 1.0], "underside": 0.25}
BOXES = [
    {"kind": "box", "position": [1.0, 0.4, 0.15], "size": [0.4, 0.4, 0.3], "yaw": 0.6},
    {"kind": "box", "position": [2.0, -0.4, 0.2], "size": [0.3, 0.6, 0.4], "yaw": -0.4},
]
SETTINGS = ExpertSettings(nodes=60)


def test_separation_is_the_distance_of_the_rectangles():
    generator = np.random.default_rng(0)
    compared = 0
    for _ in range(200):
        a, b = generator.uniform(-1, 1, (2, 2))
        half_a, half_b = generator.uniform(0.1, 0.5, (2, 2))
        yaw_a, yaw_b = generator.uniform(-3, 3, 2)
        distance = float(rectangle_distance(a, half_a, yaw_a, b, half_b, yaw_b))
        if distance > 0:
            vector = planar_separation(a, half_a, yaw_a, b, half_b, yaw_b)
            assert np.linalg.norm(vector) == pytest.approx(distance)
            # Moving the first rectangle back along it makes them touch.
            assert rectangle_distance(a - vector, half_a, yaw_a, b, half_b, yaw_b) == pytest.approx(0, abs=1e-9)
            compared += 1
    assert compared > 50


def test_clipping():
    square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    triangle = clip(square, (-1.0, -1.0), -0.5)
    x, y = np.array(triangle).T
    area = abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2
    assert area == pytest.approx(0.125)
    assert not clip(square, (1.0, 0.0), 1.5)
    assert clip(square, (1.0, 0.0), -1.0) == square


def test_footprint_range():
    half, generator = np.array([0.28, 0.155, 0.06]), np.random.default_rng(0)
    for _ in range(50):
        angle, (low, high) = generator.uniform(-3, 3), np.sort(generator.uniform(-3, 3, 2))
        yaw = np.linspace(low, high, 4001)
        support = half[0] * np.abs(np.cos(yaw - angle)) + half[1] * np.abs(np.sin(yaw - angle))
        normal = np.array([np.cos(angle), np.sin(angle), 0.0])
        expected = support.min(), support.max()
        np.testing.assert_allclose(footprint_range(half, normal, (low, high)), expected, atol=3e-4)
    assert footprint(half, (0.0, 0.0)) == pytest.approx(half[:2])


LEGS = {"size": [0.9, 1.1], "leg_size": [0.05, 0.08]}


@pytest.mark.parametrize(
    "obstacles",
    [
        [TABLE | {"yaw": 0.5}],
        [TABLE, *BOXES],
        [TABLE],
        [TABLE | LEGS],
        [TABLE | LEGS | {"yaw": 2.0, "leg_inset": 0.1}, BOXES[0]],
    ],
)
def test_every_free_pose_is_in_a_region_and_regions_are_free(obstacles):
    """Exact regions: what they hold keeps the margin, and every start that keeps it is held."""
    scene = make_scene(SceneSettings(obstacles=obstacles))
    generator = np.random.default_rng(1)
    free = 0
    for _ in range(150):
        pose = generator.uniform([0.3, -1.2, 0.156, -0.8], [2.7, 1.2, 0.319, 0.8])
        space = make_free_space(Problem(scene, pose, "rest", SETTINGS), exact=True)
        held = bool(regions_around(space, pose))
        assert held == bool(clearance(scene, pose) >= SETTINGS.clearance_margin + 5e-4)
        free += held
    assert free > 20


def test_turning_the_world_turns_the_label():
    """Two boxes and everything else turned by a right angle: the same durations."""
    base = SceneSettings(obstacles=BOXES, lower=(-4, -4, 0.155, -3.2), upper=(4, 4, 0.32, 3.2))
    turned = base.model_copy(
        update={
            "target": (0.0, 3.0, 0.28, np.pi / 2),
            "obstacles": tuple(
                box.model_copy(
                    update={
                        "position": (-box.position[1], box.position[0], box.position[2]),
                        "yaw": box.yaw + np.pi / 2,
                    }
                )
                for box in base.obstacles
            ),
        }
    )
    start = np.array([0.0, -0.2, 0.25, 0.3])
    one = make_expert(make_scene(base), SETTINGS).solve(start)
    settings = SETTINGS.model_copy(update={"velocity": (0.5, 1.0, 0.3, 1.0)})
    other = make_expert(make_scene(turned), settings).solve([0.2, 0.0, 0.25, 0.3 + np.pi / 2])
    assert one.status == other.status == "solved"
    assert other.duration == pytest.approx(one.duration, rel=1e-4)


@pytest.mark.parametrize("yaw", [0.5, -1.0])
def test_under_a_turned_table(yaw):
    scene = make_scene(SceneSettings(obstacles=[TABLE | {"yaw": yaw}]))
    expert = make_expert(scene, SETTINGS)
    for start in ([0.0, 0.0, 0.28, 0.0], [0.2, 0.3, 0.25, 0.6]):
        solution = expert.solve(start)
        assert solution.status == "solved", solution.cause
        assert solution.branch == "under"
        assert solution.clearance_violation == 0
        # It attains the bound up to 3 %, or the fast path's own bounding box would do.
        assert solution.gap < 0.03


def test_a_gap_that_bounding_boxes_close():
    """Two turned boxes with 7 cm more room in between than the torso and its margins need."""
    gap = [
        {"kind": "box", "position": [1.5, 0.75, 0.2], "size": [1.0, 0.4, 0.4], "yaw": 0.7},
        {"kind": "box", "position": [1.9, -0.38, 0.2], "size": [1.0, 0.4, 0.4], "yaw": 0.7},
    ]
    blocks = make_scene(SceneSettings(obstacles=gap, lower=(-1.5, -0.8, 0.155, -3.2), upper=(4.5, 1.2, 0.32, 3.2)))
    start = np.array([0.0, -0.2, 0.28, 0.0])
    problem = Problem(blocks, start, "rest", SETTINGS)
    assert not list(RouteSearch(make_free_space(problem), problem).routes())
    solution = make_expert(blocks, SETTINGS).solve(start)
    assert solution.status == "solved", solution.cause
    assert solution.method == "fatrop"
    assert solution.clearance_violation == 0
    assert solution.min_clearance < SETTINGS.clearance_margin + 0.07


def test_starts_close_beside_the_table_turned(scene):
    """The footprint over all yaws on the way touches the table; the pose itself keeps the margin."""
    expert = make_expert(scene, SETTINGS)
    solved = 0
    for y in (0.70, 0.72, 0.78):
        for yaw in (0.2, 0.5, 0.9, -0.7):
            start = np.array([1.3, y, 0.28, yaw])
            if clearance(scene, start) < SETTINGS.clearance_margin + 5e-4:
                continue
            check_start(scene, SETTINGS, start)
            solution = expert.solve(start)
            assert solution.status == "solved", solution.cause
            assert solution.clearance_violation == 0
            solved += 1
    assert solved >= 4


def test_the_plane_has_no_way_under_the_table(scene):
    flat = planar_scene(scene)
    for height in np.linspace(0.14, 0.32, 7):
        assert clearance(flat, np.array([1.5, 0.0, height, 0.0])) < 0
    assert clearance(scene, np.array([1.5, 0.0, 0.16, 0.0])) > 0
    solution = make_expert(scene, ExpertSettings(nodes=40, dimensions="2d")).solve([0.0, 0.0, 0.2, 0.0])
    assert solution.status == "solved"
    np.testing.assert_allclose(solution.trajectory.states[:, 2], 0.28, atol=1e-3)
    assert np.abs(solution.trajectory.states[:, 1]).max() > 0.5  # beside the table


def test_the_plane_loses_time_over_the_start_distribution(scene):
    settings = SceneSettings()
    mean, std = np.array(settings.start.mean), np.array(settings.start.std)
    starts = sample_starts(
        planar_scene(scene), np.array([*mean[:2], 0.28, 0.0]), np.array([*std[:2], 0.0, 0.0]), 12, 0.03, (0, 9)
    ).poses
    comparison = compare_dimensions(scene, SETTINGS, starts)
    assert np.isfinite(comparison.lost).all()
    assert (comparison.lost > -1e-4 * comparison.spatial).all()
    # Straight ahead the way around takes longer; a start well beside the table loses nothing.
    ahead = compare_dimensions(scene, SETTINGS, np.array([[0.6, 0.0, 0.25, 0.0], [1.5, 1.8, 0.28, 0.0]])).lost
    assert ahead[0] > 0.3
    assert abs(ahead[1]) < 1e-3


def test_norm_bound_of_the_planar_velocity():
    open_field = make_scene(SceneSettings())
    settings = ExpertSettings(velocity_bound="planar_norm", velocity=(0.8, 0.8, 0.3, 1.0))
    solution = make_expert(open_field, settings).solve([0.0, 2.0, 0.28, 0.0])
    assert solution.status == "solved", solution.cause
    speed = np.hypot(*solution.trajectory.states[:, 4:6].T)
    assert speed.max() == pytest.approx(0.8, abs=1e-5)
    # With the disk as bound the cruise takes the straight distance at 0.8 m/s; accelerations stay per axis.
    straight = float(np.hypot(3.0, 2.0))
    assert solution.duration > straight / 0.8 > solution.lower_bound
    assert solution.duration < straight / 0.8 + 0.8 / 1.5
    per_axis = make_expert(open_field, settings.model_copy(update={"velocity_bound": "axis"})).solve([0, 2.0, 0.28, 0])
    analytic = minimum_time(3.0, 0.8, 1.5)
    assert per_axis.duration == pytest.approx(float(analytic), rel=1e-4)


def test_later_attempts_rescue_what_the_first_cannot_do(scene, monkeypatch):
    """A first attempt with two iterations fails; the next one answers, and the label says so."""
    from agile_jax.expert.programs import transcription

    crippled = dict(transcription.SOLVERS)
    crippled["fatrop"] = ("fatrop", transcription.FATROP | {"max_iter": 2})
    monkeypatch.setattr(transcription, "SOLVERS", crippled)
    settings = ExpertSettings(nodes=40, method="general")
    rescued = make_expert(scene, settings).solve([0.0, 0.0, 0.28, 0.0])
    monkeypatch.undo()
    usual = make_expert(scene, settings).solve([0.0, 0.0, 0.28, 0.0])
    assert (rescued.method, usual.method) == ("fatrop-careful", "fatrop")
    assert rescued.duration == pytest.approx(usual.duration, rel=1e-5)


def test_labels_from_five_guesses_are_one(scene):
    """Starts whose least time exceeds the bound: the general program decides."""
    from motion import largest_difference

    expert = make_expert(scene, ExpertSettings())
    for start, condition in (
        ([0.86, 0.0, 0.31, 0.1], "free"),
        ([0.64, 0.36, 0.27, 0.45], "free"),
        ([0.92, -0.61, 0.26, 0.0], "rest"),
    ):
        first = expert.solve(start, condition)
        assert first.method == "fatrop"
        others = [expert.solve(start, condition, guess=g) for g in (1, 2, 3)]
        for other in (*others, expert.solve(start, condition, first_attempt="ipopt")):
            assert other.branch == first.branch
            poses, rates = largest_difference(first.trajectory, other.trajectory)
            assert poses < 1e-3
            assert rates < 5e-3
