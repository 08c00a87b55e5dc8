"""The fast path: grids, closed-form profiles, axis programs against a second solver, agreement with the program."""

import casadi as ca
import numpy as np
import pytest
from motion import largest_difference

from agile_jax.expert import ExpertSettings, make_expert, minimum_time
from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.axis_program import AxisSolver, Bounds, least_effort, make_axis_grid, solve_axes
from agile_jax.expert.search.effort_bound import effort_bound
from agile_jax.expert.search.profile import make_grid, slowest_axis
from agile_jax.scene import SceneSettings, clearance, make_scene


@pytest.mark.parametrize("condition", ["rest", "free"])
def test_profile_is_the_fastest_motion(condition):
    settings = ExpertSettings()
    open_field, generator = make_scene(SceneSettings()), np.random.default_rng(0)
    for _ in range(50):
        start, target = generator.uniform(-1.5, 1.5, (2, 4))
        profile = slowest_axis(Problem(open_field._replace(target=target), start, condition, settings))
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


def _full_program(times, condition, first, last, velocity, acceleration, lower, upper, solver, options):
    """The program of an axis in positions, rates and controls, with every bound, by another solver; None when it finds
    nothing."""
    intervals = len(times) - 1
    opti, h = ca.Opti("conic"), np.diff(times)
    p, v, u = opti.variable(intervals + 1), opti.variable(intervals + 1), opti.variable(intervals)
    for k in range(intervals):
        opti.subject_to(p[k + 1] == p[k] + h[k] * v[k] + h[k] ** 2 / 2 * u[k])
        opti.subject_to(v[k + 1] == v[k] + h[k] * u[k])
    opti.subject_to([p[0] == first, p[-1] == last, v[-1] == 0])
    if condition == "rest":
        opti.subject_to(v[0] == 0)
    opti.subject_to(opti.bounded(-velocity, v, velocity))
    opti.subject_to(opti.bounded(-acceleration, u, acceleration))
    opti.subject_to(opti.bounded(lower[1:], p[1:], upper[1:]))
    opti.minimize(ca.dot(h, u**2))
    opti.solver(solver, options)
    try:
        return np.array(opti.solve().value(u))
    except RuntimeError:
        return None


@pytest.mark.parametrize("condition", ["rest", "free"])
def test_axis_program_against_another_solver(condition):
    """HiGHS on the sparse program agrees in the controls; DAQP on the condensed program with all rows agrees to 1e-9 in
    the effort, whether bounds are active or not."""
    generator = np.random.default_rng(1)
    solver, feasible, bounded = AxisSolver(30, condition == "rest"), 0, 0
    for trial in range(24):
        times = np.append(0.0, np.cumsum(generator.uniform(0.02, 0.08, 30)))
        first, last = generator.uniform(-0.1, 0.1, 2)
        lower, upper = np.full(31, -0.3), np.full(31, 0.3)
        upper[11:21] = generator.uniform(-0.2, 0.3)
        velocity, acceleration = generator.uniform(0.2, 0.6), generator.uniform(0.8, 2.0)
        grid = make_axis_grid(times)
        bounds = Bounds(np.array([velocity]), np.array([acceleration]), lower[:, None], upper[:, None])
        ours = solve_axes(grid, solver, np.array([first]), np.array([last]), bounds)
        solver.load(grid)
        exact = solver.solve(first, last, bounds)
        if trial < 12:
            options = {"highs": {"output_flag": False}}
            expected = _full_program(
                times, condition, first, last, velocity, acceleration, lower, upper, "highs", options
            )
            assert (expected is None) == (ours is None)
            if expected is not None:
                np.testing.assert_allclose(ours.controls[:, 0], expected, atol=2e-4)
        if ours is None:
            continue
        effort = grid.steps @ ours.controls[:, 0] ** 2
        assert effort == pytest.approx(grid.steps @ exact**2, rel=1e-9)
        assert ours.positions[[0, -1], 0] == pytest.approx([first, last], abs=1e-8)
        assert abs(ours.rates[-1, 0]) < 1e-8
        feasible += 1
        free = least_effort(grid, np.array([first]), np.array([last]), condition == "rest")
        bounded += not np.allclose(free, ours.controls)
        bound = effort_bound(
            *np.array([[[first]], [[last]]]),
            times[-1],
            [times[k : k + 1] for k in (5, 11, 20)],
            [lower[k : k + 1, None] for k in (5, 11, 20)],
            [upper[k : k + 1, None] for k in (5, 11, 20)],
            condition == "rest",
        )
        assert bound[0, 0] <= effort * (1 + 1e-9)
    assert feasible >= 8
    assert 3 <= bounded < feasible


@pytest.mark.parametrize("condition", ["rest", "free"])
def test_effort_bound_is_the_effort_where_nothing_else_binds(condition):
    """A fine grid, gates at two of its nodes and otherwise loose bounds: the beam's energy is the program's optimum."""
    times = np.linspace(0, 2.0, 201)
    lower, upper = np.full(201, -np.inf), np.full(201, np.inf)
    upper[60], lower[140] = -0.1, 0.2
    bounds = Bounds(np.array([50.0]), np.array([500.0]), lower[:, None], upper[:, None])
    motion = solve_axes(
        make_axis_grid(times), AxisSolver(200, condition == "rest"), np.zeros(1), np.array([0.1]), bounds
    )
    gates = [(times[k : k + 1], lower[k : k + 1, None], upper[k : k + 1, None]) for k in (60, 140)]
    bound = effort_bound(np.zeros((1, 1)), np.full((1, 1), 0.1), 2.0, *zip(*gates, strict=True), condition == "rest")
    effort = np.diff(times) @ motion.controls[:, 0] ** 2
    assert bound[0, 0] == pytest.approx(effort, rel=1e-2)  # after a few sweeps
    assert bound[0, 0] <= effort


@pytest.fixture(scope="module")
def pair(scene):
    """The expert, and the general program alone, for the same free space."""
    return make_expert(scene, ExpertSettings()), make_expert(scene, ExpertSettings(method="general", edges="square"))


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


def test_a_crossing_off_the_slowest_axis_is_searched_for(pair):
    """Entering from beside the table: when the plane y = const is crossed does not follow from x."""
    fast, general = (expert.solve([0.49, 1.12, 0.30, 0.0], "rest") for expert in pair)
    assert fast.method == "certified"
    assert (fast.branch, general.branch) == ("under", "under")
    assert general.duration == pytest.approx(fast.duration, rel=1e-4)
    assert fast.objective <= general.objective + 1e-6
    # The general program takes the route with fewer such crossings while it is no worse than this.
    assert fast.objective >= general.objective * (1 - 5e-4)


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


def _wide_start(generator):
    return generator.uniform([-0.8, -1.3, 0.16, -0.6], [3.2, 1.3, 0.31, 0.6])


def _agreement(scene, pair, count):
    """Of random starts turned by up to 0.6 rad: relative difference of durations and difference of objectives, of the
    fast path against the general program, where the fast path answers."""
    fast, general = pair
    generator = np.random.default_rng(3)
    found = []
    while len(found) < count:
        start = _wide_start(generator)
        if clearance(scene, start) < 0.03:
            continue
        ours = fast.solve(start, "free")
        assert ours.status == "solved", ours.cause
        if ours.method == "certified":
            theirs = general.solve(start, "free")
            assert theirs.status == "solved", theirs.cause
            found.append((ours.duration / theirs.duration - 1, ours.objective - theirs.objective))
    return np.array(found).T


def test_agrees_with_the_general_program_from_turned_starts(scene, pair):
    """The fast path covers the footprint by a box over all yaws, the general program has that of the yaw at hand."""
    durations, objectives = _agreement(scene, pair, 6)
    assert np.abs(durations).max() < 1e-4
    assert objectives.max() < 2e-3


@pytest.mark.slow
def test_agrees_with_the_general_program_from_two_hundred_turned_starts(scene, pair):
    durations, objectives = _agreement(scene, pair, 200)
    print(f"durations {durations.min():.1e} ... {durations.max():.1e}")
    print("objectives", np.quantile(objectives, [0, 0.05, 0.5, 0.95, 1]))
    assert np.abs(durations).max() < 1e-4
    assert objectives.max() < 2e-3


def test_end_controls_of_zero_are_certified_too(scene):
    """An interval of rest at both ends: the time is N / (N - 2) of that without. One phase of the general program
    agrees with it; in several phases its end intervals are of its first and last phase's mean length."""
    settings = ExpertSettings(zero_end_controls=True, nodes=60)
    fast, general = (make_expert(scene, settings.model_copy(update={"method": m})) for m in ("auto", "general"))
    plain = make_expert(scene, ExpertSettings(nodes=60))
    for start, tolerance in (([2.5, 0.4, 0.26, 0.0], 1e-4), ([0.0, 0.0, 0.28, 0.0], 1e-2)):
        ours, theirs = fast.solve(start), general.solve(start)
        assert (ours.method, theirs.method) == ("certified", "fatrop")
        assert ours.duration == pytest.approx(plain.solve(start).lower_bound * 60 / 58)
        assert ours.duration == pytest.approx(theirs.duration, rel=tolerance)
        assert not ours.trajectory.controls[[0, -1]].any()
        assert np.diff(ours.trajectory.times)[[0, -1]] == pytest.approx(ours.duration / 60)
