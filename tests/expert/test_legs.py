"""Tables with legs: between them where there is room, around where there is none, and what it is called."""

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, make_expert, rejection, verify
from agile_jax.expert.problem import Problem
from agile_jax.expert.space.regions import make_free_space
from agile_jax.scene import SceneSettings, clearance, make_scene

TABLE = {"kind": "table", "position": [1.5, 0.0], "size": [0.7, 1.1], "underside": 0.25, "leg_size": [0.05, 0.05]}
SETTINGS = ExpertSettings(nodes=60)
START = np.array([0.0, 0.0, 0.28, 0.0])


def solve(table, start, condition="rest", settings=SETTINGS, **scene):
    world = make_scene(SceneSettings(obstacles=[table], **scene))
    solution = make_expert(world, settings).solve(np.array(start), condition)
    assert solution.status == "solved", solution.cause
    assert rejection(verify(world, settings, solution.trajectory, np.array(start), condition)) is None
    return solution


@pytest.mark.parametrize("yaw", [0.0, 0.3, np.pi / 2, -2.9])
def test_between_the_legs_is_under_and_takes_no_longer_than_without_them(yaw):
    for condition in ("rest", "free"):
        with_legs = solve(TABLE | {"yaw": yaw, "size": [0.9, 1.1]}, START, condition)
        without = solve(TABLE | {"yaw": yaw, "size": [0.9, 1.1], "leg_size": None}, START, condition)
        assert with_legs.branch == without.branch == "under"
        assert with_legs.duration == pytest.approx(without.duration, rel=1e-3)


@pytest.mark.parametrize("gap", [0.33, 0.37])
def test_the_gap_that_is_needed_is_the_torso_and_its_margins(gap):
    """The torso is 0.31 m wide and keeps 0.0255 m on each side: 0.361 m."""
    table = TABLE | {"size": [0.6, gap + 0.1], "position": [1.5, 0.0]}
    solution = solve(table, START, condition="free")
    poses = solution.trajectory.states[:, :4]
    between = (np.abs(poses[:, 0] - 1.5) < 0.3) & (np.abs(poses[:, 1]) < 0.02)
    if gap > 0.361:
        assert solution.branch == "under"
        assert between.any()
    else:
        assert solution.branch in ("left", "right")
        assert not between.any()


def grid_finds_a_way(scene, margin, start, step=0.02):
    """A second implementation: whether poses of one yaw, start's and target's, are connected on a grid."""
    axes = [np.arange(scene.lower[i], scene.upper[i] + 1e-9, size) for i, size in ((0, step), (1, step), (2, 0.0165))]
    poses = np.stack([*np.meshgrid(*axes, indexing="ij"), np.zeros([len(a) for a in axes])], -1)
    free = clearance(scene, poses) >= margin
    place = [[int(np.abs(a - p[i]).argmin()) for i, a in enumerate(axes)] for p in (start, scene.target)]
    reached = np.zeros_like(free)
    reached[tuple(place[0])] = True
    while True:
        grown = reached.copy()
        for axis in range(3):
            for shift in (1, -1):
                moved = np.roll(reached, shift, axis)
                edge = [slice(None)] * 3
                edge[axis] = 0 if shift == 1 else -1
                moved[tuple(edge)] = False
                grown |= moved
        grown &= free
        if (grown == reached).all():
            return bool(reached[tuple(place[1])])
        reached = grown


@pytest.mark.parametrize("gap", [0.34, 0.42])
@pytest.mark.parametrize("along", ["x", "y"])
def test_with_no_way_around_it_agrees_with_a_search_on_a_grid(gap, along):
    """The table is as wide as the world: between its legs is the only way."""
    if along == "x":
        table = TABLE | {"size": [0.5, gap + 0.1]}
        world = {"lower": (-0.5, -0.2, 0.155, -3.2), "upper": (3.5, 0.2, 0.32, 3.2)}
        start, target = START, (3.0, 0.0, 0.28, 0.0)
    else:
        gap += 0.25  # the torso is longer than it is wide
        table = TABLE | {"size": [gap + 0.1, 0.5], "position": [0.0, 1.5]}
        world = {"lower": (-0.15, -0.5, 0.155, -3.2), "upper": (0.15, 3.5, 0.32, 3.2)}
        start, target = START, (0.0, 3.0, 0.28, 0.0)
    scene = make_scene(SceneSettings(obstacles=[table], target=target, **world))
    solution = make_expert(scene, SETTINGS).solve(start)
    assert (solution.status == "solved") == grid_finds_a_way(scene, 0.0255, start)
    if solution.status == "solved":
        assert solution.branch == "under"


def test_from_between_the_legs_to_any_side():
    """Four ways out of one place, across both corridors; and which way out does not change the name."""
    table = TABLE | {"size": [1.3, 1.3], "position": [0.0, 0.0]}
    start = [0.1, -0.05, 0.16, 0.2]
    for target in ((1.8, 0.3, 0.28, 0.0), (-1.8, 0.3, 0.28, 0.5), (0.2, 1.7, 0.28, 0.0), (-0.2, -1.7, 0.28, -0.5)):
        assert (
            solve(table, start, target=target, lower=(-3, -3, 0.155, -3.2), upper=(3, 3, 0.32, 3.2)).branch == "under"
        )


def test_round_the_corner_below_the_table():
    """In at the front, out on the left: the corridors cross, and the path changes from one to the other. The bounds
    leave no way around."""
    table = TABLE | {"size": [1.6, 1.6], "position": [0.0, 0.0]}
    world = {"lower": (-1.6, -0.9, 0.155, -3.2), "upper": (0.9, 1.6, 0.32, 3.2)}
    scene = SceneSettings(obstacles=[table], target=(0.0, 1.4, 0.28, 0.0), **world)
    start = np.array([-1.3, 0.0, 0.28, 0.0])
    space = make_free_space(Problem(make_scene(scene), start, "rest", SETTINGS))
    assert sorted(cell.name for cell in space.cells[0]) == ["front", "left", "under", "under"]
    solution = solve(table, start, target=(0.0, 1.4, 0.28, 0.0), **world)
    assert solution.branch == "under"
    assert solution.gap < 0.25
