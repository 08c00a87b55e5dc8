"""Closed forms against simulated bang-bang motion and a linear program; route bounds against solved routes."""

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, lower_bound, minimum_time
from agile_jax.expert.problem import Problem
from agile_jax.expert.search.minimum_time import route_bounds, turning_legs
from agile_jax.scene import SceneSettings, make_scene


@pytest.mark.parametrize(("v", "a"), [(0.8, 1.5), (0.3, 1.0), (1.0, 3.0)])
def test_distance_covered_in_the_minimum_time(v, a):
    """Integrating the fastest speed profile over the claimed time covers the distance."""
    for distance in (1e-4, 0.01, 0.1, 0.5, 3.0):
        total = float(minimum_time(distance, v, a))
        t = np.linspace(0, total, 200_001)
        assert np.trapezoid(np.minimum(v, a * np.minimum(t, total - t)), t) == pytest.approx(distance, rel=1e-6)
        total = float(minimum_time(distance, v, a, "free"))
        t = np.linspace(0, total, 200_001)
        assert np.trapezoid(np.minimum(v, a * (total - t)), t) == pytest.approx(distance, rel=1e-6)


def test_lower_bound_is_the_slowest_axis():
    settings = ExpertSettings(velocity=(0.8, 0.5, 0.3, 1.0), acceleration=(1.5, 1.5, 1.0, 3.0))
    start, target = np.array([0.0, 0.1, 0.2, 0.1]), np.array([3.0, 0.0, 0.28, 0.0])
    assert lower_bound(start, target, settings, "rest") == pytest.approx(3 / 0.8 + 0.8 / 1.5)
    assert lower_bound(start, target, settings, "free") == pytest.approx(3 / 0.8 + 0.4 / 1.5)
    assert lower_bound(target, target, settings, "rest") == 0


@pytest.mark.parametrize(
    ("points", "legs"),
    [([0.0, 1.0, 2.0, 2.0, 1.0], [2, 1]), ([0.0, 0.0, 0.0], []), ([1.0, 0.0, 0.0, 3.0], [1, 3]), ([0.5, 0.2], [0.3])],
)
def test_turning_legs(points, legs):
    assert turning_legs(points) == pytest.approx(legs)


def test_route_bound_of_a_detour_counts_both_legs():
    settings = ExpertSettings(velocity=(0.8, 0.5, 0.3, 1.0), acceleration=(1.5, 1.5, 1.0, 3.0))
    start, target = np.zeros(4), np.array([0.1, 0.0, 0.0, 0.0])
    gate = ([-9.0, 1.0, -9.0, -9.0], [9.0, 9.0, 9.0, 9.0])
    scene = make_scene(SceneSettings())
    problem = Problem(scene._replace(target=target), start, "rest", settings)
    duration, objective = route_bounds(problem, [gate])
    assert duration == pytest.approx(2 * (1 / 0.5 + 0.5 / 1.5))
    # At rest at both ends and in between: the effort of two equal legs is at least 2 * 12 d^2 / (T/2)^3 / a^2.
    assert objective >= duration + settings.effort_weight * 2 * 12 / (duration / 2) ** 3 / 1.5**2
    # Arriving slowly on one axis and leaving slowly on another adds up.
    gates = [([1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0])]
    other = problem._replace(scene=scene._replace(target=np.array([1.0, 1.0, 0, 0])))
    duration, _ = route_bounds(other, gates)
    assert duration == pytest.approx((1 / 0.8 + 0.4 / 1.5) + (1 / 0.5 + 0.25 / 1.5))


def test_bounds_stay_below_solved_routes_and_pruning_loses_nothing(expert, scene, settings):
    from agile_jax.expert.programs.initial_guess import make_inputs
    from agile_jax.expert.programs.layout import Phase
    from agile_jax.expert.programs.program import solve_program
    from agile_jax.expert.programs.transcription import build_program
    from agile_jax.expert.search.routes import RouteSearch
    from agile_jax.expert.space.regions import make_free_space, planning_margin

    start = np.array([0.6, 0.45, 0.27, 0.2])
    programs, solved = {}, 0
    for condition in ("rest", "free"):
        least = np.inf
        problem = Problem(scene, start, condition, settings)
        for route in RouteSearch(make_free_space(problem), problem).routes():
            phases = len(route.regions)
            if phases > 3:
                continue
            program = programs.setdefault(
                (phases, condition), build_program([Phase(False, 0)] * phases, condition == "rest", settings)
            )
            inputs = make_inputs(problem, route, planning_margin(settings), program, settings.effort_weight)
            trajectory, objective, success, *_ = solve_program(program, inputs)
            assert success
            assert route.duration_bound <= trajectory.times[-1] + 1e-6
            assert route.objective_bound <= objective + 1e-6
            least = min(least, objective)
            solved += 1
        best = expert.solve(start, condition)
        assert best.objective <= least * (1 + 5e-4)
        assert len(best.routes) < solved
    assert solved >= 6
