"""Several obstacles: labels against exhaustive enumeration, starts that nothing connects, regions made on demand."""

import itertools

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.certified import Task, make_axis_solver, solve_certified
from agile_jax.expert.search import routes
from agile_jax.expert.search.profile import slowest_axis
from agile_jax.expert.search.routes import RouteSearch
from agile_jax.expert.space.nearby_obstacles import first_met, first_obstacles, straight_path, with_obstacles
from agile_jax.expert.space.regions import make_free_space, make_region, regions_around
from agile_jax.expert.verify import dense_poses, least_clearance
from agile_jax.scene import SceneSettings, clearance, make_scene, obstacle_clearances

SETTINGS = ExpertSettings(nodes=60)
TABLE = {"kind": "table", "position": [1.5, 0.0], "size": [0.5, 1.0], "underside": 0.25}
THREE = [
    TABLE | {"position": [0.9, 0.4]},
    {"kind": "box", "position": [1.9, -0.3, 0.2], "size": [0.3, 0.5, 0.4]},
    {"kind": "box", "position": [1.4, 1.4, 0.2], "size": [0.4, 0.4, 0.4]},
]
WALLS = [
    {"kind": "box", "position": [3.0, 0.7, 0.3], "size": [1.6, 0.2, 0.6]},
    {"kind": "box", "position": [3.0, -0.7, 0.3], "size": [1.6, 0.2, 0.6]},
    {"kind": "box", "position": [2.3, 0.0, 0.3], "size": [0.2, 1.6, 0.6]},
    {"kind": "box", "position": [3.7, 0.0, 0.3], "size": [0.2, 1.6, 0.6]},
]


def _exhaustive(scene, start):
    """The least objective over every route among all obstacles, without bounds, order or an end to the search."""
    problem = Problem(scene, start, "rest", SETTINGS)
    profile, space = slowest_axis(problem), make_free_space(problem)
    solver = make_axis_solver(SETTINGS, True)
    regions = {}
    for choice in itertools.product(*(range(len(cells)) for cells in space.cells)):
        region = make_region(space, choice)
        if region is not None:
            regions[choice] = region
    efforts = []
    for route in itertools.islice(RouteSearch(space, problem).routes(), 3000):
        assert all(region.cells in regions for region in route.regions)
        found = solve_certified(Task(solver, problem, route, profile))
        if found is not None:
            efforts.append(found.effort)
    return profile.duration, min(efforts, default=np.inf)


@pytest.mark.parametrize(
    "start",
    [
        [-0.4, -0.6, 0.25, 0.0],
        [-0.2, 0.5, 0.28, 0.0],
        pytest.param([0.0, 1.3, 0.26, 0.0], marks=pytest.mark.slow),
        pytest.param([-0.5, 0.1, 0.22, 0.0], marks=pytest.mark.slow),
    ],
)
def test_labels_are_the_best_of_all_routes(start, monkeypatch):
    """Two obstacles by default; three take longer. A label may be better than all of them: it need not keep beyond the
    faces of what it does not meet."""
    start = np.array(start)
    scene = make_scene(SceneSettings(obstacles=THREE[:2]))
    solution = make_expert(scene, SETTINGS).solve(start)
    monkeypatch.setattr(routes, "PATHS_PER_REGION", 10**9)
    duration, effort = _exhaustive(scene, start)
    assert solution.method == "certified"
    assert solution.duration == pytest.approx(duration, rel=1e-9)
    assert solution.objective <= duration + SETTINGS.effort_weight * effort * (1 + 2e-3)


def test_what_is_left_out_is_not_met():
    scene = make_scene(SceneSettings(obstacles=THREE))
    start = np.array([-0.4, -0.6, 0.25, 0.0])
    assert not first_obstacles(Problem(scene, start, "rest", SETTINGS), 0.03).any()
    solution = make_expert(scene, SETTINGS).solve(start)
    assert solution.status == "solved", solution.cause
    assert solution.clearance_violation == 0
    poses = dense_poses(solution.trajectory)
    assert first_met(scene, poses, SETTINGS.clearance_margin) is None
    assert first_met(scene, straight_path(np.array([start, scene.target])), SETTINGS.clearance_margin) == 1
    part = with_obstacles(scene, np.array([False, True, True]))
    np.testing.assert_array_equal(obstacle_clearances(part, start), obstacle_clearances(scene, start)[1:])


def test_a_walled_in_target_has_no_route_and_is_given_up_soon():
    scene = make_scene(SceneSettings(obstacles=WALLS))
    start = np.array([0.0, 0.1, 0.28, 0.0])
    solution = make_expert(scene, SETTINGS).solve(start)
    assert solution.status == "failed"
    assert solution.cause.startswith("no route")
    problem = Problem(scene, start, "rest", SETTINGS)
    search = RouteSearch(make_free_space(problem), problem)
    assert search.next() is None
    assert search.expansions < 200  # paths; without the question whether anything connects there are 20,000
    # A gap in one wall, and there is a way.
    open_walls = [*WALLS[:2], WALLS[2] | {"size": [0.2, 0.3, 0.6]}, WALLS[3]]
    assert make_expert(make_scene(SceneSettings(obstacles=open_walls[:2])), SETTINGS).solve(start).status == "solved"


def test_regions_around_a_pose_are_those_of_all_that_hold_it():
    scene = make_scene(SceneSettings(obstacles=THREE))
    generator = np.random.default_rng(0)
    for _ in range(40):
        pose = generator.uniform([0.0, -1.2, 0.156, 0.0], [2.9, 1.6, 0.319, 0.0])
        space = make_free_space(Problem(scene, pose, "rest", SETTINGS))
        near = regions_around(space, pose)
        assert len({region.cells for region in near}) == len(near)
        assert bool(near) == bool(clearance(scene, pose) >= SETTINGS.clearance_margin + 5e-4)


def test_least_clearance_leaves_out_nothing_that_is_nearest():
    scene = make_scene(SceneSettings(obstacles=THREE))
    generator = np.random.default_rng(1)
    for _ in range(20):
        steps = generator.normal(0, 0.01, (300, 4))
        poses = generator.uniform([0.0, -1.0, 0.2, -1.0], [2.5, 1.0, 0.3, 1.0]) + np.cumsum(steps, axis=0)
        assert least_clearance(scene, poses) == pytest.approx(float(clearance(scene, poses).min()), abs=1e-12)
