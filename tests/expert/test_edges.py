"""Rounded edges: the exact clearance around them, lower bounds, turns, and the time that they save."""

import itertools

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.expert.problem import Problem
from agile_jax.expert.programs.initial_guess import make_inputs
from agile_jax.expert.programs.layout import Phase
from agile_jax.expert.programs.program import solve_program
from agile_jax.expert.programs.schemes import control_points, step
from agile_jax.expert.programs.transcription import build_program
from agile_jax.expert.search.braking_bound import braked_time
from agile_jax.expert.search.routes import RouteSearch
from agile_jax.expert.search.turns import split_turns
from agile_jax.expert.space.edges import round_edge
from agile_jax.expert.space.footprint import footprint_range
from agile_jax.expert.space.regions import ROUNDING_ERRORS, make_free_space, make_region
from agile_jax.geometry import rotation_2d
from agile_jax.scene import SceneSettings, clearance, make_scene

TABLE = {"kind": "table", "position": [1.5, 0.0], "size": [0.5, 1.0], "underside": 0.25}
SETTINGS = ExpertSettings(nodes=60)
ACTIVE = np.array([0.82, -0.08, 0.27, 0.0])  # the front edge is in the way of the fastest motion
TURNED = np.array([0.62, -0.22, 0.26, -0.675])  # turned beyond the torso's diagonal


def _edges(scene, start, exact):
    """Regions around edges, for every pair of neighbouring regions."""
    space = make_free_space(Problem(scene, start, "rest", SETTINGS), exact, ROUNDING_ERRORS)
    regions = [make_region(space, (i,)) for i in range(len(space.cells[0]))]
    for before, after in itertools.permutations([region for region in regions if region is not None], 2):
        for region in (before, after):
            cell = space.cells[0][region.cells[0]]
            passage = round_edge(space, 0, before, after, cell.faces[0], (start, scene.target)) if cell.name else None
            if passage is not None:
                yield space, passage


@pytest.mark.parametrize(("yaw", "exact"), [(0.0, False), (0.4, True)])
def test_edges_are_the_exact_clearance(yaw, exact):
    """Off an edge, the farthest of the planes through it is as far as the torso is."""
    # Its edges are longer than the torso.
    scene = make_scene(SceneSettings(obstacles=[TABLE | {"size": [1.0, 1.4], "yaw": yaw}]))
    start = np.array([0.0, 0.0, 0.28, 0.6 if exact else 0.0])
    generator = np.random.default_rng(0)
    angles = np.linspace(0, np.pi / 2, 2000)
    corners = np.array([[i, j] for i in (1, -1) for j in (1, -1)]) * scene.torso_half_size[:2]
    edges = 0
    for space, passage in _edges(scene, start, exact):
        edges += 1
        normals, offsets = passage.between.edge[:, :3], passage.between.edge[:, 3]
        assert abs(normals[0] @ normals[1]) < 1e-12
        for _ in range(20):
            pose = np.append(scene.obstacle_centers[0], generator.uniform(0, 0.6) if exact else 0.0)
            points = np.hstack([corners @ rotation_2d(pose[3]).T, np.zeros((4, 1))]) if exact else np.zeros((1, 3))
            # Move it to where it is beyond both faces by what was drawn.
            beyond = generator.uniform(0, 1.3 * space.margin, 2)
            pose[:3] += normals.T @ (beyond - ((pose[:3] + points) @ normals.T - offsets).min(0))
            heights = (pose[:3] + points) @ normals.T - offsets
            farthest = (heights @ [np.cos(angles), np.sin(angles)]).min(0).max()
            true = float(clearance(scene, pose))
            # In boxes the footprint is that of a small interval of yaw.
            assert farthest == pytest.approx(true, abs=1e-4 if exact else 4e-4)
            assert farthest < true + 1e-6
    assert edges >= 8


def test_an_edge_costs_what_the_exact_margin_costs(scene):
    rounded = make_expert(scene, SETTINGS).solve(ACTIVE)
    square = make_expert(scene, SETTINGS.model_copy(update={"edges": "square"})).solve(ACTIVE)
    assert (rounded.status, square.status) == ("solved", "solved")
    assert rounded.method == square.method == "fatrop"
    assert rounded.duration < square.duration * (1 - 5e-3)
    # The margin is used up, and kept: square corners leave some of it unused where the path touches them.
    assert 0 <= rounded.min_clearance - SETTINGS.clearance_margin < 5e-5
    assert rounded.clearance_violation == 0
    fine = make_expert(scene, SETTINGS.model_copy(update={"nodes": 240})).solve(ACTIVE)
    assert rounded.duration == pytest.approx(fine.duration, rel=1e-3)


def test_no_longer_than_the_smoothed_peer(scene):
    from agile_jax.benchmark.peers.opti_peer import make_opti_peer

    settings = ExpertSettings()
    peer = make_opti_peer(scene, settings, 5e-3)(ACTIVE)
    assert peer.success
    ours = make_expert(scene, settings).solve(ACTIVE)
    assert ours.gap > 1e-2  # or the test says nothing
    assert ours.duration <= peer.path.times[-1] * (1 + 1e-4)


def test_mirrored_starts_have_mirrored_labels(scene):
    expert = make_expert(scene, SETTINGS)
    mirror = np.array([1, -1, 1, -1] * 2)
    one, other = expert.solve(TURNED, "free"), expert.solve(TURNED * mirror[:4], "free")
    assert one.method == "fatrop"
    np.testing.assert_allclose(one.trajectory.states, other.trajectory.states * mirror, atol=1e-5)


@pytest.mark.parametrize("start", [ACTIVE, TURNED])
def test_bounds_of_rounded_routes_are_below_what_they_reach(scene, start):
    exact = start is TURNED
    space = make_free_space(Problem(scene, start, "rest", SETTINGS), exact, ROUNDING_ERRORS)
    solved, programs = [], {}
    for condition in ("rest", "free"):
        problem = Problem(scene, start, condition, SETTINGS)
        for route in split_turns(problem, space, RouteSearch(space, problem, rounded=True).routes()):
            if len(route.regions) > 5:
                continue
            phases = tuple(Phase(r.edge is not None, len(r.rows)) for r in route.regions)
            if (phases, condition) not in programs:
                half_size = scene.torso_half_size if exact else None
                programs[phases, condition] = build_program(phases, condition == "rest", SETTINGS, half_size=half_size)
            program = programs[phases, condition]
            inputs = make_inputs(problem, route, space.margin, program, SETTINGS.effort_weight)
            found = solve_program(program, inputs)
            if found.success:
                assert route.duration_bound <= found.trajectory.times[-1] + 1e-6
                assert route.objective_bound <= found.objective + 1e-6
                solved.append(route)
    assert len(solved) >= 4
    assert any(region.edge is not None for route in solved for region in route.regions)


def test_a_turn_is_split_where_the_torso_is_widest(scene):
    problem = Problem(scene, TURNED, "free", SETTINGS)
    space = make_free_space(problem, True, ROUNDING_ERRORS)
    widest = -np.arctan2(scene.torso_half_size[1], scene.torso_half_size[0])
    least, most = footprint_range(scene.torso_half_size, np.array([-1.0, 0.0, 0.0]), (-0.675, 0.0))
    assert most == pytest.approx(np.hypot(*scene.torso_half_size[:2]))
    assert least == pytest.approx(scene.torso_half_size[0])
    routes = list(RouteSearch(space, problem, rounded=True).routes())
    parts = list(split_turns(problem, space, iter(routes)))
    bounds = [part.objective_bound for part in parts]
    assert bounds == sorted(bounds)
    ahead = [[-1, 0, 0], [-1, 0, 0], [1, 0, 0], [1, 0, 0]]  # normals of the front and of the back
    under = [part for part in parts if [face.normal.tolist() for face in part.crossed] == ahead]
    turned = {tuple(bool(b.upper[3] <= widest + 1e-9) for b in part.crossings) for part in under}
    # Turned before the front edge, between the edges, or after the back edge.
    assert turned == {(False,) * 4, (True, True, False, False), (True,) * 4}
    straight = problem._replace(start=np.array([0.62, -0.22, 0.26, -0.4]))
    space = make_free_space(straight, True, ROUNDING_ERRORS)
    routes = list(RouteSearch(space, straight, rounded=True).routes())
    assert len(list(split_turns(straight, space, iter(routes)))) == len(routes)


@pytest.mark.parametrize("free", [False, True])
def test_braked_time_against_a_linear_program(free):
    """The fewest steps in which the distance can be covered, by bisection over linear programs."""
    from scipy.optimize import linprog

    generator = np.random.default_rng(1)
    for _ in range(6):
        distance, velocity, acceleration = generator.uniform([0.02, 0.2, 0.5], [1.0, 1.0, 2.0])
        last = velocity * generator.uniform(0, 1)
        expected = braked_time(distance, last, velocity, acceleration, not free)

        def farthest(duration, n=200, velocity=velocity, acceleration=acceleration, last=last):
            h = duration / n
            earlier = np.tril(np.ones((n, n))) * h  # rates after each step
            ones = np.ones((n, 1))
            rates = np.hstack([earlier, ones])  # and the initial rate
            covered = np.append((h * (duration - h * (np.arange(n) + 0.5))), duration)
            limit = np.full(n, velocity)
            limit[-1] = last
            return -linprog(
                -covered,
                A_ub=np.vstack([rates, -rates]),
                b_ub=np.concatenate([limit, np.full(n, velocity)]),
                bounds=[(-acceleration, acceleration)] * n + [(0, velocity if free else 0)],
            ).fun

        assert farthest(expected * 1.01) >= distance
        assert farthest(expected * 0.99) <= distance


@pytest.mark.parametrize("scheme", ["zoh", "foh", "trapezoidal"])
def test_a_motion_is_in_the_hull_of_its_control_points(scheme):
    generator = np.random.default_rng(0)
    for _ in range(20):
        pose, rate, u, u_next = generator.normal(size=4)
        h = generator.uniform(0.1, 2)
        points = [pose, *control_points(scheme, pose, rate, h, u, u_next)]
        assert points[-1] == pytest.approx(step(scheme, pose, rate, h, u, u_next)[0])
        t = np.linspace(0, h, 101)
        if scheme == "trapezoidal":  # it takes the pose for a parabola
            end_rate = step(scheme, pose, rate, h, u, u_next)[1]
            motion = pose + t * rate + t**2 / (2 * h) * (end_rate - rate)
        else:
            slope = (u_next - u) / h if scheme == "foh" else 0.0
            motion = pose + t * rate + t**2 / 2 * u + t**3 / 6 * slope
        assert min(points) - 1e-12 <= motion.min()
        assert motion.max() <= max(points) + 1e-12


@pytest.mark.parametrize("scheme", ["zoh", "foh"])
def test_bounds_of_the_pose_hold_between_nodes(scene, scheme):
    """Under the table the lowest height is 12 mm below the highest, and the path follows it."""
    from agile_jax.expert.verify import dense_poses

    settings = SETTINGS.model_copy(update={"transcription": scheme, "method": "general"})
    solution = make_expert(scene, settings).solve(ACTIVE)
    assert solution.status == "solved", solution.cause
    heights = dense_poses(solution.trajectory, 200, scheme)[:, 2]
    assert heights.min() == pytest.approx(scene.lower[2], abs=1e-4)
    assert heights.min() >= scene.lower[2]
