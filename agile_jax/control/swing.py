"""Swing legs: the foothold (Raibert 1986) and the foot's path to it."""

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.robot import GRAVITY, RobotModel

FOLDED, UPRIGHT = 0.5, 0.6  # height over leg length between which the swing's feed-forward fades in


def foothold(
    hip_ground: jax.Array,
    velocity: jax.Array,
    velocity_reference: jax.Array,
    yaw_rate: jax.Array,
    height: jax.Array,
    stance_duration: jax.Array,
    gain: float,
) -> jax.Array:
    """Where a foot should land, in the plane.

    The hip's position at touchdown, plus half of the way that the body covers during stance (the neutral point), plus
    the velocity error times `gain` (Raibert), plus the centripetal term z/g v x w of the turning body (Di Carlo et
    al. 2018, equation 33).

    Args:
        hip_ground: the hip's place on the ground at touchdown, shape (4, 2) [m].
        velocity, velocity_reference: of the body in the plane, shape (2,) [m/s].
        yaw_rate: () [rad/s].
        height: of the body () [m].
        stance_duration: [s].
        gain: [s].

    Returns:
        Shape (4, 2) [m].
    """
    neutral = velocity * stance_duration / 2
    centripetal = 0.5 * height / GRAVITY * jnp.stack([velocity[1] * yaw_rate, -velocity[0] * yaw_rate])
    return hip_ground + neutral + gain * (velocity - velocity_reference) + centripetal


def forward_reach(
    hip_height: jax.Array, thigh_length: float, calf_length: float, foot_radius: float, knee_clearance: float
) -> jax.Array:
    """How far ahead of its hip a foot can stand with the knee still off the floor [m].

    The knee bends backward: the further ahead the foot of a crouching robot, the steeper and lower the thigh. With
    the knee at height c and the foot's centre at r, the thigh spans sqrt(l1^2 - (h - c)^2) back and the calf
    sqrt(l2^2 - (c - r)^2) ahead.

    Args:
        hip_height: h [m].
        thigh_length, calf_length: l1, l2 [m].
        foot_radius: r [m].
        knee_clearance: c [m].
    """
    back = jnp.sqrt(jnp.maximum(thigh_length**2 - (hip_height - knee_clearance) ** 2, 0.0))
    return jnp.sqrt(calf_length**2 - (knee_clearance - foot_radius) ** 2) - back


def feed_forward_share(crouch: jax.Array) -> jax.Array:
    """Share of the swing's inertia that is fed forward, for the trunk's height over the leg's length.

    A folded leg that follows its path exactly raises its knee above the trunk while the foot is still behind, and hits
    what the robot crawls under; by PD alone it lags and stays low.
    """
    return jnp.clip((crouch - FOLDED) / (UPRIGHT - FOLDED), 0.0, 1.0)


def folded_leg(robot: RobotModel) -> float:
    """Shortest distance from hip to foot, the knee at its limit [m]."""
    l1, l2, knee = robot.thigh_length, robot.calf_length, robot.joint_lower[2]
    return float(np.sqrt(l1**2 + l2**2 + 2 * l1 * l2 * np.cos(knee)))


def swing_path(
    lift_off: jax.Array, touch_down: jax.Array, height: jax.Array, progress: jax.Array, duration: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Position and velocity on the way from `lift_off` to `touch_down`.

    A cubic smooth step in the plane, and for the height two of them, up and down: velocity is zero at both ends and
        at the top.

    Args:
        lift_off, touch_down: shape (..., 3) [m].
        height: of the apex above the higher end, shape (...) [m].
        progress: in [0, 1], shape (...).
        duration: of the whole swing [s].

    Returns:
        Position [m], velocity [m/s] and acceleration [m/s^2], shape (..., 3) each.
    """

    def smooth(s: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        return s * s * (3 - 2 * s), 6 * s * (1 - s), 6 - 12 * s

    way = (touch_down - lift_off)[..., :2]
    planar = [way * share[..., None] for share in smooth(progress)]
    planar[0] += lift_off[..., :2]
    apex = jnp.maximum(lift_off[..., 2], touch_down[..., 2]) + height
    rising = progress < 0.5
    rise = smooth(jnp.clip(2 * progress, 0.0, 1.0))
    fall = smooth(jnp.clip(2 * progress - 1, 0.0, 1.0))
    climb, drop = apex - lift_off[..., 2], touch_down[..., 2] - apex
    z = [jnp.where(rising, lift_off[..., 2] + climb * rise[0], apex + drop * fall[0])]
    z += [2**k * jnp.where(rising, climb * rise[k], drop * fall[k]) for k in (1, 2)]
    position, velocity, acceleration = (
        jnp.concatenate([planar[k], z[k][..., None]], -1) / duration**k for k in range(3)
    )
    return position, velocity, acceleration
