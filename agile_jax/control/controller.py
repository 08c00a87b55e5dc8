"""The whole-body controller of one robot: plan at the rate of the MPC, act at the rate of the torques.

`plan` solves the MPC for the foot forces and sets the footholds; `act` turns forces and swing paths into joint
torques. Both are pure functions of one robot's state; callers vmap them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.control import cone_qp, gait, torques
from agile_jax.control.centroidal import BodyState
from agile_jax.control.mpc import MpcConstants, build_qp, mpc_constants
from agile_jax.control.scaling import scaled_to
from agile_jax.control.settings import ControlSettings
from agile_jax.control.swing import feed_forward_share, folded_leg, foothold, forward_reach
from agile_jax.geometry import quaternion_to_matrix, quaternion_to_rpy, rotation_2d, wrap_angle
from agile_jax.robot import RobotModel, RobotState, composite_inertia, leg_forward_kinematics

SWING_LEAD = 0.15  # share of the swing left when the foot has made 94 % of its way
REACH_SPEED = 0.3  # at which a foot that misses the ground reaches further down [m/s]
REACH_DEPTH = 0.05  # below the floor's height, at most [m]
# The robot stands where its reference hardly moves and its own motion is below these; once it stands, twice as much.
REST_SPEED, REST_YAW_RATE = 0.15, 0.1  # of the body [m/s], of the reference [rad/s]
REST_DISTANCE, REST_YAW = 0.03, 0.05  # between body and reference [m], [rad]


class Reference(NamedTuple):
    """What the trunk should do. Poses are [x, y, z, yaw] in the world [m, rad]; N nodes of the MPC."""

    pose: jax.Array  # (4,) now
    velocity: jax.Array  # (4,) now [m/s, rad/s]
    poses: jax.Array  # (N, 4) at the ends of the MPC's steps
    velocities: jax.Array  # (N, 4)


class ControllerState(NamedTuple):
    """What the controller remembers between calls."""

    gait: gait.Gait
    lift_off_world: jax.Array  # (4, 3) where each foot last left the ground [m]
    foothold_world: jax.Array  # (4, 3) where each swing should end [m]
    velocity_planar: jax.Array  # (2,) measured velocity of the centre of mass at the last plan, world [m/s]
    forces_world: jax.Array  # (4, 3) planned forces of the ground on the feet [N]
    integral: jax.Array  # (3,) correction of height [m], roll, pitch [rad]
    warm_start: cone_qp.WarmStart
    residual: jax.Array  # () of the last MPC solution [N]
    mpc_failures: jax.Array  # () int32, solutions whose residual exceeded the tolerance


class Controller(NamedTuple):
    """A controller as three pure functions of one robot."""

    init: Callable[[RobotState], ControllerState]
    plan: Callable[[ControllerState, RobotState, Reference], ControllerState]
    act: Callable[[ControllerState, RobotState], tuple[ControllerState, jax.Array]]


class Body(NamedTuple):
    """The measured state, as the planner sees it."""

    R_world_base: jax.Array  # (3, 3)
    rpy: jax.Array  # (3,) [rad]
    com_world: jax.Array  # (3,) [m]
    com_velocity_world: jax.Array  # (3,) [m/s]
    mass: jax.Array  # () [kg]
    inertia_base: jax.Array  # (3, 3) about the centre of mass [kg m^2]
    com_base: jax.Array  # (3,) [m]


def measure(robot: RobotModel, state: RobotState) -> Body:
    """Composite mass properties at the current posture, and the motion of the centre of mass."""
    R_world_base = quaternion_to_matrix(state.base_quat, jnp)

    def center(joint_pos: jax.Array) -> jax.Array:
        return composite_inertia(robot, joint_pos)[1]

    mass, com_base, inertia = composite_inertia(robot, state.joint_pos)
    _, com_rate = jax.jvp(center, (state.joint_pos,), (state.joint_vel,))
    velocity = state.base_lin_vel_world + R_world_base @ (jnp.cross(state.base_ang_vel_base, com_base) + com_rate)
    return Body(
        R_world_base,
        quaternion_to_rpy(state.base_quat, jnp),
        state.base_pos + R_world_base @ com_base,
        velocity,
        mass,
        inertia,
        com_base,
    )


def make_controller(robot: RobotModel, settings: ControlSettings) -> Controller:
    """Compose gait, MPC, footholds and torques for a robot."""
    settings = scaled_to(robot, settings)
    constants = mpc_constants(settings.mpc)
    gait_settings = settings.gait
    foot_height = robot.foot_radius  # of a foot's centre when it stands on the floor z = 0
    inertia = torques.leg_inertia(robot, np.asarray(robot.home_joint_pos, np.float32))
    leg_length = robot.thigh_length + robot.calf_length
    knee_limit_height = folded_leg(robot) + foot_height

    def init(state: RobotState) -> ControllerState:
        R = quaternion_to_matrix(state.base_quat, jnp)
        feet = state.base_pos + leg_forward_kinematics(robot, state.joint_pos) @ R.T
        weight = composite_inertia(robot, state.joint_pos)[0] * 9.81
        return ControllerState(
            gait=gait.start(gait_settings),
            lift_off_world=feet,
            foothold_world=feet,
            velocity_planar=jnp.zeros(2),
            forces_world=jnp.zeros((4, 3)).at[:, 2].set(weight / 4),
            integral=jnp.zeros(3),
            warm_start=cone_qp.cold_start(settings.mpc.horizon),
            residual=jnp.float32(0.0),
            mpc_failures=jnp.int32(0),
        )

    def plan(state: ControllerState, robot_state: RobotState, reference: Reference) -> ControllerState:
        body = measure(robot, robot_state)
        yaw = body.rpy[2]
        R_yaw = rotation_2d(yaw, jnp)
        feet_world = robot_state.base_pos + leg_forward_kinematics(robot, robot_state.joint_pos) @ body.R_world_base.T

        speed = jnp.sqrt(jnp.sum(reference.velocities[:, :2] ** 2, -1)).max()
        clock = gait.schedule(
            gait_settings, state.gait, speed, at_rest(state, body, robot_state, reference), settings.plan_dt
        )
        footholds = plan_footholds(clock, robot_state, body, reference)
        error = jnp.stack([reference.pose[2] - robot_state.base_pos[2], -body.rpy[0], -body.rpy[1]])
        limit = jnp.array(settings.integral_limit)
        integral = state.integral + jnp.array(settings.integral_gain) * error * settings.plan_dt
        integral = jnp.clip(integral, -limit, limit)

        nodes = settings.mpc.horizon
        elapsed = settings.plan_dt / 2 + settings.mpc.mpc_dt * jnp.arange(nodes)
        contact = gait.contacts_ahead(gait_settings, clock, elapsed).astype(jnp.float32)
        # Feet that stand now keep their place; feet that land within the horizon stand on their foothold.
        standing = gait.standing(gait_settings, clock)
        support = jnp.where(standing[:, None], feet_world, footholds)
        travelled = jnp.concatenate([reference.pose[None], reference.poses[:-1]])[:, :3] - reference.pose[:3]
        levers = support[None] - (body.com_world + travelled)[:, None, :]  # (N, 4, 3) world
        levers = jnp.concatenate([levers[..., :2] @ R_yaw, levers[..., 2:]], -1)  # yaw frame

        qp = build_qp(
            constants,
            settings.mpc,
            body_in_yaw_frame(robot_state, body, R_yaw),
            reference_in_yaw_frame(reference, body, yaw, R_yaw, integral),
            body.mass,
            inertia_in_yaw_frame(body),
            levers,
            contact,
        )
        solution = cone_qp.solve(qp, state.warm_start, settings.mpc.iterations)
        forces_yaw = solution.forces[0].reshape(4, 3)
        forces_world = jnp.concatenate([forces_yaw[:, :2] @ R_yaw.T, forces_yaw[:, 2:]], -1)
        residual = jnp.maximum(solution.primal_residual, solution.dual_residual)
        return state._replace(
            gait=clock,
            foothold_world=footholds,
            velocity_planar=body.com_velocity_world[:2],
            forces_world=forces_world,
            integral=integral,
            warm_start=solution.warm_start,
            residual=residual,
            # Not "residual > tolerance": a residual that is not a number is a failure too.
            mpc_failures=state.mpc_failures + jnp.int32(~(residual <= settings.mpc.tolerance)),
        )

    def at_rest(state: ControllerState, body: Body, robot_state: RobotState, reference: Reference) -> jax.Array:
        """Whether nothing asks for a step: () bool."""
        patience = jnp.where(state.gait.stand, 2.0, 1.0)
        speeds = jnp.sqrt(jnp.sum(reference.velocities[:, :2] ** 2, -1))
        distance = jnp.sqrt(jnp.sum((reference.pose[:2] - robot_state.base_pos[:2]) ** 2))
        turn = jnp.abs(wrap_angle(reference.pose[3] - body.rpy[2], jnp))
        return (
            (speeds.max() < patience * gait_settings.stand_speed)
            & (jnp.abs(reference.velocities[:, 3]).max() < patience * REST_YAW_RATE)
            & (distance < patience * REST_DISTANCE)
            & (turn < patience * REST_YAW)
            & (jnp.sqrt(jnp.sum(body.com_velocity_world[:2] ** 2)) < patience * REST_SPEED)
        )

    def plan_footholds(clock: gait.Gait, robot_state: RobotState, body: Body, reference: Reference) -> jax.Array:
        """Foothold of each leg's current or next swing, shape (4, 3) in the world [m]."""
        yaw_rate = (body.R_world_base @ robot_state.base_ang_vel_base)[2]
        time_left = gait.time_to_touch_down(clock)  # (4,)
        velocity = body.com_velocity_world[:2]
        nominal = robot.hip_pos_base[:, :2] + jnp.stack([jnp.zeros(4), robot.abad_offset], -1)
        rotation = rotation_2d(body.rpy[2] + yaw_rate * time_left, jnp)  # (4, 2, 2)
        hips = robot_state.base_pos[:2] + velocity * time_left[:, None] + jnp.einsum("lij,lj->li", rotation, nominal)
        planar = foothold(
            hips,
            velocity,
            reference.velocity[:2],
            yaw_rate,
            body.com_world[2],
            gait.stance_duration(gait_settings, clock),
            settings.raibert_gain,
        )
        # A crouching leg cannot reach far ahead; the height to come counts, not the present one.
        height = jnp.minimum(robot_state.base_pos[2], reference.poses[:, 2].min())
        reach = forward_reach(height, robot.thigh_length, robot.calf_length, foot_height, settings.knee_clearance)
        # The smooth swing is near its foothold early, while the hip still has to come: that much less.
        speed = velocity @ jnp.stack([jnp.cos(body.rpy[2]), jnp.sin(body.rpy[2])])
        reach -= SWING_LEAD * gait.swing_duration(gait_settings, clock) * jnp.maximum(speed, 0.0)
        offset = jnp.einsum("lji,lj->li", rotation, planar - hips)
        offset = offset.at[:, 0].set(jnp.minimum(offset[:, 0], reach))
        planar = hips + jnp.einsum("lij,lj->li", rotation, offset)
        return jnp.concatenate([planar, jnp.full((4, 1), foot_height)], -1)

    def act(state: ControllerState, robot_state: RobotState) -> tuple[ControllerState, jax.Array]:
        R = quaternion_to_matrix(robot_state.base_quat, jnp)
        feet_base = leg_forward_kinematics(robot, robot_state.joint_pos)
        clock = state.gait
        feet_world = robot_state.base_pos + feet_base @ R.T
        by_clock = gait.scheduled(gait_settings, clock)
        lift_off = jnp.where(by_clock[:, None], feet_world, state.lift_off_world)
        # A foot that landed early follows its path until the next plan gives it a force.
        bears = gait.standing(gait_settings, clock) & (by_clock | (state.forces_world[:, 2] > 0))
        speed = jnp.sqrt(jnp.sum(state.velocity_planar**2))
        late = gait.late_by(gait_settings, clock)
        torque = torques.whole_body_torque(
            robot,
            settings,
            inertia * feed_forward_share(robot_state.base_pos[2] / leg_length),
            robot_state,
            R,
            bears,
            state.forces_world,
            torques.SwingTarget(
                lift_off,
                state.foothold_world,
                gait.step_height(gait_settings, speed, robot_state.base_pos[2] - knee_limit_height),
                gait.swing_progress(gait_settings, clock),
                gait.swing_duration(gait_settings, clock),
                jnp.minimum(REACH_SPEED * late, REACH_DEPTH),
                jnp.where((late > 0) & (REACH_SPEED * late < REACH_DEPTH), REACH_SPEED, 0.0),
            ),
        )
        following = gait.advance(gait_settings, clock, settings.control_dt, robot_state.foot_contact)
        return state._replace(gait=following, lift_off_world=lift_off), torque

    return Controller(init, plan, act)


def body_in_yaw_frame(robot_state: RobotState, body: Body, R_yaw: jax.Array) -> BodyState:
    """The current state with the origin at the centre of mass's ground point and x along the heading."""
    position = jnp.concatenate([body.rpy[:2], jnp.zeros(3), body.com_world[2:]])
    angular = body.R_world_base @ robot_state.base_ang_vel_base
    linear = body.com_velocity_world
    velocity = jnp.concatenate([angular[:2] @ R_yaw, angular[2:], linear[:2] @ R_yaw, linear[2:]])
    return BodyState(position, velocity)


def reference_in_yaw_frame(
    reference: Reference, body: Body, yaw: jax.Array, R_yaw: jax.Array, integral: jax.Array
) -> BodyState:
    """The reference of the centre of mass at the nodes, with the integral correction, shape (N, 6) each."""
    nodes = len(reference.poses)
    yaws = wrap_angle(reference.poses[:, 3] - yaw, jnp)
    # The trunk's reference, shifted to the centre of mass with the trunk level at the reference's yaw.
    offset = jnp.einsum("nij,j->ni", rotation_2d(reference.poses[:, 3], jnp), body.com_base[:2])
    planar = (reference.poses[:, :2] + offset - body.com_world[:2]) @ R_yaw
    height = reference.poses[:, 2] + body.com_base[2] + integral[0]
    tilt = jnp.broadcast_to(integral[1:], (nodes, 2))
    position = jnp.concatenate([tilt, yaws[:, None], planar, height[:, None]], -1)
    velocities = reference.velocities
    velocity = jnp.concatenate(
        [jnp.zeros((nodes, 2)), velocities[:, 3:], velocities[:, :2] @ R_yaw, velocities[:, 2:3]], -1
    )
    return BodyState(position, velocity)


def inertia_in_yaw_frame(body: Body) -> jax.Array:
    """Inertia about the centre of mass, turned by roll and pitch only. Shape (3, 3) [kg m^2]."""
    c, s = jnp.cos(body.rpy[2]), jnp.sin(body.rpy[2])
    R_yaw_world = jnp.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    R = R_yaw_world @ body.R_world_base
    return R @ body.inertia_base @ R.T


__all__ = ["Controller", "ControllerState", "MpcConstants", "Reference", "make_controller", "measure"]
