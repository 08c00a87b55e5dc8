"""Names of paths: by what the torso does, whatever the obstacles that the search has looked at."""

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.expert.problem import Problem
from agile_jax.expert.search.branches import branch_name
from agile_jax.expert.search.routes import RouteSearch
from agile_jax.expert.space.nearby_obstacles import first_met, first_obstacles
from agile_jax.expert.space.regions import make_free_space
from agile_jax.geometry import rotation_2d
from agile_jax.scene import SceneSettings, clearance, make_scene

TABLE = {"kind": "table", "position": [1.5, 0.0], "size": [0.8, 1.0], "underside": 0.25}
LEGS = {"leg_size": [0.05, 0.05]}
LOW = {"kind": "box", "position": [1.5, 0.0, 0.05], "size": [0.3, 1.0, 0.1]}
SETTINGS = ExpertSettings(nodes=60)
LINE = [[0.0, 0.0, 0.15], [3.0, 0.0, 0.15]]
AROUND = [[0.0, 0.0, 0.28], [0.9, 0.8, 0.28], [2.1, 0.8, 0.28], [3.0, 0.0, 0.28]]
CORNER = [[0.8, 0.0, 0.28], [0.8, 0.65, 0.28], [1.5, 0.8, 0.28]]


def path(corners, turn=0.0, mirrored=False):
    """Poses on straight lines, the yaw that of the world's turn."""
    corners = np.array(corners) * [1, -1 if mirrored else 1, 1]
    at = np.linspace(0, len(corners) - 1, 200)
    points = np.array([np.interp(at, np.arange(len(corners)), column) for column in corners.T]).T
    points[:, :2] = points[:, :2] @ rotation_2d(turn).T
    return np.column_stack([points, np.full(len(at), turn)])


@pytest.mark.parametrize("turn", [0.0, 0.7, -2.5])
@pytest.mark.parametrize(
    ("obstacle", "corners", "name"),
    [
        (TABLE, LINE, "under"),
        (TABLE | LEGS, LINE, "under"),
        (TABLE, AROUND, "left"),
        (TABLE | LEGS, AROUND, "left"),
        (TABLE, CORNER, "left"),
        (TABLE, [[0.0, 0.0, 0.28], [1.0, -1.0, 0.28]], "right"),
        (TABLE, [[0.0, 0.0, 0.15], [1.0, -1.0, 0.15]], "direct"),  # below all of it, beside it or not
        (TABLE | LEGS, [[0.0, 0.0, 0.15], [1.0, -1.0, 0.15]], "right"),
        (TABLE, [[0.0, 0.7, 0.28], [3.0, 0.7, 0.28]], "direct"),
        (TABLE, [[0.0, -0.9, 0.28], [0.7, 0.0, 0.28], [0.0, 0.9, 0.28]], "direct"),
    ],
)
def test_names_of_given_paths(obstacle, corners, name, turn):
    place = np.array(obstacle["position"])
    place[:2] = rotation_2d(turn) @ place[:2]
    scene = make_scene(
        SceneSettings(
            obstacles=[obstacle | {"position": place.tolist(), "yaw": turn}],
            target=(-9, 0, 0.28, 0),
            lower=(-10, -10, 0.1, -3.2),
            upper=(10, 10, 1.0, 3.2),
        )
    )
    assert branch_name(scene, path(corners, turn)) == name
    mirrored = {"left": "right", "right": "left"}.get(name, name)
    place = place @ np.diag([1.0, -1.0, 1.0][: len(place)])
    scene = make_scene(
        SceneSettings(
            obstacles=[obstacle | {"position": place.tolist(), "yaw": -turn}],
            target=(-9, 0, 0.28, 0),
            lower=(-10, -10, 0.1, -3.2),
            upper=(10, 10, 1.0, 3.2),
        )
    )
    assert branch_name(scene, path(corners, -turn, mirrored=True)) == mirrored


def test_only_an_overlap_is_under():
    """A torso turned by 45 degrees off a corner of the table: within both of the table's intervals, yet beside it."""
    scene = make_scene(SceneSettings(obstacles=[TABLE]))
    torso = scene.torso_half_size
    corner = np.array([1.1, 0.5])
    for gap, names in ((0.01, {"left"}), (-0.01, {"under"})):
        middle = corner + (torso[0] + gap) * np.array([-1, 1]) / 2**0.5
        poses = np.array([[0.0, -0.2], middle, [2.2, 0.9]])
        poses = np.column_stack([poses, np.full(3, 0.28), np.full(3, 0.75 * np.pi)])
        assert {branch_name(scene, poses)} == names


def test_no_path_leads_over_what_stands_on_the_floor():
    """However low the box and high the torso: the robot's legs stand on the floor. The lower, the same way round."""
    far = TABLE | {"position": [1.5, 2.2], "size": [0.4, 0.4]}
    found = []
    for height in (0.02, 0.1, 0.6):
        box = LOW | {"position": [1.5, 0.05, height / 2], "size": [0.3, 1.0, height]}
        scene = make_scene(SceneSettings(obstacles=[box, far], upper=(4.5, 3.0, 0.5, 3.2), target=(3.0, 0.0, 0.3, 0.0)))
        assert clearance(scene, np.array([1.5, 0.0, 0.5, 0.0])) < 0
        found.append(make_expert(scene, SETTINGS).solve([0.0, 0.0, 0.3, 0.0]))
        assert clearance(scene, found[-1].trajectory.states[:, :4]).min() > 0.02
    assert {solution.branch for solution in found} == {"right"}
    assert np.ptp([solution.duration for solution in found]) < 1e-6


def test_boxes_of_one_table_are_chosen_together():
    scene = make_scene(SceneSettings(obstacles=[LOW | {"position": [0.0, 2.0, 0.05]}, TABLE | LEGS]))
    chosen = first_obstacles(Problem(scene, np.array([0.0, 0.0, 0.28, 0.0]), "rest", SETTINGS), 0.03)
    np.testing.assert_array_equal(chosen, [False] + [True] * 5)
    leg = scene.obstacle_centers[2, :2]
    assert first_met(scene, np.array([[*leg, 0.16, 0.0]]), 0.02) == 1


def test_between_two_regions_of_a_table_with_legs_there_are_several_ways():
    """From one corridor below the slab to the other, across either row of legs; each way is a route."""
    table = TABLE | LEGS | {"size": [1.6, 1.6], "position": [0.0, 0.0]}
    world = {"lower": (-3, -3, 0.155, -3.2), "upper": (3, 3, 0.32, 3.2), "target": (0.0, 1.4, 0.28, 0.0)}
    scene = make_scene(SceneSettings(obstacles=[table], **world))
    start = np.array([-1.3, 0.0, 0.28, 0.0])
    problem = Problem(scene, start, "rest", SETTINGS)
    space, found = make_free_space(problem), {}
    for route in RouteSearch(space, problem).routes():
        found.setdefault(tuple(region.cells for region in route.regions), []).append(route)
    assert any(len(routes) > 1 for routes in found.values())
    for routes in found.values():
        crossed = {tuple((*face.normal, face.value) for face in route.crossed) for route in routes}
        assert len(crossed) == len(routes)
    bounds = [route.objective_bound for route in RouteSearch(space, problem).routes()]
    assert bounds == sorted(bounds)


@pytest.mark.parametrize("legs", [{}, LEGS])
def test_edges_of_single_faces_are_rounded_and_others_square(legs):
    """Around the corners of a table with legs as of one without; below it only where there are no legs."""
    scene = make_scene(SceneSettings(obstacles=[TABLE | legs]))
    start = np.array([0.0, 0.1, 0.28, 0.2])
    problem = Problem(scene, start, "rest", SETTINGS)
    space = make_free_space(problem, exact=True)
    seen = set()
    for route in RouteSearch(space, problem, rounded=True).routes():
        names = [space.cells[0][region.cells[0]].name for region in route.regions if region.edge is None]
        rounded = sum(region.edge is not None for region in route.regions)
        if len(names) == 3:  # front, one side, back
            seen.add((names[1], rounded))
    assert seen == {("left", 2), ("right", 2), ("under", 0 if legs else 2)}
