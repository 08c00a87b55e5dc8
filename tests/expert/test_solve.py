"""The expert's labels: analytic optima, uniqueness, symmetry, routes, determinism."""

import inspect
import subprocess
import sys

import numpy as np
import pytest
from motion import largest_difference

from agile_jax.expert import ExpertSettings, check_start, make_expert, minimum_time, planning_margin
from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.initial_guess import make_inputs
from agile_jax.expert.programs.layout import Phase
from agile_jax.expert.programs.program import solve_program
from agile_jax.expert.programs.transcription import build_program
from agile_jax.expert.search.routes import RouteSearch
from agile_jax.expert.space.footprint import footprint
from agile_jax.expert.space.regions import make_free_space
from agile_jax.scene import SceneSettings, clearance, make_scene
from agile_jax.settings import BadInput

TABLE = {"kind": "table", "position": [1.5, 0.0], "size": [0.5, 1.0], "underside": 0.25}
PAPER_START = np.array([0.0, 0.0, 0.28, 0.0])


@pytest.fixture(scope="module")
def open_field():
    return make_scene(SceneSettings())


@pytest.mark.parametrize("condition", ["rest", "free"])
def test_free_space_matches_the_analytic_minimum(open_field, condition):
    settings = ExpertSettings()
    expert = make_expert(open_field, settings)
    generator = np.random.default_rng(0)
    starts = [*generator.uniform([-1.4, -2.9, 0.15, -3], [4.4, 2.9, 0.31, 3], (12, 4)), [2.8, 0.0, 0.28, 0.0]]
    for start in starts:
        solution = expert.solve(start, condition)
        times = minimum_time(
            open_field.target - start, np.array(settings.velocity), np.array(settings.acceleration), condition
        )
        assert solution.status == "solved", solution.cause
        assert solution.branch == "direct"
        assert solution.lower_bound == pytest.approx(times.max())
        assert -1e-7 <= solution.duration / times.max() - 1 <= 1e-3


def test_papers_start_goes_under_the_table(under, scene, settings):
    assert under.status == "solved", under.cause
    assert under.branch == "under"
    assert 0 <= under.gap < 1e-3
    assert under.clearance_violation == 0
    assert under.dynamics_residual < 1e-6
    beneath = np.abs(under.trajectory.states[:, 0] - 1.5) < 0.25 + scene.torso_half_size[0]
    assert beneath.any()
    assert (under.trajectory.states[beneath, 2] < 0.25 - scene.torso_half_size[2] - settings.clearance_margin).all()


def test_more_nodes_hardly_shorten_a_route_of_three_phases(under, scene):
    fine = make_expert(scene, ExpertSettings(nodes=400, effort_weight=1e-4)).solve(PAPER_START)
    assert fine.branch == "under"
    assert abs(under.duration / fine.duration - 1) < 1e-3


def test_low_table_is_passed_at_the_side_and_mirrored():
    scene = make_scene(SceneSettings(obstacles=[TABLE | {"underside": 0.17}]))
    expert = make_expert(scene, ExpertSettings())
    left, right = expert.solve([0.0, 0.3, 0.28, 0.2]), expert.solve([0.0, -0.3, 0.28, -0.2])
    assert (left.branch, right.branch) == ("left", "right")
    mirror = np.array([1, -1, 1, -1] * 2)
    assert left.duration == pytest.approx(right.duration, rel=1e-7)
    np.testing.assert_allclose(left.trajectory.states, right.trajectory.states * mirror, atol=1e-5)
    # In the middle both sides are equally good, and the order left, right decides.
    assert expert.solve([0.0, 0.0, 0.28, 0.0]).branch == "left"


def test_two_tables_in_a_row():
    scene = make_scene(SceneSettings(obstacles=[TABLE | {"position": [0.9, 0.0]}, TABLE | {"position": [2.0, 0.3]}]))
    solution = make_expert(scene, ExpertSettings(nodes=120)).solve([0.0, 0.0, 0.28, 0.0])
    assert solution.status == "solved", solution.cause
    assert solution.branch == "under"
    assert solution.clearance_violation == 0


@pytest.mark.parametrize("condition", ["rest", "free"])
def test_label_does_not_depend_on_guess_or_solver(scene, settings, condition):
    start = np.array([0.2, 0.35, 0.25, 0.0])
    problem = Problem(scene, start, condition, settings)
    route = next(RouteSearch(make_free_space(problem), problem).routes())
    found = []
    generator = np.random.default_rng(0)
    for solver in ("fatrop", "ipopt"):
        program = build_program([Phase(False, 0)] * len(route.regions), condition == "rest", settings, solver)
        inputs = make_inputs(problem, route, planning_margin(settings), program, settings.effort_weight)
        for trial in range(3):
            noise = 0.05 * trial * generator.standard_normal(inputs.guess.shape)
            guess = np.clip(inputs.guess + noise, inputs.lower, inputs.upper)
            trajectory, _, success, *_ = solve_program(program, inputs._replace(guess=guess))
            assert success
            found.append(trajectory)
    for other in found[1:]:
        poses, rates = largest_difference(found[0], other)
        assert poses < 1e-3  # [m]
        assert rates < 5e-3  # [m/s]


def test_labels_do_not_depend_on_what_was_solved_before(scene, settings, under):
    expert = make_expert(scene, settings)
    for start in ([0.5, 0.8, 0.27, 0.0], [3.5, 0.2, 0.2, 0.3], [1.5, 0.0, 0.15, 0.0]):
        expert.solve(np.array(start))
        expert.solve(np.array(start), "free")
    again = expert.solve(PAPER_START)
    for a, b in zip(again.trajectory, under.trajectory, strict=True):
        np.testing.assert_array_equal(a, b)


def test_free_initial_velocity_is_faster_and_within_bounds(expert, under, settings):
    free = expert.solve(PAPER_START, "free")
    assert free.status == "solved"
    assert free.duration < under.duration - 0.2
    assert np.abs(free.trajectory.states[0, 4]) == pytest.approx(settings.velocity[0], rel=1e-3)
    assert (np.abs(free.trajectory.states[:, 4:]) <= np.array(settings.velocity) + 1e-6).all()


def test_papers_end_controls_cost_two_intervals(open_field):
    settings = ExpertSettings(zero_end_controls=True)
    solution = make_expert(open_field, settings).solve([0.0, 0.0, 0.28, 0.0])
    assert solution.status == "solved"
    assert np.abs(solution.trajectory.controls[[0, -1]]).max() < 1e-9
    assert solution.duration / solution.lower_bound == pytest.approx(100 / 98, abs=1e-3)


def test_start_diagonally_off_an_edge_is_solved(expert, scene, settings):
    """Within the margin of front and underside on either axis, but far enough from the edge between them."""
    offset = 0.025
    x = 1.25 - scene.torso_half_size[0] - offset
    z = 0.25 - scene.torso_half_size[2] - offset
    start = np.array([x, 0.0, z, 0.0])
    assert clearance(scene, start) == pytest.approx(offset * 2**0.5)
    solution = expert.solve(start)
    assert solution.status == "solved", solution.cause
    assert solution.clearance_violation == 0


@pytest.mark.parametrize("beside", [2e-6, 1e-4, 4e-4])
def test_start_just_outside_the_margin_is_solved(expert, scene, settings, beside):
    start = np.array([1.3, 0.5 + 0.155 + settings.clearance_margin + beside, 0.25, 0.0])
    solution = expert.solve(start)
    assert solution.status == "solved"
    assert solution.min_clearance >= settings.clearance_margin


def test_hopeless_start_fails_with_its_cause(expert, settings):
    solution = expert.solve([1.5, 0.0, 0.3, 0.0])
    assert solution.status == "failed"
    assert solution.cause.startswith("no route")
    assert solution.trajectory.states.shape == (settings.nodes + 1, 8)
    assert not solution.trajectory.states.any()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"initial_velocity": "Rest"}, 'initial_velocity = \'Rest\': must be "rest" or "free"'),
        ({"first_attempt": "foo"}, "first_attempt = 'foo': must be one of fatrop, fatrop-careful, "),
        ({"start": [0.0, 0.0, 0.28]}, r"start = \[0.0, 0.0, 0.28\]: must be 4 finite numbers"),
        ({"start": [0.0, 0.0, np.nan, 0.0]}, "start = .*finite"),
        ({"start": "here"}, "start = 'here': must be 4 numbers"),
        ({"target": [np.inf, 0.0, 0.28, 0.0]}, "target = .*finite"),
    ],
)
def test_arguments_of_solve_are_checked(expert, arguments, words):
    solve = inspect.unwrap(type(expert).solve)  # without the check of types that these tests add
    with pytest.raises(BadInput, match=words):
        solve(expert, **{"start": PAPER_START} | arguments)


def test_a_solution_is_told_in_one_line(expert, under):
    assert repr(under) == f"ExpertSolution(solved: {under.duration:.3f} s, under, by certified)"
    assert repr(expert.solve([1.5, 0.0, 0.3, 0.0])).startswith("ExpertSolution(failed: no route")


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ([1.5, 0.0, 0.3, 0.0], "inside obstacle 0"),
        ([0.0, 9.0, 0.3, 0.0], r"start y = 9 m is outside its bounds \[-3, 3\]"),
        ([0.0, 0.0, 0.02, 0.0], "start z = 0.02 m is outside"),
        ([0.0, 0.0, float("nan"), 0.0], "finite"),
        ([1.5, 0.0, 0.175, 0.0], "at least 0.0255 m is needed"),
    ],
)
def test_bad_starts_are_refused(scene, settings, start, words):
    with pytest.raises(BadInput, match=words):
        check_start(scene, settings, np.array(start))


def test_target_within_the_margin_is_refused(settings):
    with pytest.raises(BadInput, match=r"target = .* 0.0255 m is needed"):
        make_expert(make_scene(SceneSettings(obstacles=[TABLE], target=(1.5, 0.0, 0.18, 0.0))), settings)


def test_good_start_is_accepted(scene, settings):
    check_start(scene, settings, PAPER_START)


def test_footprint_holds_the_rectangle_at_every_yaw():
    generator = np.random.default_rng(0)
    for _ in range(50):
        half, (low, high) = generator.uniform(0.1, 0.4, 2), np.sort(generator.uniform(-3.2, 3.2, 2))
        yaw = np.linspace(low, high, 2001)
        extent_x = half[0] * np.abs(np.cos(yaw)) + half[1] * np.abs(np.sin(yaw))
        extent_y = half[0] * np.abs(np.sin(yaw)) + half[1] * np.abs(np.cos(yaw))
        expected = np.array([extent_x.max(), extent_y.max()])
        np.testing.assert_allclose(footprint(half, (low, high)), expected, atol=1e-5)
        assert (footprint(half, (low, high)) >= expected - 1e-12).all()


def test_importing_expert_dataset_and_engine_loads_neither_jax_nor_casadi():
    code = (
        "import sys, agile_jax.expert, agile_jax.dataset, agile_jax.engine; "
        "print([m for m in ('jax', 'flax', 'casadi', 'mujoco') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_solving_loads_no_jax():
    code = (
        "import sys; from agile_jax.scene import *; from agile_jax.expert import *; "
        "make_expert(make_scene(SceneSettings()), ExpertSettings(nodes=20)).solve([0, 0, 0.28, 0]); "
        "print('jax' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"
