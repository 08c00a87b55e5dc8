"""Where feet land: the foothold (Raibert 1986), how far ahead a crouching leg can reach, where feet stand ahead."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from agile_jax.arrays import AnyArray
from agile_jax.control import gait
from agile_jax.control.body import Body, Reference
from agile_jax.control.settings import ControlSettings, GaitSettings
from agile_jax.geometry import rotation_2d
from agile_jax.robot import GRAVITY, RobotModel, RobotState

SWING_LEAD = 0.15  # share of the swing left when the foot has made 94 % of its way


def plan_footholds(
    robot: RobotModel,
    settings: ControlSettings,
    nominal_feet: Float[AnyArray, "4 2"],
    clock: gait.Gait,
    robot_state: RobotState,
    body: Body,
    reference: Reference,
) -> Float[Array, "4 3"]:
    """Foothold of each leg's current or next swing, in the world [m].

    Args:
        robot: constants.
        settings: gait, `raibert_gain` and `knee_clearance`.
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
    # A crouching leg cannot reach far ahead; the height to come counts, not the present one.
    height = jnp.minimum(robot_state.base_pos[2], reference.poses[:, 2].min())
    reach = forward_reach(height, robot.thigh_length, robot.calf_length, robot.foot_radius, settings.knee_clearance)
    # The smooth swing is near its foothold early, while the hip still has to come: that much less.
    speed = velocity @ jnp.stack([jnp.cos(body.rpy[2]), jnp.sin(body.rpy[2])])
    reach -= SWING_LEAD * gait.swing_duration(settings.gait, clock) * jnp.maximum(speed, 0.0)
    offset = jnp.einsum("lji,lj->li", rotation, planar - hips)
    offset = offset.at[:, 0].set(jnp.minimum(offset[:, 0], reach))
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
    standing = gait.standing(settings, clock)
    early = standing & ~gait.scheduled(settings, clock)  # the landing of the present swing has been
    landings = gait.landings_ahead(settings, clock, elapsed)  # (N, 4)
    stride = jnp.concatenate([reference.velocity[:2], jnp.zeros(1)]) * clock.period
    ahead = footholds_world + jnp.maximum(landings - 1, 0)[..., None] * stride
    return jnp.where((standing & (landings <= early))[..., None], feet_world, ahead)


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
