"""Nothing knows where an obstacle stands, how it is turned, or on which side the target is.

Random scenes of boxes and tables, with and without legs, are turned by right angles with their bounds (bounds that
differ by axis know no others), mirrored and moved. The label must move along, and every label is verified.
"""

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, make_expert, rejection, verify
from agile_jax.geometry import wrap_angle
from agile_jax.scene import SceneSettings, clearance, make_scene
from agile_jax.settings import BadInput

SETTINGS = ExpertSettings(nodes=60)
HALF = 3.0  # [m] of the square world
MIRRORED = {"left": "right", "right": "left"}


def random_obstacle(generator):
    place = {"yaw": float(generator.uniform(-3.1, 3.1))}
    x, y = generator.uniform(-1.6, 1.6, 2).tolist()
    kind = generator.integers(3)
    if kind == 0:
        size = (*generator.uniform(0.2, 0.8, 2).tolist(), 0.4)
        return place | {"kind": "box", "position": (x, y, 0.2), "size": size}
    table = place | {"kind": "table", "position": (x, y), "size": tuple(generator.uniform(0.5, 1.2, 2).tolist())}
    table["underside"] = float(generator.uniform(0.25, 0.3))
    return table if kind == 1 else table | {"leg_size": (0.05, 0.05)}


def random_problem(seed, count):
    """Obstacles, start and target more than 2.5 m apart, both free."""
    generator = np.random.default_rng(seed)
    while True:
        obstacles = [random_obstacle(generator) for _ in range(count)]
        poses = generator.uniform([-2.5, -2.5, 0.16, -3.1], [2.5, 2.5, 0.31, 3.1], (40, 4))
        try:
            world = make_scene(SceneSettings(obstacles=obstacles, target=(2.9, 2.9, 0.28, 0.0), **square()))
        except (BadInput, ValueError):
            continue
        free = poses[clearance(world, poses) >= 0.0256]
        for start in free:
            for target in free:
                if np.hypot(*(start - target)[:2]) > 2.5:
                    return obstacles, start, target, generator


def square(shift=(0.0, 0.0)):
    x, y = map(float, shift)
    return {"lower": (x - HALF, y - HALF, 0.155, -3.2), "upper": (x + HALF, y + HALF, 0.32, 3.2)}


class Motion:
    """A turn by right angles, then perhaps a mirror across the x axis, then a shift."""

    def __init__(self, generator):
        self.quarters, self.mirror = int(generator.integers(4)), bool(generator.integers(2))
        self.shift = generator.uniform(-3, 3, 2)
        cos, sin = [(1, 0), (0, 1), (-1, 0), (0, -1)][self.quarters]
        self.matrix = np.diag([1, -1 if self.mirror else 1]) @ np.array([[cos, -sin], [sin, cos]])

    def yaw(self, yaw):
        turned = yaw + self.quarters * np.pi / 2
        return wrap_angle(-turned if self.mirror else turned)

    def poses(self, poses):
        return np.hstack([poses[:, :2] @ self.matrix.T + self.shift, poses[:, 2:3], self.yaw(poses[:, 3:])])

    def obstacle(self, obstacle):
        x, y = self.matrix @ obstacle["position"][:2] + self.shift
        position = (float(x), float(y), *obstacle["position"][2:])
        return obstacle | {"position": position, "yaw": float(self.yaw(obstacle["yaw"]))}

    def settings(self, settings):
        if self.quarters % 2 == 0:
            return settings
        swapped = {
            name: (bounds[1], bounds[0], *bounds[2:])
            for name, bounds in (("velocity", settings.velocity), ("acceleration", settings.acceleration))
        }
        return settings.model_copy(update=swapped)

    def branch(self, name):
        parts = name.split("+")
        return "+".join(MIRRORED.get(part, part) for part in parts) if self.mirror else name


def solved(obstacles, start, target, bounds, settings, condition):
    scene = make_scene(SceneSettings(obstacles=obstacles, target=tuple(map(float, target)), **bounds))
    solution = make_expert(scene, settings).solve(start, condition)
    if solution.status == "solved":
        assert rejection(verify(scene, settings, solution.trajectory, start, condition)) is None
        assert solution.duration >= solution.lower_bound * (1 - 1e-7)
    return solution


def at(trajectory, moments):
    return np.array([np.interp(moments, trajectory.times, column) for column in trajectory.states[:, :4].T]).T


def compare(seed, count):
    obstacles, start, target, generator = random_problem(seed, count)
    motion, condition = Motion(generator), ("rest", "free")[seed % 2]
    one = solved(obstacles, start, target, square(), SETTINGS, condition)
    moved_start, moved_target = motion.poses(np.array([start, target]))
    moved = [motion.obstacle(obstacle) for obstacle in obstacles]
    other = solved(moved, moved_start, moved_target, square(motion.shift), motion.settings(SETTINGS), condition)
    assert one.status == other.status, (one.cause, other.cause)
    if one.status != "solved":
        assert one.cause.startswith("no route")
        return one
    assert other.duration == pytest.approx(one.duration, rel=1e-4)
    assert other.branch == motion.branch(one.branch)
    moments = np.linspace(0, min(one.duration, other.duration), 200)
    difference = motion.poses(at(one.trajectory, moments)) - at(other.trajectory, moments)
    difference[:, 3] = wrap_angle(difference[:, 3])
    assert np.abs(difference).max() < 2e-3
    return one


@pytest.mark.parametrize("count", [1, 2])
def test_labels_move_with_the_world(count):
    found = [compare(seed, count) for seed in (range(14) if count == 1 else (1, 2, 4, 6, 9))]
    assert sum(solution.status == "solved" for solution in found) >= len(found) - 1
    if count == 1:
        assert {solution.branch for solution in found} >= {"direct", "under"}
        assert {solution.method for solution in found} >= {"certified", "fatrop"}


# Through three obstacles and a turn of 200 degrees FATROP fails on the best of eleven parts, in the moved world only.
LOST = {(3, 25): pytest.mark.xfail(strict=True, reason="a label 7e-5 longer than the other world's")}
WORLDS = [(count, seed) for count in (1, 2, 3) for seed in range(20, 32)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "seed"), [pytest.param(*world, marks=LOST[world]) if world in LOST else world for world in WORLDS]
)
def test_labels_move_with_larger_worlds(count, seed):
    compare(seed, count)
