"""The fast path: grids, closed-form profiles, axis programs against a second solver, agreement with the program."""

import casadi as ca
import numpy as np
import pytest
from motion import largest_difference

from agile_jax.expert import ExpertSettings, make_expert, minimum_time
from agile_jax.expert.axis_program import AxisSolver, make_axis_grid, solve_axis
from agile_jax.expert.profile import make_grid, slowest_axis
from agile_jax.scene import SceneSettings, make_scene


@pytest.mark.parametrize("condition", ["rest", "free"])
def test_profile_is_the_fastest_motion(condition):
    settings = ExpertSettings()
    generator = np.random.default_rng(0)
    for _ in range(50):
        start, target = generator.uniform(-1.5, 1.5, (2, 4))
        profile = slowest_axis(start, target, settings, condition)
        times = make_grid(profile.switches, profile.duration, 40)
        position, rate, control = profile.states(times)
        h = np.diff(times)
        np.testing.assert_allclose(np.diff(rate), h * control, atol=1e-12)
        np.testing.assert_allclose(np.diff(position), h * rate[:-1] + h**2 / 2 * control, atol=1e-12)
        assert position[[0, -1]] == pytest.approx([start[profile.axis], target[profile.axis]], abs=1e-12)
        assert abs(rate[-1]) < 1e-12
        assert condition == "free" or abs(rate[0]) < 1e-12
        assert np.abs(rate).max() <= settings.velocity[profile.axis] + 1e-12
        for k in (0, 7, 20, 40):
            assert profile.time_at(position[k]) == pytest.approx(times[k], abs=1e-7)


def test_grids_hold_their_breaks_and_are_even_otherwise():
    grid = make_grid([0.31, 1.9, 0.3100000000001, -1.0, 5.0], 2.0, 20)
    assert len(grid) == 21
    for point in (0.0, 0.31, 1.9, 2.0):
        assert np.abs(grid - point).min() < 1e-12
    assert np.diff(grid).max() < 2 * 2.0 / 20
    assert make_grid([0.1, 0.2, 0.3], 1.0, 3) is None
    assert len(make_grid([0.1, 0.2], 1.0, 3)) == 4


@pytest.mark.parametrize("condition", ["rest", "free"])
def test_axis_program_against_another_solver(condition):
    generator = np.random.default_rng(1)
    solver, feasible = AxisSolver(30, condition), 0
    for _ in range(12):
        times = np.append(0.0, np.cumsum(generator.uniform(0.02, 0.08, 30)))
        first, last = generator.uniform(-0.1, 0.1, 2)
        lower, upper = np.full(30, -0.3), np.full(30, 0.3)
        upper[10:20] = generator.uniform(-0.2, 0.0)
        velocity, acceleration = generator.uniform(0.2, 0.6), generator.uniform(0.8, 2.0)
        opti, h = ca.Opti("conic"), np.diff(times)
        p, v, u = opti.variable(31), opti.variable(31), opti.variable(30)
        for k in range(30):
            opti.subject_to(p[k + 1] == p[k] + h[k] * v[k] + h[k] ** 2 / 2 * u[k])
            opti.subject_to(v[k + 1] == v[k] + h[k] * u[k])
        opti.subject_to([p[0] == first, p[-1] == last, v[-1] == 0])
        if condition == "rest":
            opti.subject_to(v[0] == 0)
        opti.subject_to(opti.bounded(-velocity, v, velocity))
        opti.subject_to(opti.bounded(-acceleration, u, acceleration))
        opti.subject_to(opti.bounded(lower, p[1:], upper))
        opti.minimize(ca.dot(h, u**2))
        opti.solver("highs", {"highs": {"output_flag": False}})
        grid = make_axis_grid(times, condition)
        solver.load(grid)
        ours = solve_axis(grid, solver, (first, last), velocity, acceleration, lower, upper)
        try:
            expected = opti.solve().value(u)
        except RuntimeError:
            assert ours is None
            continue
        np.testing.assert_allclose(ours, expected, atol=2e-4)
        feasible += 1
    assert feasible >= 4


@pytest.fixture(scope="module")
def pair(scene):
    """The expert, and the general program alone."""
    return make_expert(scene, ExpertSettings()), make_expert(scene, ExpertSettings(method="general"))


@pytest.mark.parametrize(
    ("start", "condition", "branch"),
    [
        ([0.0, 0.0, 0.28, 0.0], "rest", "under"),
        ([0.4, -0.4, 0.25, 0.0], "free", "under"),
        ([0.3, 0.5, 0.30, 0.0], "free", "under"),
        ([2.5, 0.4, 0.26, 0.0], "rest", "direct"),
        ([1.3, 1.3, 0.28, 0.0], "free", "left"),
        ([2.9, 0.0, 0.2, 0.5], "free", "direct"),
    ],
)
def test_agrees_with_the_general_program(pair, start, condition, branch):
    fast, general = (expert.solve(start, condition) for expert in pair)
    assert fast.method == "certified"
    assert general.method == "fatrop"
    assert fast.branch == general.branch == branch
    assert abs(fast.gap) < 1e-9
    assert general.duration == pytest.approx(fast.duration, rel=1e-4)
    assert fast.objective <= general.objective + 1e-6
    poses, rates = largest_difference(fast.trajectory, general.trajectory)
    assert poses < 1e-3
    assert rates < 5e-3


def test_a_boundary_off_the_slowest_axis_is_searched_for(pair):
    """Entering from beside the table: when the plane y = const is crossed does not follow from x."""
    fast, general = (expert.solve([0.49, 1.12, 0.30, 0.0], "rest") for expert in pair)
    assert fast.method == "certified"
    assert (fast.branch, general.branch) == ("under", "under")
    assert general.duration == pytest.approx(fast.duration, rel=1e-4)
    assert fast.objective <= general.objective + 1e-6
    assert fast.objective == pytest.approx(general.objective, rel=2e-4)


def _random_pairs(count, bounds, method, nodes=100):
    """Relative errors of the duration for random pairs, `bounds` sets of random bounds."""
    generator = np.random.default_rng(2)
    errors = []
    for _ in range(bounds):
        velocity, acceleration = generator.uniform(0.2, 2.0, 4), generator.uniform(0.3, 4.0, 4)
        settings = ExpertSettings(
            velocity=tuple(velocity), acceleration=tuple(acceleration), method=method, nodes=nodes
        )
        target = tuple(generator.uniform([-1, -1, 0.16, -1], [1, 1, 0.31, 1]))
        expert = make_expert(make_scene(SceneSettings(target=target)), settings)
        for k in range(count // bounds):
            start = generator.uniform([-1.4, -2.9, 0.156, -3], [4.4, 2.9, 0.319, 3])
            condition = ("rest", "free")[k % 2]
            solution = expert.solve(start, condition)
            assert solution.status == "solved", solution.cause
            moves = np.array(target) - start
            moves[3] = np.arctan2(np.sin(moves[3]), np.cos(moves[3]))  # the shorter turn
            analytic = minimum_time(moves, velocity, acceleration, condition).max()
            errors.append(abs(solution.duration / analytic - 1))
    return np.array(errors)


@pytest.mark.parametrize(("method", "count", "bounds"), [("auto", 100, 10), ("general", 12, 3)])
def test_free_space_attains_the_analytic_time(method, count, bounds):
    assert _random_pairs(count, bounds, method).max() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "general"])
def test_a_thousand_random_pairs_with_random_bounds(method):
    errors = _random_pairs(1000, 100, method)
    print(f"{method}: |T - T_analytic| / T: median {np.median(errors):.1e}, largest {errors.max():.1e}")
    assert len(errors) == 1000
    assert errors.max() < 1e-4
