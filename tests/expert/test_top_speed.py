"""Paths under a top speed by height: analytic times, monotonicity, symmetry, and the bound at all times."""

from math import comb

import numpy as np
import pytest
from motion import state_at

from agile_jax.expert import ExpertSettings, lowest_underside, make_expert, minimum_time, verify
from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.schemes import control_points, rate_points
from agile_jax.expert.search.routes import RouteSearch
from agile_jax.expert.space.regions import ROUNDING_ERRORS, make_free_space
from agile_jax.scene import SceneSettings, make_scene

HEIGHTS, SPEEDS = (0.115, 0.12, 0.13, 0.14, 0.15, 0.16, 0.18), (0.46, 0.52, 0.64, 0.78, 0.93, 1.1, 1.47)
SETTINGS = ExpertSettings(nodes=40)
START = np.array([0.3, 0.1, 0.26, 0.0])
TUNNEL = {"lower": (-1.5, -0.4, 0.0, -3.2), "upper": (4.5, 0.4, 0.32, 3.2)}  # the table is as wide as the world


def crouching(underside, speeds=SPEEDS, size=(0.5, 1.0), lowest=0.115, **world):
    table = {"kind": "table", "position": [1.5, 0.0], "size": list(size), "underside": underside}
    crouch = {"by": "hand", "lowest": lowest, "heights": HEIGHTS if speeds else (), "speeds": speeds}
    return make_scene(SceneSettings(obstacles=[table], crouch=crouch, **world))


def allowed(heights):
    """The top speed, by the numbers."""
    return np.interp(heights, HEIGHTS, SPEEDS)


def solved(scene, start=START, settings=SETTINGS, condition="rest"):
    solution = make_expert(scene, settings).solve(start, condition)
    assert solution.status == "solved", solution.cause
    return solution


@pytest.fixture(scope="module")
def low():
    return solved(crouching(0.22, **TUNNEL))


@pytest.mark.parametrize("height", [0.12, 0.137])
@pytest.mark.parametrize("condition", ["rest", "free"])
def test_at_one_height_it_is_the_motion_at_the_top_speed_there(height, condition):
    world = {"lower": (-1.5, -0.4, height, -3.2), "upper": (4.5, 0.4, height + 2e-4, 3.2)}
    scene = crouching(0.24, size=(5.0, 1.0), target=(3.0, 0.0, height + 1e-4, 0.0), **world)
    solution = solved(scene, [0.5, 0.0, height + 1e-4, 0.0], ExpertSettings(), condition)
    least, most = (float(minimum_time(2.5, allowed(height + room), 1.5, condition)) for room in (2e-4, 0.0))
    assert solution.branch == "under"
    assert least <= solution.duration <= most * 1.001


def test_a_low_table_costs_what_its_length_takes_at_the_top_speed():
    """Half a metre more takes half a metre over the top speed at the greatest height below it."""
    start, settings = np.array([-0.8, 0.0, 0.26, 0.0]), ExpertSettings()
    short, long = (solved(crouching(0.22, size=(size, 1.0), **TUNNEL), start, settings) for size in (0.4, 0.9))
    height = 0.22 - 0.058 - SETTINGS.clearance_margin
    assert (short.branch, long.branch) == ("under", "under")
    assert long.duration - short.duration == pytest.approx(0.5 / allowed(height) - 0.5, rel=0.02)


@pytest.mark.parametrize(("transcription", "condition"), [("zoh", "rest"), ("zoh", "free"), ("foh", "rest")])
def test_no_rate_exceeds_the_top_speed_at_its_height(transcription, condition):
    scene = crouching(0.21, **TUNNEL)
    settings = SETTINGS.model_copy(update={"transcription": transcription})
    solution = solved(scene, START, settings, condition)
    assert solution.bound_violation < 1e-6
    if transcription == "zoh":
        states = state_at(solution.trajectory, np.linspace(0, solution.duration, 4001))
        slack = allowed(states[:, 2])[:, None] - np.abs(states[:, 4:6])
        assert slack.min() > -1e-6
        assert slack.min() < 1e-3  # it is used up
        assert np.abs(states[:, 4]).max() > 0.99  # and elsewhere it runs


def test_the_check_knows_the_bound():
    scene = crouching(0.22, **TUNNEL)
    fast = solved(crouching(0.22, speeds=(), **TUNNEL))
    states = state_at(fast.trajectory, np.linspace(0, fast.duration, 4001))
    excess = (np.abs(states[:, 4:6]).max(1) - allowed(states[:, 2])).max()
    found = verify(scene, SETTINGS, fast.trajectory, START, "rest").bound_violation
    assert excess > 0.1
    assert found == pytest.approx(excess, abs=1e-3)


def test_a_lower_table_never_shortens_the_path():
    times = [solved(crouching(underside, **TUNNEL)).duration for underside in (0.25, 0.235, 0.225, 0.215, 0.205)]
    assert (np.diff(times) >= -1e-4).all()
    assert times[-1] > times[0] + 0.5


def test_faster_legs_never_lengthen_the_path(low):
    times = [
        solved(crouching(0.22, speeds=tuple(share * speed for speed in SPEEDS), **TUNNEL)).duration
        for share in (0.8, 1.25, 2.0)
    ]
    times.insert(1, low.duration)
    assert (np.diff(times) <= 1e-4).all()
    free = solved(crouching(0.22, speeds=(), **TUNNEL)).duration
    assert times[-1] >= free - 1e-4
    assert times[0] > free + 0.5


@pytest.mark.parametrize("start", [[0.0, 0.0, 0.28, 0.0], [0.941, 0.449, 0.262, 0.0], [1.6, 0.2, 0.158, 0.4]])
@pytest.mark.parametrize("condition", ["rest", "free"])
def test_labels_do_not_change_where_the_legs_are_fast_enough(start, condition):
    """Above 0.155 m they are as fast as the velocity's bound."""
    free, fast = crouching(0.25, speeds=(), lowest=0.155), crouching(0.25, lowest=0.155)
    before, after = (make_expert(scene, SETTINGS).solve(start, condition) for scene in (free, fast))
    for a, b in zip(before.trajectory, after.trajectory, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_closed_form_is_kept_where_it_is_fast_enough_and_high_enough():
    solution = solved(crouching(0.25), [0.0, 0.0, 0.28, 0.0])
    assert solution.method == "certified"
    states = state_at(solution.trajectory, np.linspace(0, solution.duration, 4001))
    assert (np.abs(states[:, 4:6]) <= allowed(states[:, 2])[:, None] + 1e-6).all()


def test_mirrored_starts_have_mirrored_paths():
    scene, mirror = crouching(0.22), np.array([1, -1, 1, -1] * 2)
    one, other = solved(scene, [0.4, 0.3, 0.26, 0.2]), solved(scene, [0.4, -0.3, 0.26, -0.2])
    assert one.duration == pytest.approx(other.duration, rel=1e-5)
    t = np.linspace(0, min(one.duration, other.duration), 200)
    np.testing.assert_allclose(state_at(one.trajectory, t), state_at(other.trajectory, t) * mirror, atol=5e-3)


def test_a_label_does_not_depend_on_the_guess():
    expert, start = make_expert(crouching(0.215, **TUNNEL), SETTINGS), START
    found = [expert.solve(start, guess=guess).objective for guess in (0, 1, 2)]
    found.append(expert.solve(start, first_attempt="ipopt").objective)
    np.testing.assert_allclose(found, found[0], rtol=3e-4)


@pytest.mark.parametrize(("above", "branch"), [(0.002, "under"), (-0.001, "right")])
def test_what_is_too_low_is_gone_round(above, branch):
    """The robot walks down to 0.115 m. Fast legs: what is passable decides, not what is faster."""
    fast = tuple(9 * speed for speed in SPEEDS)
    lowest = lowest_underside(crouching(0.25, fast), SETTINGS)
    assert lowest == pytest.approx(0.115 + 0.058 + 0.025)
    solution = solved(crouching(lowest + above, fast), [0.3, -0.2, 0.2, 0.0])
    assert solution.branch == branch


def test_routes_are_never_longer_than_their_bounds_say(low):
    scene = crouching(0.22, **TUNNEL)
    problem = Problem(scene, START, "rest", SETTINGS)
    bounds = [
        [route.duration_bound for route in RouteSearch(make_free_space(of, False, ROUNDING_ERRORS), of).routes()]
        for of in (problem, problem._replace(scene=crouching(0.22, speeds=(), **TUNNEL)))
    ]
    assert min(bounds[1]) < min(bounds[0]) <= low.duration + 1e-6


@pytest.mark.parametrize("scheme", ["zoh", "foh", "trapezoidal"])
def test_the_rates_coefficients_are_the_derivative_of_the_poses(scheme):
    """Both of one degree, so that a line in pose and rate holds on all of an interval when it does on all of them."""
    pose, rate, h, u, u_next = np.random.default_rng(0).normal(size=5)
    poses = np.array([pose, *control_points(scheme, pose, rate, h, u, u_next)])
    rates = np.array([rate, *rate_points(scheme, rate, h, u, u_next)])
    degree, s = len(poses) - 1, np.linspace(0, 1, 11)[:, None]
    assert len(rates) == degree + 1

    def curve(points):
        i = np.arange(len(points))
        return (np.array([comb(len(points) - 1, k) for k in i]) * s**i * (1 - s) ** (len(points) - 1 - i)) @ points

    if scheme == "trapezoidal":  # it takes the rate for linear
        np.testing.assert_allclose(curve(rates), rate + s[:, 0] * h / 2 * (u + u_next), atol=1e-12)
    else:
        np.testing.assert_allclose(curve(rates), curve(degree * np.diff(poses)) / h, atol=1e-12)
