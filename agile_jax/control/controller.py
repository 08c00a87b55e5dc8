"""The whole-body controller of one robot: plan at the rate of the MPC, act at the rate of the torques.

`plan` solves the MPC for the foot forces and sets the footholds; `act` turns forces and swing paths into joint
torques. Both are pure functions of one robot's state; callers vmap them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from agile_jax.control import cone_qp, gait, torques
from agile_jax.control.body import Body, Reference, measure
from agile_jax.control.diagnostics import Diagnostics, after_act, after_plan, no_diagnostics
from agile_jax.control.mpc import Qp, mpc_constants, robot_qp
from agile_jax.control.settings import ControlSettings
from agile_jax.control.swing import foothold, forward_reach
from agile_jax.geometry import quaternion_to_matrix, rotation_2d
from agile_jax.robot import RobotModel, RobotState, composite_inertia, leg_forward_kinematics

KNEE_LIMIT_HEIGHT = 0.108  # trunk height at which the knee reaches its limit with the foot under the hip [m]
SWING_LEAD = 0.15  # share of the swing left when the foot has made 94 % of its way


class ControllerState(NamedTuple):
    """What the controller remembers between calls."""

    time: jax.Array  # () gait clock [s]
    lift_off_world: jax.Array  # (4, 3) where each foot last left the ground [m]
    foothold_world: jax.Array  # (4, 3) where each swing should end [m]
    velocity_planar: jax.Array  # (2,) measured velocity of the centre of mass at the last plan, world [m/s]
    forces_world: jax.Array  # (4, 3) planned forces of the ground on the feet [N]
    integral: jax.Array  # (3,) correction of height [m], roll, pitch [rad]
    warm_start: cone_qp.WarmStart
    diagnostics: Diagnostics


class Plan(NamedTuple):
    """What `plan` prepares for the solver."""

    qp: Qp
    body: Body
    footholds_world: jax.Array  # (4, 3) [m]
    integral: jax.Array  # (3,)


class Controller(NamedTuple):
    """A controller as pure functions of one robot."""

    init: Callable[[RobotState], ControllerState]
    problem: Callable[[ControllerState, RobotState, Reference], Qp]  # what `plan` solves
    plan: Callable[[ControllerState, RobotState, Reference], ControllerState]
    act: Callable[[ControllerState, RobotState], tuple[ControllerState, jax.Array]]


def make_controller(robot: RobotModel, settings: ControlSettings) -> Controller:
    """Compose gait, MPC, footholds and torques for a robot."""
    constants = mpc_constants(settings.mpc)
    solve = cone_qp.make_solver(constants, settings.mpc)
    gait_settings = settings.gait
    foot_height = robot.foot_radius  # of a foot's centre when it stands on the floor z = 0

    def init(state: RobotState) -> ControllerState:
        R = quaternion_to_matrix(state.base_quat, jnp)
        feet = state.base_pos + leg_forward_kinematics(robot, state.joint_pos) @ R.T
        weight = composite_inertia(robot, state.joint_pos)[0] * 9.81
        return ControllerState(
            time=jnp.float32(0.0),
            lift_off_world=feet,
            foothold_world=feet,
            velocity_planar=jnp.zeros(2),
            forces_world=jnp.zeros((4, 3)).at[:, 2].set(weight / 4),
            integral=jnp.zeros(3),
            warm_start=cone_qp.cold_start(settings.mpc.horizon),
            diagnostics=no_diagnostics(),
        )

    def problem(state: ControllerState, robot_state: RobotState, reference: Reference) -> Qp:
        return prepare(state, robot_state, reference).qp

    def prepare(state: ControllerState, robot_state: RobotState, reference: Reference) -> Plan:
        body = measure(robot, robot_state)
        feet_world = robot_state.base_pos + leg_forward_kinematics(robot, robot_state.joint_pos) @ body.R_world_base.T

        footholds = plan_footholds(state.time, robot_state, body, reference)
        error = jnp.stack([reference.pose[2] - robot_state.base_pos[2], -body.rpy[0], -body.rpy[1]])
        limit = jnp.array(settings.integral_limit)
        integral = state.integral + jnp.array(settings.integral_gain) * error * settings.plan_dt
        integral = jnp.clip(integral, -limit, limit)

        contact_times = state.time + settings.plan_dt / 2 + settings.mpc.mpc_dt * jnp.arange(settings.mpc.horizon)
        contact = gait.stance(gait_settings, contact_times).astype(jnp.float32)
        support = plan_support(state.time, contact_times, feet_world, footholds, reference)
        qp = robot_qp(constants, settings.mpc, robot, robot_state, body, reference, integral, support, contact)
        return Plan(qp, body, footholds, integral)

    def plan(state: ControllerState, robot_state: RobotState, reference: Reference) -> ControllerState:
        qp, body, footholds, integral = prepare(state, robot_state, reference)
        solution = solve(qp, cone_qp.shift(state.warm_start, settings.plan_dt / settings.mpc.mpc_dt))
        forces_world = solution.forces[0].reshape(4, 3) @ body.R_world_yaw.T
        # Without a solution the forces of the last plan are the best guess; act leaves out those of feet in the air.
        forces_world = jnp.where(solution.status == cone_qp.NOT_FINITE, state.forces_world, forces_world)
        return state._replace(
            foothold_world=footholds,
            velocity_planar=body.com_velocity_world[:2],
            forces_world=forces_world,
            integral=integral,
            warm_start=solution.warm_start,
            diagnostics=after_plan(state.diagnostics, solution, forces_world, qp.friction, qp.force_max),
        )

    def plan_footholds(time: jax.Array, robot_state: RobotState, body: Body, reference: Reference) -> jax.Array:
        """Foothold of each leg's current or next swing, shape (4, 3) in the world [m]."""
        yaw_rate = (body.R_world_base @ robot_state.base_ang_vel_base)[2]
        time_left = (1.0 - gait.phase(gait_settings, time)) * gait_settings.period  # (4,)
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
            gait.stance_duration(gait_settings),
            settings.raibert_gain,
        )
        # A crouching leg cannot reach far ahead; the height to come counts, not the present one.
        height = jnp.minimum(robot_state.base_pos[2], reference.poses[:, 2].min())
        reach = forward_reach(height, robot.thigh_length, robot.calf_length, foot_height, settings.knee_clearance)
        # The smooth swing is near its foothold early, while the hip still has to come: that much less.
        speed = velocity @ jnp.stack([jnp.cos(body.rpy[2]), jnp.sin(body.rpy[2])])
        reach -= SWING_LEAD * gait.swing_duration(gait_settings) * jnp.maximum(speed, 0.0)
        offset = jnp.einsum("lji,lj->li", rotation, planar - hips)
        offset = offset.at[:, 0].set(jnp.minimum(offset[:, 0], reach))
        planar = hips + jnp.einsum("lij,lj->li", rotation, offset)
        return jnp.concatenate([planar, jnp.full((4, 1), foot_height)], -1)

    def plan_support(
        time: jax.Array, contact_times: jax.Array, feet: jax.Array, footholds: jax.Array, reference: Reference
    ) -> jax.Array:
        """Where each foot stands at the nodes: here, after a swing on its foothold, then as far ahead as the trunk."""
        landings = gait.landings(gait_settings, time, contact_times)[..., None]  # (N, 4, 1)
        stride = jnp.concatenate([reference.velocity[:2], jnp.zeros(1)]) * gait_settings.period
        return jnp.where(landings == 0, feet, footholds + (landings - 1) * stride)

    def act(state: ControllerState, robot_state: RobotState) -> tuple[ControllerState, jax.Array]:
        R = quaternion_to_matrix(robot_state.base_quat, jnp)
        feet_base = leg_forward_kinematics(robot, robot_state.joint_pos)
        standing = gait.stance(gait_settings, state.time)
        feet_world = robot_state.base_pos + feet_base @ R.T
        lift_off = jnp.where(standing[:, None], feet_world, state.lift_off_world)
        headroom = gait_settings.headroom_fraction * (robot_state.base_pos[2] - KNEE_LIMIT_HEIGHT)
        step_height = jnp.clip(headroom, 0.01, gait_settings.step_height)
        progress = gait.swing_progress(gait_settings, state.time)
        duration = gait.swing_duration(gait_settings)
        wanted = torques.whole_body_torque(
            robot,
            settings,
            robot_state,
            R,
            standing,
            state.forces_world,
            torques.SwingTarget(lift_off, state.foothold_world, step_height, progress, duration),
        )
        torque = jnp.clip(wanted, -robot.torque_limit, robot.torque_limit)
        diagnostics = after_act(state.diagnostics, robot, robot_state.joint_pos, wanted, torque, standing)
        time = state.time + settings.control_dt
        return state._replace(time=time, lift_off_world=lift_off, diagnostics=diagnostics), torque

    return Controller(init, problem, plan, act)


__all__ = ["Controller", "ControllerState", "Reference", "make_controller"]
