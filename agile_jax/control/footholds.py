"""Where feet land: the foothold (Raibert 1986) within what the legs reach, and where feet stand ahead."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.arrays import AnyArray
from agile_jax.control import gait
from agile_jax.control.body import Body, Reference
from agile_jax.control.settings import ControlSettings, GaitSettings
from agile_jax.geometry import rotation_2d
from agile_jax.robot import GRAVITY, RobotModel, RobotState, overshoot


def plan_footholds(
    robot: RobotModel,
    settings: ControlSettings,
    window: Float[Array, "2"],
    nominal_feet: Float[AnyArray, "4 2"],
    clock: gait.Gait,
    robot_state: RobotState,
    body: Body,
    reference: Reference,
) -> Float[Array, "4 3"]:
    """Foothold of each leg's current or next swing, in the world [m].

    Args:
        robot: constants.
        settings: gait and `raibert_gain`.
        window: the least and the largest x of a standing foot from its hip, at the height to come [m].
        nominal_feet: where the feet are under a robot that stands, in the plane of its trunk [m].
        clock: state of the gait.
        robot_state, body: measured.
        reference: of the trunk.
    """
    yaw_rate = (body.R_world_base @ robot_state.base_ang_vel_base)[2]
    time_left = gait.time_to_touch_down(clock)  # (4,)
    velocity = body.com_velocity_world[:2]
    rotation = rotation_2d(body.rpy[2] + yaw_rate * time_left, jnp)  # (4, 2, 2)
    hips = robot_state.base_pos[:2] + velocity * time_left[:, None] + jnp.einsum("lij,lj->li", rotation, nominal_feet)
    planar = foothold(
        hips,
        velocity,
        reference.velocity[:2],
        yaw_rate,
        body.com_world[2],
        gait.stance_duration(settings.gait, clock),
        settings.raibert_gain,
    )
    offset = jnp.einsum("lji,lj->li", rotation, planar - hips)
    speed = velocity @ jnp.stack([jnp.cos(body.rpy[2]), jnp.sin(body.rpy[2])])
    stands = gait.duty(settings.gait, clock)
    offset = offset.at[:, 0].set(within_window(offset[:, 0], speed * clock.period, stands, window))
    planar = hips + jnp.einsum("lij,lj->li", rotation, offset)
    return jnp.concatenate([planar, jnp.full((4, 1), robot.foot_radius)], -1)


def plan_support(
    settings: GaitSettings,
    clock: gait.Gait,
    elapsed: Float[Array, " N"],
    feet_world: Float[Array, "4 3"],
    footholds_world: Float[Array, "4 3"],
    reference: Reference,
) -> Float[Array, "N 4 3"]:
    """Where each foot stands at the nodes, in the world [m]: here, then on its foothold, then a stride further.

    Args:
        settings: of the gait.
        clock: state of the gait.
        elapsed: from now to the nodes [s].
        feet_world: where the feet are [m].
        footholds_world: from `plan_footholds` [m].
        reference: of the trunk, whose velocity makes the strides after the first.
    """
    here = clock.landed | gait.late(settings, clock)
    early = clock.landed & ~gait.scheduled(settings, clock)  # the landing of the present swing has been
    landings = gait.landings_ahead(settings, clock, elapsed)  # (N, 4)
    stride = jnp.concatenate([reference.velocity[:2], jnp.zeros(1)]) * clock.period
    ahead = footholds_world + jnp.maximum(landings - 1, 0)[..., None] * stride
    return jnp.where((here & (landings <= early))[..., None], feet_world, ahead)


def foothold(
    hip_ground: jax.Array,
    velocity: jax.Array,
    velocity_reference: jax.Array,
    yaw_rate: jax.Array,
    height: jax.Array,
    stance_duration: jax.Array | float,
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


def within_window(
    landing: Float[Array, "4"], stride: Float[Array, ""], stands: Float[Array, ""], window: Float[Array, "2"]
) -> Float[Array, "4"]:
    """The nearest places to land whose whole stride stays within the window of a foot, seen from its hip [m].

    From there the foot moves back by the stance's share of the stride; in the air it passes both ends (`overshoot`).
    A stride that is too long for the window stands out of it on both sides alike.

    Args:
        landing: ahead of the hip [m].
        stride: way of the body in one period, forward [m].
        stands: fraction of the period that a foot stands [-].
        window: the least and the largest x of a foot [m].
    """
    way, passed = stands * stride, overshoot(stands, jnp) * jnp.abs(stride)
    least = window[0] + passed + jnp.maximum(way, 0.0)
    most = window[1] - passed + jnp.minimum(way, 0.0)
    middle = (least + most) / 2
    return jnp.clip(landing, jnp.minimum(least, middle), jnp.maximum(most, middle))
