"""The estimator on a motion that is known exactly: a trunk over feet that are points and stand where they stand."""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from agile_jax.control import Belief, Estimator, Measured
from agile_jax.control.estimator.kalman import correct, predict
from agile_jax.geometry import quaternion_product, quaternion_to_rpy, rotation_quaternion
from agile_jax.robot import GRAVITY, RobotSettings, SensorSettings, leg_inverse_kinematics, leg_jacobian, load_robot
from agile_jax.single_precision import in_float32

ROBOT = load_robot(RobotSettings())._replace(foot_radius=0.0)
DT, STEPS = 0.002, 1500
NOISE = SensorSettings(gyro_bias=0.02, accelerometer_bias=0.3, encoder_bias=0.0, delay=0.0)
EXACT = SensorSettings(**{name: 0.0 for name, value in NOISE if isinstance(value, float)})


class Motion(NamedTuple):
    """The truth, and what perfect sensors see."""

    position: np.ndarray
    velocity: np.ndarray
    quat: np.ndarray
    measured: Measured


def motion(speed: float, wobble: float) -> Motion:
    """From rest, the trunk goes ahead [m/s] and wobbles [m, rad]; diagonal feet stand in turns, first under their hips.

    At no speed all feet stand for good. Differences of positions are the velocities, as in the physics.
    """
    time = DT * np.arange(STEPS + 1)
    begun = np.clip(time[:, None] / 0.5, 0.0, 1.0) ** 2
    swing = begun * wobble * np.sin(2 * np.pi * time[:, None] * [1.0, 1.7, 2.3, 1.3, 0.7, 0.4])
    position = np.array([0.0, 0.0, 0.27]) + begun * speed * time[:, None] * [1.0, 0.0, 0.0] + swing[:, :3]
    velocity = np.diff(position, axis=0) / DT
    rotation = Rotation.from_euler("ZYX", swing[:, 3:] + [0.5, 0.0, 0.0])
    turn_rate = (rotation[:-1].inv() * rotation[1:]).as_rotvec() / DT
    matrix = rotation[1:].as_matrix()
    force = np.diff(velocity, axis=0, prepend=velocity[:1]) / DT + [0.0, 0.0, GRAVITY]

    hips = np.asarray(ROBOT.hip_pos_base) + np.outer(ROBOT.abad_offset, [0.0, 1.0, 0.0])
    under = position[1:, None] + hips @ matrix.transpose(0, 2, 1)
    phase = np.arange(STEPS) // 70
    first = np.where(np.full(STEPS, speed) > 0, phase * 70, 0)  # where the feet that stand were put down
    feet = np.concatenate([under[first][:, :, :2], np.zeros((STEPS, 4, 1))], -1)
    standing = np.ones((STEPS, 4), bool)
    if speed > 0:
        standing = np.where(phase[:, None] % 2 == 0, [True, False, False, True], [False, True, True, False])
    base = np.einsum("kij,kli->klj", matrix, feet - position[1:, None])
    joint_pos = np.asarray(jax.vmap(lambda foot: leg_inverse_kinematics(ROBOT, foot))(jnp.float32(base)))
    jacobian = np.asarray(jax.vmap(lambda q: leg_jacobian(ROBOT, q))(joint_pos), float)
    away = np.einsum("kij,ki->kj", matrix, velocity)[:, None] + np.cross(turn_rate[:, None], base)
    joint_vel = -np.linalg.solve(jacobian, away[..., None])[..., 0].reshape(STEPS, 12)
    pose = np.stack([position[1:, 0], position[1:, 1], quaternion_to_rpy(_wxyz(rotation[1:]))[:, 2]], -1)
    measured = Measured(
        turn_rate,
        np.einsum("kij,ki->kj", matrix, force),
        joint_pos,
        joint_vel,
        standing,
        np.arange(STEPS) % 10 == 0,
        pose,
    )
    return Motion(position[1:], velocity, _wxyz(rotation[1:]), jax.tree.map(_single, measured))


def _wxyz(rotation: Rotation) -> np.ndarray:
    return np.roll(rotation.as_quat(), 1, -1)


def _single(values: np.ndarray) -> np.ndarray:
    return values if values.dtype == bool else np.float32(values)


def disturbed(measured: Measured, sensors: SensorSettings, seed: int) -> tuple[Measured, np.ndarray]:
    """What real sensors see, and the biases of gyroscope and accelerometer (6,)."""
    rng = np.random.default_rng(seed)
    bias = rng.normal(size=6) * np.repeat([sensors.gyro_bias, sensors.accelerometer_bias], 3)
    scale = sensors.gyro_noise, sensors.accelerometer_noise, sensors.encoder_noise, sensors.joint_velocity_noise
    add = bias[:3], bias[3:], 0.0, 0.0
    values = [
        np.float32(value + shift + size * rng.normal(size=value.shape))
        for value, shift, size in zip(measured[:4], add, scale, strict=True)
    ]
    return Measured(*values, *(np.array(value) for value in measured[4:])), bias


@lru_cache
def follower(sensors: SensorSettings) -> Callable[[Measured], Belief]:
    """A compiled filter: from all samples to the beliefs after each but the first."""
    estimator = Estimator(ROBOT, sensors, DT)

    def step(belief: Belief, sample: Measured) -> tuple[Belief, Belief]:
        belief = estimator.update(belief, sample)
        return belief, belief

    @jax.jit
    @in_float32
    def run(measured: Measured) -> Belief:
        first, others = (jax.tree.map(lambda value, rows=rows: value[rows], measured) for rows in (0, slice(1, None)))
        return jax.lax.scan(step, estimator.init(first), others)[1]

    return run


def follow(measured: Measured, sensors: SensorSettings) -> Belief:
    """The beliefs after every sample but the first."""
    return jax.tree.map(np.asarray, follower(sensors)(measured))


WALK = motion(0.5, 0.04)


def rms(error: np.ndarray) -> float:
    return float(np.sqrt((error**2).sum(-1).mean()))


def turn_error(belief: Belief, truth: Motion) -> np.ndarray:
    """Of the orientation, in the world [rad]."""
    believed = Rotation.from_quat(np.roll(belief.quat, -1, -1))
    return (Rotation.from_quat(np.roll(truth.quat[1:], -1, -1)) * believed.inv()).as_rotvec()


def test_perfect_sensors_give_the_true_state():
    belief = follow(WALK.measured, EXACT)
    np.testing.assert_allclose(belief.position, WALK.position[1:], atol=2e-3)
    np.testing.assert_allclose(belief.velocity, WALK.velocity[1:], atol=2e-3)
    assert np.abs(turn_error(belief, WALK)).max() < 1e-3


def test_noise_and_biases_of_a_walk_are_filtered():
    belief = follow(disturbed(WALK.measured, NOISE, 1)[0], NOISE)
    assert rms(belief.velocity - WALK.velocity[1:]) < 0.02
    assert rms((belief.position - WALK.position[1:])[:, 2:]) < 2e-3
    assert rms(turn_error(belief, WALK)[:, :2]) < 0.01


def test_biases_that_gravity_and_legs_show_are_found():
    """All but that of the yaw's rate, which the legs show slowly."""
    left = []
    for seed in range(6):
        measured, bias = disturbed(WALK.measured, NOISE, seed)
        belief = follow(measured, NOISE)
        left.append(np.concatenate([belief.gyro_bias[-1], belief.accelerometer_bias[-1]]) - bias)
    left_rms = np.sqrt(np.square(left).mean(0))
    assert (left_rms[[0, 1]] < 0.25 * NOISE.gyro_bias).all()
    assert (left_rms[3:] < 0.25 * NOISE.accelerometer_bias).all()


def test_a_standing_robot_stays_where_it_is():
    still = motion(0.0, 0.0)
    belief = follow(disturbed(still.measured, NOISE, 3)[0], NOISE)
    later = slice(STEPS // 2, None)
    assert rms((belief.position - still.position[1:])[later, :2]) < 0.02
    assert rms((belief.position - still.position[1:])[later, 2:]) < 1e-3
    assert rms(belief.velocity[later]) < 0.01
    assert rms(turn_error(belief, still)[later, :2]) < 0.01


def test_the_filter_knows_how_wrong_it_is():
    """Squared errors over believed variances: their mean is 1 where the filter's noise is that of the sensors, and less
    where feet are assumed to slip, which do not here. A filter that is sure and wrong has more.
    """
    squares = []
    for seed in range(6):
        belief = follow(disturbed(WALK.measured, NOISE, seed)[0], NOISE)
        variance = np.diagonal(belief.covariance, axis1=1, axis2=2)
        errors = np.concatenate(
            [belief.position - WALK.position[1:], belief.velocity - WALK.velocity[1:], turn_error(belief, WALK)], -1
        )
        squares.append((errors**2 / variance[:, :9])[200::100])
    mean = np.mean(squares, (0, 1))
    assert (mean < 2.5).all(), mean
    assert (mean > 0.01).all(), mean


def test_a_wrong_start_stays_unless_the_place_is_told():
    measured, _ = disturbed(WALK.measured, NOISE, 0)
    measured.planar_pose[0] += [0.03, -0.03, 0.03]
    told = follow(measured, NOISE.model_copy(update={"localisation_rate": 50.0}))
    lost = follow(measured, NOISE)
    for belief, low, high in ((lost, 0.02, 0.1), (told, 0.0, 0.01)):
        assert low < rms((belief.position - WALK.position[1:])[-200:, :2]) < high
        assert low < rms(turn_error(belief, WALK)[-200:, 2:]) < high


def test_old_measurements_are_carried_on():
    late = EXACT.model_copy(update={"delay": 0.01})
    estimator = Estimator(ROBOT, late, DT)
    belief, k = follow(WALK.measured, EXACT), 900
    one = jax.tree.map(lambda value: jnp.asarray(value[k - 1]), belief)
    state = estimator.robot_state(one, jax.tree.map(lambda value: jnp.asarray(value[k]), WALK.measured))
    for carried, old, truth in (
        (state.base_pos, WALK.position[k], WALK.position[k + 5]),
        (state.base_lin_vel_world, WALK.velocity[k], WALK.velocity[k + 5]),
        (state.base_quat, WALK.quat[k], WALK.quat[k + 5]),
        (state.joint_pos[:3], WALK.measured.joint_pos[k, :3], WALK.measured.joint_pos[k + 5, :3]),
    ):
        assert np.abs(carried - truth).max() < 0.5 * np.abs(old - truth).max()


def shifted(belief: Belief, error: np.ndarray) -> Belief:
    """The belief with an error taken back: it is true where the error was."""
    parts = np.split(np.asarray(error, np.float32), 5)
    return belief._replace(
        position=belief.position + parts[0],
        velocity=belief.velocity + parts[1],
        quat=quaternion_product(rotation_quaternion(parts[2]), belief.quat),
        gyro_bias=belief.gyro_bias + parts[3],
        accelerometer_bias=belief.accelerometer_bias + parts[4],
    )


def test_the_rows_are_the_derivatives_of_what_the_feet_measure():
    estimator = Estimator(load_robot(RobotSettings()), NOISE, DT)
    measured = jax.tree.map(lambda value: value[300], WALK.measured)._replace(foot_contact=np.ones(4, bool))
    truth = WALK.position[300], WALK.velocity[300], WALK.quat[300]
    zero = np.zeros(3, np.float32)
    belief = Belief(*map(np.float32, truth), zero, zero, np.eye(15, dtype=np.float32), np.ones(4, np.float32))
    rows = np.asarray(estimator._feet(belief, measured).rows)
    for k, step in enumerate(1e-2 * np.eye(15)):
        ahead, behind = (estimator._feet(shifted(belief, sign * step), measured).innovation for sign in (1, -1))
        slope = -np.asarray(ahead - behind) / 2e-2
        # The rolling of the foot about a vertical that turns is left out: up to its radius times the joints' speed.
        np.testing.assert_allclose(rows[:, k], slope, atol=0.05 if 6 <= k < 9 else 2e-4)


@pytest.mark.parametrize("seed", range(3))
def test_the_linear_filter_is_least_squares(seed: int):
    """Kalman's filter of a body with an unknown constant acceleration against all measurements at once, in float64."""
    rng = np.random.default_rng(seed)
    transition, row = np.array([[1.0, 0.1, 0.005], [0.0, 1.0, 0.1], [0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]])
    start, samples = np.array([0.5, 1.0, 0.2]), 40
    places = [(row @ np.linalg.matrix_power(transition, k + 1))[0] for k in range(samples)]
    truth = start * rng.normal(size=3)
    seen = np.array(places) @ truth + 0.1 * rng.normal(size=samples)

    state, covariance = jnp.zeros(3), jnp.diag(jnp.float32(start**2))
    for value in seen:
        state, covariance = transition @ state, predict(covariance, jnp.float32(transition), jnp.zeros(3))
        change, covariance = correct(covariance, jnp.float32(row), jnp.array([0.01]), jnp.float32(value - row @ state))
        state = state + change
    information = np.diag(start**-2.0) + np.transpose(places) @ places / 0.01
    first = np.linalg.solve(information, np.transpose(places) @ seen / 0.01)
    to_the_end = np.linalg.matrix_power(transition, samples)
    np.testing.assert_allclose(state, to_the_end @ first, atol=5e-3)
    np.testing.assert_allclose(covariance, to_the_end @ np.linalg.inv(information) @ to_the_end.T, rtol=0.02, atol=1e-6)


def test_a_row_of_zeros_tells_nothing():
    covariance = jnp.diag(jnp.array([1.0, 2.0]))
    change, after = correct(covariance, jnp.zeros((1, 2)), jnp.ones(1), jnp.ones(1))
    np.testing.assert_array_equal(change, 0.0)
    np.testing.assert_array_equal(after, covariance)
