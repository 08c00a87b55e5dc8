"""The whole-body controller of one robot: plan at the rate of the MPC, act at the rate of the torques.

`plan` solves the MPC for the foot forces and sets the footholds; `act` turns forces and swing paths into joint
torques. Both are pure functions of one robot's state; callers vmap them.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax import plugins
from agile_jax.control import gait, torques
from agile_jax.control.body import Body, Reference, measure
from agile_jax.control.diagnostics import Diagnostics, after_act, after_plan, no_diagnostics
from agile_jax.control.mpc.problem import Qp, mpc_constants, robot_qp
from agile_jax.control.mpc.solver import cascade
from agile_jax.control.scaling import scaled_to
from agile_jax.control.settings import CONTROLLERS, ControlSettings
from agile_jax.control.swing import feed_forward_share, folded_leg, foothold, forward_reach
from agile_jax.geometry import quaternion_to_matrix, rotation_2d, wrap_angle
from agile_jax.robot import GRAVITY, RobotModel, RobotState, composite_inertia, leg_forward_kinematics
from agile_jax.settings import BadInput

SWING_LEAD = 0.15  # share of the swing left when the foot has made 94 % of its way
REACH_SPEED = 0.3  # at which a foot that misses the ground reaches further down [m/s]
REACH_DEPTH = 0.05  # below the floor's height, at most [m]
# The robot stands where its reference hardly moves and its own motion is below these; once it stands, twice as much.
REST_SPEED, REST_YAW_RATE = 0.15, 0.1  # of the body [m/s], of the reference [rad/s]
REST_DISTANCE, REST_YAW = 0.03, 0.05  # between body and reference [m], [rad]
REST_LEAN, REST_TWIST = 0.02, 0.05  # between body and feet [m], [rad]


class ControllerState(NamedTuple):
    """What the controller remembers between calls."""

    gait: gait.Gait
    lift_off_world: jax.Array  # (4, 3) where each foot last left the ground [m]
    foothold_world: jax.Array  # (4, 3) where each swing should end [m]
    velocity_planar: jax.Array  # (2,) measured velocity of the centre of mass at the last plan, world [m/s]
    forces_world: jax.Array  # (4, 3) planned forces of the ground on the feet [N]
    integral: jax.Array  # (3,) correction of height [m], roll, pitch [rad]
    warm_start: cascade.WarmStart
    diagnostics: Diagnostics


class Plan(NamedTuple):
    """What `plan` prepares for the solver."""

    qp: Qp
    body: Body
    gait: gait.Gait
    footholds_world: jax.Array  # (4, 3) [m]
    integral: jax.Array  # (3,)


class Controller(NamedTuple):
    """A controller as pure functions of one robot."""

    init: Callable[[RobotState], ControllerState]
    problem: Callable[[ControllerState, RobotState, Reference], Qp]  # what `plan` solves
    plan: Callable[[ControllerState, RobotState, Reference], ControllerState]
    act: Callable[[ControllerState, RobotState], tuple[ControllerState, jax.Array]]


def make_controller(robot: RobotModel, settings: ControlSettings) -> Controller:
    """The controller that `settings.kind` names: gait, MPC, footholds and torques, or a plugin's."""
    if settings.kind in CONTROLLERS:
        return make_mpc_controller(robot, settings)
    made = plugins.find("controller", settings.kind)(robot, settings)
    if not isinstance(made, Controller):
        raise BadInput(f"the plugin's controller {settings.kind!r} is {type(made).__name__}, not a Controller")
    return made


def make_mpc_controller(robot: RobotModel, settings: ControlSettings) -> Controller:
    """Compose gait, MPC, footholds and torques for a robot."""
    settings = scaled_to(robot, settings)
    constants = mpc_constants(settings.mpc)
    solve = cascade.make_solver(constants, settings.mpc)
    gait_settings = settings.gait
    foot_height = robot.foot_radius  # of a foot's centre when it stands on the floor z = 0
    inertia = torques.leg_inertia(robot, np.asarray(robot.home_joint_pos, np.float32))
    leg_length = robot.thigh_length + robot.calf_length
    knee_limit_height = folded_leg(robot) + foot_height
    nominal = robot.hip_pos_base[:, :2] + np.stack([np.zeros(4), robot.abad_offset], -1)  # under the hips (4, 2) [m]

    def init(state: RobotState) -> ControllerState:
        R = quaternion_to_matrix(state.base_quat, jnp)
        feet = state.base_pos + leg_forward_kinematics(robot, state.joint_pos) @ R.T
        weight = composite_inertia(robot, state.joint_pos)[0] * GRAVITY
        return ControllerState(
            gait=gait.start(gait_settings),
            lift_off_world=feet,
            foothold_world=feet,
            velocity_planar=jnp.zeros(2),
            forces_world=jnp.zeros((4, 3)).at[:, 2].set(weight / 4),
            integral=jnp.zeros(3),
            warm_start=cascade.cold_start(settings.mpc.horizon),
            diagnostics=no_diagnostics(),
        )

    def problem(state: ControllerState, robot_state: RobotState, reference: Reference) -> Qp:
        return prepare(state, robot_state, reference).qp

    def prepare(state: ControllerState, robot_state: RobotState, reference: Reference) -> Plan:
        body = measure(robot, robot_state)
        feet_world = robot_state.base_pos + leg_forward_kinematics(robot, robot_state.joint_pos) @ body.R_world_base.T

        speed = jnp.sqrt(jnp.sum(reference.velocities[:, :2] ** 2, -1)).max()
        rest = at_rest(state, body, robot_state, feet_world, reference)
        clock = gait.schedule(gait_settings, state.gait, speed, rest, settings.plan_dt)
        footholds = plan_footholds(clock, robot_state, body, reference)
        error = jnp.stack([reference.pose[2] - robot_state.base_pos[2], -body.rpy[0], -body.rpy[1]])
        limit = jnp.array(settings.integral_limit)
        integral = state.integral + jnp.array(settings.integral_gain) * error * settings.plan_dt
        integral = jnp.clip(integral, -limit, limit)

        elapsed = settings.plan_dt / 2 + settings.mpc.mpc_dt * jnp.arange(settings.mpc.horizon)
        contact = gait.contacts_ahead(gait_settings, clock, elapsed).astype(jnp.float32)
        support = plan_support(clock, elapsed, feet_world, footholds, reference)
        qp = robot_qp(constants, settings.mpc, robot, robot_state, body, reference, integral, support, contact)
        return Plan(qp, body, clock, footholds, integral)

    def plan(state: ControllerState, robot_state: RobotState, reference: Reference) -> ControllerState:
        qp, body, clock, footholds, integral = prepare(state, robot_state, reference)
        solution = solve(qp, cascade.shift(state.warm_start, settings.plan_dt / settings.mpc.mpc_dt))
        forces_world = solution.forces[0].reshape(4, 3) @ body.R_world_yaw.T
        # Without a solution the forces of the last plan are the best guess; act leaves out those of feet in the air.
        forces_world = jnp.where(solution.status == cascade.NOT_FINITE, state.forces_world, forces_world)
        return state._replace(
            gait=clock,
            foothold_world=footholds,
            velocity_planar=body.com_velocity_world[:2],
            forces_world=forces_world,
            integral=integral,
            warm_start=solution.warm_start,
            diagnostics=after_plan(state.diagnostics, solution, forces_world, qp.friction, qp.force_max),
        )

    def at_rest(
        state: ControllerState, body: Body, robot_state: RobotState, feet: jax.Array, reference: Reference
    ) -> jax.Array:
        """Whether nothing asks for a step, neither the reference nor how far the trunk has left its feet: () bool."""
        patience = jnp.where(state.gait.stand, 2.0, 1.0)
        speeds = jnp.sqrt(jnp.sum(reference.velocities[:, :2] ** 2, -1))
        distance = jnp.sqrt(jnp.sum((reference.pose[:2] - robot_state.base_pos[:2]) ** 2))
        turn = jnp.abs(wrap_angle(reference.pose[3] - body.rpy[2], jnp))
        shift = (feet - robot_state.base_pos)[:, :2] @ body.R_world_yaw[:2, :2] - nominal
        lean = jnp.sqrt(jnp.sum(shift.mean(0) ** 2))
        twist = jnp.abs(jnp.sum(nominal[:, 0] * shift[:, 1] - nominal[:, 1] * shift[:, 0])) / jnp.sum(nominal**2)
        return (
            (speeds.max() < patience * gait_settings.stand_speed)
            & (jnp.abs(reference.velocities[:, 3]).max() < patience * REST_YAW_RATE)
            & (distance < patience * REST_DISTANCE)
            & (turn < patience * REST_YAW)
            & (lean < patience * REST_LEAN)
            & (twist < patience * REST_TWIST)
            & (jnp.sqrt(jnp.sum(body.com_velocity_world[:2] ** 2)) < patience * REST_SPEED)
        )

    def plan_footholds(clock: gait.Gait, robot_state: RobotState, body: Body, reference: Reference) -> jax.Array:
        """Foothold of each leg's current or next swing, shape (4, 3) in the world [m]."""
        yaw_rate = (body.R_world_base @ robot_state.base_ang_vel_base)[2]
        time_left = gait.time_to_touch_down(clock)  # (4,)
        velocity = body.com_velocity_world[:2]
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

    def plan_support(
        clock: gait.Gait, elapsed: jax.Array, feet: jax.Array, footholds: jax.Array, reference: Reference
    ) -> jax.Array:
        """Where each foot stands at the nodes: here, after a swing on its foothold, then as far ahead as the trunk."""
        standing = gait.standing(gait_settings, clock)
        early = standing & ~gait.scheduled(gait_settings, clock)  # the landing of the present swing has been
        landings = gait.landings_ahead(gait_settings, clock, elapsed)  # (N, 4)
        stride = jnp.concatenate([reference.velocity[:2], jnp.zeros(1)]) * clock.period
        ahead = footholds + jnp.maximum(landings - 1, 0)[..., None] * stride
        return jnp.where((standing & (landings <= early))[..., None], feet, ahead)

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
        wanted = torques.whole_body_torque(
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
        torque = jnp.clip(wanted, -robot.torque_limit, robot.torque_limit)
        diagnostics = after_act(state.diagnostics, robot, robot_state.joint_pos, wanted, torque, bears)
        following = gait.advance(gait_settings, clock, settings.control_dt, robot_state.foot_contact)
        return state._replace(gait=following, lift_off_world=lift_off, diagnostics=diagnostics), torque

    return Controller(init, problem, plan, act)


__all__ = ["Controller", "ControllerState", "Reference", "make_controller"]
