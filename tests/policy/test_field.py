import jax
import jax.numpy as jnp
import numpy as np
import pytest
from synthetic import ACCELERATION, LIMITS, SMALL, TARGET, VELOCITY, empty_scene, follow, table_scene

from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.policy import PolicySettings, braking_law, make_policy, parameter_count
from agile_jax.policy.braking import rest_to_rest_time
from agile_jax.policy.features import face_distances
from agile_jax.policy.separating_planes import separating_planes
from agile_jax.policy.speed_filter import brake_before_obstacles
from agile_jax.scene import (
    BoxSettings,
    SceneSettings,
    TableSettings,
    clearance,
    make_scene,
    obstacle_clearances,
    without_way_over,
)
from agile_jax.training.kinematic_test.follow import ARRIVED, COLLIDED

PAPER_LAYERS = (256, 1024, 1024, 1024, 1024, 256)


def random_poses(count, seed=0):
    scene = table_scene()
    return np.random.default_rng(seed).uniform(scene.lower, scene.upper, (count, 4))


def wild(policy, seed=0, size=5.0):
    """Parameters whose network says anything but something useful."""
    parameters = policy.init(jax.random.key(seed))
    return parameters._replace(network=jax.tree.map(lambda leaf: size * leaf + 0.3, parameters.network))


def test_paper_network_has_the_papers_number_of_parameters():
    policy = make_policy(empty_scene(), LIMITS, PolicySettings(kind="plain", hidden_layers=PAPER_LAYERS))
    assert parameter_count(jax.eval_shape(policy.init, jax.random.key(0))) == 3_676_676


def test_braking_law_stops_each_axis_within_its_bounds_along_a_straight_line():
    rng = np.random.default_rng(0)
    error = rng.normal(size=(200, 4)) * [1.0, 0.5, 0.05, 0.5]
    law = jax.vmap(lambda e: braking_law(e, LIMITS, 8.0))(jnp.asarray(error))
    velocity = np.asarray(law.velocity)
    cosine = -(velocity * error).sum(-1) / np.linalg.norm(velocity, axis=-1) / np.linalg.norm(error, axis=-1)
    np.testing.assert_allclose(cosine, 1, atol=1e-5)
    assert (np.abs(velocity) <= VELOCITY + 1e-6).all()
    # Within what the remaining distance lets it brake, v^2 = 2 a d, and one axis at the edge of what the law allows.
    assert (velocity**2 <= 2 * ACCELERATION * np.abs(error) + 1e-6).all()
    offset = np.abs(error) - ACCELERATION / (2 * 64.0)
    allowed = np.where(
        offset > ACCELERATION / 128, np.minimum(VELOCITY, np.sqrt(2 * ACCELERATION * np.abs(offset))), 8 * np.abs(error)
    )
    np.testing.assert_allclose((np.abs(velocity) / np.minimum(allowed, VELOCITY)).max(-1), 1, rtol=1e-4)


def test_rest_to_rest_time_is_the_trapezoid_or_the_triangle():
    distance = jnp.array([2.0, 0.1])
    times = rest_to_rest_time(distance, jnp.full(2, 0.8), jnp.full(2, 1.5))
    np.testing.assert_allclose(times, [2 / 0.8 + 0.8 / 1.5, 2 * np.sqrt(0.1 / 1.5)], rtol=1e-6)


def test_face_distances_agree_with_exact_clearance_beside_a_face():
    scene = table_scene()
    pose = np.array([0.5, 0.0, 0.5, 0.4])
    faces = np.asarray(face_distances(scene, jnp.asarray(pose)))
    assert faces.shape == (1, 6)
    np.testing.assert_allclose(faces[0, 1], obstacle_clearances(scene, pose)[0], rtol=1e-5)  # the -x face is nearest
    below = np.array([1.5, 0.0, 0.15, 0.4])
    np.testing.assert_allclose(
        face_distances(scene, jnp.asarray(below))[0, 5], 0.25 - scene.torso_half_size[2] - 0.15, rtol=1e-4
    )


def test_touching_means_all_faces_negative_without_a_turn():
    scene = table_scene()
    poses = random_poses(2000)
    poses[:, 3] = 0
    faces = np.asarray(jax.vmap(lambda p: face_distances(scene, p))(jnp.asarray(poses)))[:, 0]
    signed = obstacle_clearances(scene, poses)[:, 0]
    clear_cut = np.abs(signed) > 1e-5
    assert ((faces.max(-1) < 0) == (signed < 0))[clear_cut].all()
    assert (signed < 0).any()


def turned_scene():
    """A table and a box, both turned."""
    table = TableSettings(kind="table", position=(1.5, 0.0), size=(0.5, 1.0), underside=0.25, yaw=0.3)
    box = BoxSettings(kind="box", position=(0.4, 1.2, 0.15), size=(0.6, 0.2, 0.3), yaw=-0.8)
    return without_way_over(make_scene(SceneSettings(obstacles=(table, box))))


@pytest.mark.parametrize("number", [0, 1])
def test_the_ten_planes_part_the_torso_from_an_obstacle_exactly_where_they_do_not_touch(number):
    scene = turned_scene()
    poses = np.random.default_rng(number).uniform([-0.2, -0.9, 0.155, -3], [2.2, 1.9, 0.5, 3], (20000, 4))
    planes = jax.jit(jax.vmap(lambda pose: separating_planes(scene, pose, number)))(jnp.asarray(poses))
    best, exact = np.asarray(planes.distance).max(-1), obstacle_clearances(scene, poses)[:, number]
    sure = np.abs(exact) > 1e-5
    np.testing.assert_array_equal((best > 0)[sure], (exact > 0)[sure])
    assert (exact < 0).sum() > 500
    assert (best <= exact + 1e-5)[exact > 0].all()  # no plane promises more than there is


def test_gradients_of_the_planes_equal_finite_differences():
    scene, step = turned_scene(), 1e-2
    poses = np.random.default_rng(0).uniform([0, -1, 0.155, -3], [2, 1.5, 0.3, 3], (300, 4))
    of = jax.jit(jax.vmap(lambda pose: separating_planes(scene, pose, 1)))
    here = of(jnp.asarray(poses))
    for axis, name in enumerate(("x", "y", "z", "yaw")):
        change = step * np.eye(4)[axis]
        ahead, behind = (of(jnp.asarray(poses + sign * change)).distance for sign in (1, -1))
        error = np.abs(np.asarray(getattr(here, name)) - np.asarray(ahead - behind) / (2 * step))
        assert np.quantile(error, 0.95) < 1e-3  # the sizes have kinks where a side of one is along a side of the other


def test_filter_lets_pass_what_ducks_under_the_edge_and_not_what_would_hit_it():
    scene = table_scene()
    filtered = jax.jit(lambda p, v: brake_before_obstacles(scene, p, v, jnp.asarray(ACCELERATION), 0.01))
    top = 0.25 - scene.torso_half_size[2] - 0.01  # of the torso's centre under the table with the margin
    pose = np.array([1.25 - scene.torso_half_size[0] - 0.01 - 0.1, 0.0, top + 0.02, 0.0])  # 0.1 m ahead, 2 cm to duck
    ducks, hits = np.array([0.8, 0.0, -0.17, 0.0]), np.array([0.8, 0.0, -0.1, 0.0])
    np.testing.assert_allclose(filtered(pose, ducks), ducks, atol=1e-6)
    after = np.asarray(filtered(pose, hits))
    assert after[2] / after[0] == pytest.approx(-0.2, rel=1e-3)  # straight at the edge
    assert after[2] < hits[2]


@pytest.mark.parametrize(("kind", "field_filter"), [("plain", False), ("residual", False), ("residual", True)])
def test_velocity_is_finite_and_within_limits_everywhere(kind, field_filter):
    scene = table_scene()
    settings = PolicySettings(kind=kind, hidden_layers=(16, 16), field_filter=field_filter)
    policy = make_policy(scene, LIMITS, settings)
    touching = [[1.5, 0.0, 0.3, 0.0], [1.5, 0.0, 0.5, 0.0], [1.25 - scene.torso_half_size[0], 0.0, 0.28, 0.0]]
    poses = np.concatenate([random_poses(1000), [TARGET, scene.lower, scene.upper], touching])
    velocity = np.asarray(jax.jit(jax.vmap(policy.velocity, (None, 0)))(wild(policy), poses))
    assert np.isfinite(velocity).all()
    assert (np.abs(velocity) <= VELOCITY * (1 + 1e-5)).all()


@pytest.mark.parametrize("kind", ["plain", "residual", "feedback"])
def test_a_policy_asks_for_no_more_than_the_legs_allow_at_its_height(kind):
    """Whatever its network says; and where they allow the velocity's bounds, they change nothing."""
    scene, start = table_scene(), np.zeros(4, np.float32)
    low = scene._replace(speed_heights=np.array([0.155, 0.2, 0.25]), speed_limits=np.array([0.2, 0.35, 0.85]))
    poses = random_poses(1000).astype(np.float32)

    def commands(where):
        policy = make_policy(where, LIMITS, PolicySettings(kind=kind, hidden_layers=(16, 16)))
        command = jax.jit(jax.vmap(lambda parameters, pose: policy.command(parameters, pose, start, 0.5), (None, 0)))
        return np.asarray(command(wild(policy), poses))

    fast, slow = commands(scene), commands(low)
    allowed = np.interp(poses[:, 2], low.speed_heights, low.speed_limits)
    assert (np.abs(fast[:, :2]).max(1) > allowed * 1.1).sum() > 100
    assert (np.abs(slow[:, :2]).max(1) <= allowed * (1 + 1e-5)).all()
    high = poses[:, 2] > 0.26
    np.testing.assert_allclose(slow[high], fast[high], atol=1e-6)


def test_residual_field_is_a_stable_node_at_the_target_whatever_the_network_says():
    policy = make_policy(table_scene(), LIMITS, SMALL)
    parameters = wild(policy)
    field = jax.jit(jax.vmap(policy.velocity, (None, 0)))
    rng = np.random.default_rng(1)
    error = rng.normal(size=(500, 4))
    error *= 5e-4 * rng.uniform(0.02, 1, (500, 1)) / np.linalg.norm(error, axis=-1, keepdims=True)
    velocity = np.asarray(field(parameters, TARGET + error))
    assert np.abs(field(parameters, TARGET[None])).max() < 1e-5
    assert ((velocity * error).sum(-1) < 0).all()
    near = np.abs(error).max(-1) < 5e-5
    assert near.sum() > 20
    np.testing.assert_allclose(velocity[near], -8.0 * error[near], atol=3e-5)


def test_yaw_is_wrapped():
    policy = make_policy(table_scene(), LIMITS, SMALL)
    parameters = policy.init(jax.random.key(0))
    velocity = jax.jit(policy.velocity)
    pose = np.array([0.3, 0.2, 0.26, 0.5])
    turned = pose + np.array([0, 0, 0, 2 * np.pi])
    np.testing.assert_allclose(velocity(parameters, pose), velocity(parameters, turned), atol=1e-4)


@pytest.mark.parametrize(
    ("low", "high", "start", "target", "turn"),
    [(-3.2, 3.2, 3.0, -3.0, 2 * np.pi - 6), (-3.1, 3.1, 3.0, -3.0, -6.0), (1.0, 5.0, 1.1, 4.5 - 2 * np.pi, 3.4)],
)
def test_the_field_turns_as_the_expert_does(low, high, start, target, turn):
    """Across the cut where the bounds hold a circle, between them where they do not."""
    inside = target if low <= target <= high else target + 2 * np.pi
    settings = SceneSettings(
        target=(1.0, 0.0, 0.28, inside), lower=(-1.5, -3.0, 0.155, low), upper=(4.5, 3.0, 0.32, high)
    )
    scene = make_scene(settings)
    expert = ExpertSettings(velocity=tuple(VELOCITY), acceleration=tuple(ACCELERATION), nodes=40)
    planned = make_expert(scene, expert).solve([0.9, 0.0, 0.28, start]).trajectory.states[-1, 3] - start
    policy = make_policy(scene, LIMITS, SMALL)
    parameters = jax.tree.map(jnp.zeros_like, policy.init(jax.random.key(0)))
    parameters = parameters._replace(normalization=policy.init(jax.random.key(0)).normalization)
    measured = np.arctan2(np.sin(start), np.cos(start))  # as a quaternion gives it
    followed = follow(policy, parameters, scene, np.array([[0.9, 0.0, 0.28, measured]]), duration=12.0)
    driven = followed.poses[0, -1, 3] - measured
    assert planned == pytest.approx(turn, abs=1e-6)
    assert driven == pytest.approx(turn, abs=0.02)
    assert followed.outcome[0] == ARRIVED


def test_filter_only_takes_away_what_closes_on_the_obstacle_too_fast():
    scene = table_scene()
    filtered = jax.jit(lambda p, v: brake_before_obstacles(scene, p, v, jnp.asarray(ACCELERATION), 0.01))
    forward = np.array([0.8, 0.2, 0.0, 0.0])
    for gap in (0.3, 0.05, 0.02, 0.011, 0.005):  # in front of the table, facing it
        pose = np.array([1.25 - scene.torso_half_size[0] - gap, 0.0, 0.28, 0.0])
        allowed = np.sqrt(2 * 1.5 * max(gap - 0.01, 0))
        np.testing.assert_allclose(filtered(pose, forward), [min(0.8, allowed), 0.2, 0, 0], atol=2e-3)
        np.testing.assert_allclose(filtered(pose, -forward), -forward, atol=1e-6)
    under = np.array([1.5, 0.0, 0.25 - scene.torso_half_size[2] - 0.03, 0.0])
    rising = np.array([0.8, 0.0, 0.3, 0.0])
    np.testing.assert_allclose(filtered(under, rising), [0.8, 0, np.sqrt(2 * 1.0 * 0.02), 0], atol=2e-3)
    unbothered = jax.jit(lambda p, v: brake_before_obstacles(empty_scene(), p, v, jnp.asarray(ACCELERATION), 0.01))
    np.testing.assert_array_equal(unbothered(under, rising), rising.astype(np.float32))


def test_filtered_field_stops_before_the_table_that_it_drives_straight_at():
    scene = table_scene()
    starts = np.random.default_rng(0).uniform([-0.5, -0.4, 0.2, -0.5], [0.8, 0.4, 0.3, 0.5], (64, 4))
    starts = starts[clearance(scene, starts) > 0.03]
    outcomes = {}
    for field_filter in (False, True):
        policy = make_policy(scene, LIMITS, SMALL.model_copy(update={"field_filter": field_filter}))
        parameters = policy.init(jax.random.key(0))
        parameters = parameters._replace(network=jax.tree.map(jnp.zeros_like, parameters.network))
        outcomes[field_filter] = follow(policy, parameters, scene, starts, 0.02, ACCELERATION / 0.92, 4.0)
    assert (outcomes[False].outcome == COLLIDED).all()
    assert (outcomes[True].outcome != COLLIDED).all()
    assert outcomes[True].min_clearance.min() > 0.01  # of the 0.02 that the filter keeps
