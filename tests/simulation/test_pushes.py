"""One push a robot: its rule, its impulse, and nobody else's."""

import mujoco
import numpy as np

from agile_jax.robot import PlantSettings, RobotSettings, build_mujoco_model, draw_plants
from agile_jax.scene import SceneSettings, TableSettings, make_scene
from agile_jax.simulation import MujocoPhysics, Sensed, push_after
from agile_jax.simulation.pushes import Pushes, below_obstacle

TABLE = TableSettings(kind="table", position=(1.5, 0.0), size=(0.5, 1.0), underside=0.25)
SCENE = make_scene(SceneSettings(obstacles=(TABLE,)))
DT = 0.002
PLANTS = draw_plants(PlantSettings(push_impulse=(4.0, 6.0)), (3,), np.arange(3))._replace(
    push_after=np.array([np.inf, 1.0, np.inf])
)
EVERYONE = np.ones(3, bool)


def test_the_push_waits_for_the_table_or_comes_at_half_the_experts_time() -> None:
    after = push_after(np.array([4.0, 4.0, 4.0, np.nan]), ["under", "left", "right+under", "no way"])
    np.testing.assert_array_equal(after, [np.inf, 2.0, np.inf, np.inf])


def test_below_an_obstacle_is_whose_envelope_reaches_into_its_outline_from_below() -> None:
    """The table's front edge is at x = 1.25 m, the nose 0.28 m before the centre; turned by 90 degrees 0.155 m."""
    height, table = 0.17, 0.8
    poses = [(0.96, 0, height, 0), (0.98, 0, height, 0), (0.98, 0, height, np.pi / 2), (1.11, 0, height, np.pi / 2)]
    poses += [(1.5, 0, table, 0), (1.5, 0.66, height, 0), (1.5, 0.65, height, 0)]
    expected = [False, True, False, True, False, False, True]
    np.testing.assert_array_equal(below_obstacle(SCENE, np.array(poses, float)), expected)
    assert not below_obstacle(make_scene(SceneSettings()), np.zeros((2, 4))).any()


def test_impulses_are_drawn_in_all_directions() -> None:
    plants = draw_plants(PlantSettings(push_impulse=(4.0, 6.0)), (3,), np.arange(400))
    sizes, angles = np.linalg.norm(plants.push, axis=1), np.arctan2(plants.push[:, 1], plants.push[:, 0])
    assert 4.0 <= sizes.min() < 4.1 < 5.9 < sizes.max() <= 6.0
    assert (np.histogram(angles, 8, (-np.pi, np.pi))[0] > 30).all()
    quiet = draw_plants(PlantSettings(), (3,), np.arange(4))
    np.testing.assert_array_equal(quiet.push, 0.0)
    drawn = draw_plants(PlantSettings(delay=(0.0, 1.0), push_impulse=1.0), (3,), np.arange(4)).delay
    np.testing.assert_array_equal(drawn, draw_plants(PlantSettings(delay=(0.0, 1.0)), (3,), np.arange(4)).delay)


def test_each_robot_is_pushed_once_where_it_is_due() -> None:
    pushes = Pushes(SCENE, 3, DT)
    pushes.reset(np.arange(3), PLANTS)
    outside, below = np.array([0.5, 0.0, 0.28, 0.0]), np.array([1.0, 0.4, 0.17, 0.0])  # the nose is below

    def plan(time: float, *poses: np.ndarray) -> None:
        pushes.plan(np.stack(poses), np.full(3, time), EVERYONE)

    plan(0.9, outside, outside, outside)
    assert pushes.forces(EVERYONE) is None
    plan(1.0, below, outside, np.array([1.3, 0.4, 0.8, 0.0]))  # the third one stands on the table
    given = np.zeros((3, 3))
    for _ in range(40):
        force = pushes.forces(EVERYONE)
        given += 0.0 if force is None else DT * force
    np.testing.assert_allclose(given[:2, :2], PLANTS.push[:2])
    np.testing.assert_array_equal(given[:, 2], 0.0)
    np.testing.assert_array_equal(given[2], 0.0)
    assert pushes.waiting
    plan(1.1, below, below, below)
    force = pushes.forces(EVERYONE)
    assert force is not None
    np.testing.assert_array_equal(force.any(1), [False, False, True])
    assert pushes.forces(np.array([True, True, False])) is None  # it has ended
    pushes.reset(np.arange(3), None)
    assert not pushes.waiting


def test_a_push_changes_the_momentum_by_its_impulse() -> None:
    """In free fall nothing else acts in the plane; the neighbour of who is pushed falls as it does alone."""
    model = build_mujoco_model(make_scene(SceneSettings()), RobotSettings(), DT)
    qpos = np.tile(model.key("home").qpos, (2, 1))
    qpos[:, 2] = 100.0
    plants = PLANTS.of(np.arange(2))._replace(push=np.array([[0.0, 0.0], PLANTS.push[1]]))

    def fall(robots: int) -> Sensed:
        chosen, everyone = np.arange(robots), np.ones(robots, bool)
        pushes = Pushes(SCENE, robots, DT)
        pushes.reset(chosen, plants.of(chosen))
        with MujocoPhysics(model, robots, 1) as physics:
            physics.reset(qpos[:robots])
            pushes.plan(np.tile([0.0, 0.0, 100.0, 0.0], (robots, 1)), np.ones(robots), everyone)
            for _ in range(40):
                sensed = physics.step(np.zeros((robots, 12)), None, pushes.forces(everyone))
        return sensed

    alone, both = fall(1), fall(2)
    data = mujoco.MjData(model)
    data.qpos, data.qvel = both.qpos[1], both.qvel[1]
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    mujoco.mj_subtreeVel(model, data)
    momentum = data.subtree_linvel[1] * model.body_subtreemass[1]
    np.testing.assert_allclose(momentum[:2], plants.push[1], rtol=1e-3)
    np.testing.assert_array_equal(both.qvel[0], alone.qvel[0])
