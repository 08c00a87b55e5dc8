"""The whole-body controller of one robot: plan at the rate of the MPC, act at the rate of the torques.

`plan` solves the MPC (`control/mpc/problem.py`: cost, friction cones, limits) for the foot forces and sets the
footholds; `act` turns forces and swing paths into joint torques.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from agile_jax import plugins
from agile_jax.control import gait, joint_model, torques
from agile_jax.control.body import Body, Reference, measure, slowed
from agile_jax.control.diagnostics import Diagnostics, after_act, after_plan, no_diagnostics
from agile_jax.control.footholds import plan_footholds, plan_support
from agile_jax.control.interface import Controller
from agile_jax.control.mpc.problem import MpcConstants, Qp, mpc_constants, robot_qp
from agile_jax.control.mpc.solver import cascade
from agile_jax.control.rest import at_rest, planar_speed
from agile_jax.control.scaling import scaled_to
from agile_jax.control.settings import CONTROLLERS, ControlSettings
from agile_jax.geometry import quaternion_to_matrix
from agile_jax.robot import (
    GRAVITY,
    LEAST_LIFT,
    RobotModel,
    RobotState,
    StrideTable,
    composite_inertia,
    hip_to_foot,
    leg_forward_kinematics,
    longest_stride,
    stride_table,
)
from agile_jax.settings import BadInput
from agile_jax.single_precision import in_float32

# A foot that misses the ground falls on: how fast it gathers speed [m/s^2], to what speed [m/s], and how far down [m].
FALL, FALL_SPEED, FALL_DEPTH = 60.0, 1.0, 0.05


class ControllerState(NamedTuple):
    """What the controller of one robot remembers between calls."""

    gait: gait.Gait
    lift_off_world: Float[Array, "4 3"]  # where each foot last left the ground [m]
    foothold_world: Float[Array, "4 3"]  # where each swing should end [m]
    velocity_planar: Float[Array, "2"]  # measured velocity of the centre of mass at the last plan, world [m/s]
    forces_world: Float[Array, "4 3"]  # planned forces of the ground on the feet [N]
    integral: Float[Array, "3"]  # correction of height [m], roll, pitch [rad]
    trunk_velocity: Float[Array, "4"]  # of the reference at the last plan [m/s, rad/s]
    joints: joint_model.JointModel
    warm_start: cascade.WarmStart
    diagnostics: Diagnostics


class Plan(NamedTuple):
    """What `plan` prepares for the solver."""

    qp: Qp
    body: Body
    gait: gait.Gait
    footholds_world: Float[Array, "4 3"]  # [m]
    integral: Float[Array, "3"]  # correction of height [m], roll, pitch [rad]
    joints: joint_model.JointModel
    trunk_velocity: Float[Array, "4"]  # of the reference [m/s, rad/s]


@dataclasses.dataclass(frozen=True, eq=False)
class MpcController:
    """Gait, convex MPC, footholds and torques of one robot; made by `make_mpc_controller`.

    Its methods are pure functions of one robot's state; the caller vmaps and compiles them. They compute in float32.
    """

    robot: RobotModel
    settings: ControlSettings  # as this robot needs them
    constants: MpcConstants
    solve: cascade.Solver
    nominal_feet: Float[np.ndarray, "4 2"]  # the feet under their hips, in the plane of the trunk [m]
    leg_inertia: Float[np.ndarray, "4 3 3"]  # of the joints at the home posture [kg m^2]
    knee_limit_height: float  # of the trunk at which the knees reach their limits [m]
    least_lift: float  # of a step [m]
    strides: StrideTable  # how far the feet may be from their hips, by the height of the trunk

    @in_float32
    def init(self, robot_state: RobotState) -> ControllerState:
        """Begin an episode with all feet down.

        Args:
            robot_state: measured, of a robot at rest.

        Returns:
            The state, each foot carrying a quarter of the weight.
        """
        feet = self._feet_world(robot_state, quaternion_to_matrix(robot_state.base_quat, jnp))
        weight = composite_inertia(self.robot, robot_state.joint_pos)[0] * GRAVITY
        return ControllerState(
            gait=gait.start(self.settings.gait),
            lift_off_world=feet,
            foothold_world=feet,
            velocity_planar=jnp.zeros(2),
            forces_world=jnp.zeros((4, 3)).at[:, 2].set(weight / 4),
            integral=jnp.zeros(3),
            trunk_velocity=jnp.zeros(4),
            joints=joint_model.nothing_learned(self.robot, robot_state),
            warm_start=cascade.cold_start(self.settings.mpc.horizon),
            diagnostics=no_diagnostics(),
        )

    @in_float32
    def problem(self, state: ControllerState, robot_state: RobotState, reference: Reference) -> Qp:
        """The quadratic program that `plan` would solve; its arguments are those of `plan`."""
        return self._prepare(state, robot_state, reference).qp

    @in_float32
    def plan(self, state: ControllerState, robot_state: RobotState, reference: Reference) -> ControllerState:
        """Solve the MPC for the foot forces, and set the footholds; every `plan_dt` [s].

        Args:
            state: from `init` or `act`.
            robot_state: measured.
            reference: of the trunk; poses (N, 4) [m, rad] and velocities (N, 4) [m/s, rad/s] at the MPC's N nodes.

        Returns:
            The state with the planned forces (4, 3) [N]. Without a solution the forces are those of the last plan.
        """
        qp, body, clock, footholds, integral, joints, trunk_velocity = self._prepare(state, robot_state, reference)
        mpc = self.settings.mpc
        solution = self.solve(qp, cascade.shift(state.warm_start, self.settings.plan_dt / mpc.mpc_dt))
        forces_world = solution.forces[0].reshape(4, 3) @ body.R_world_yaw.T
        # Without a solution the forces of the last plan are the best guess; act leaves out those of feet in the air.
        forces_world = jnp.where(solution.status == cascade.NOT_FINITE, state.forces_world, forces_world)
        return state._replace(
            gait=clock,
            foothold_world=footholds,
            velocity_planar=body.com_velocity_world[:2],
            forces_world=forces_world,
            integral=integral,
            trunk_velocity=trunk_velocity,
            joints=joints,
            warm_start=solution.warm_start,
            diagnostics=after_plan(state.diagnostics, solution, forces_world, qp.friction, qp.force_max),
        )

    @in_float32
    def act(self, state: ControllerState, robot_state: RobotState) -> tuple[ControllerState, Float[Array, "12"]]:
        """Torques from the planned forces and the swing paths; every `control_dt` [s].

        Args:
            state: from `plan` or `act`.
            robot_state: measured.

        Returns:
            The state, and the torques of the joints, inside their limits, legs FR, FL, RR, RL [Nm].
        """
        robot, settings, clock = state.joints.told(self.robot), self.settings, state.gait
        R_world_base = quaternion_to_matrix(robot_state.base_quat, jnp)
        feet_world = self._feet_world(robot_state, R_world_base)
        by_clock = gait.scheduled(settings.gait, clock)
        lift_off = jnp.where(by_clock[:, None], feet_world, state.lift_off_world)
        # A foot that landed early follows its path until the next plan gives it a force.
        bears = clock.landed & (by_clock | (state.forces_world[:, 2] > 0))
        rotors = jax.vmap(jnp.diag)((robot.joint_armature - self.robot.joint_armature).reshape(4, 3))
        wanted = torques.whole_body_torque(
            robot,
            settings,
            self.leg_inertia + rotors,
            robot_state,
            R_world_base,
            bears,
            state.forces_world,
            state.trunk_velocity,
            self._swing(state, robot_state, lift_off),
        )
        torque = jnp.clip(wanted, -robot.torque_limit, robot.torque_limit)
        diagnostics = after_act(state.diagnostics, robot, robot_state.joint_pos, wanted, torque, bears)
        following = gait.advance(settings.gait, clock, settings.control_dt, robot_state.foot_contact)
        joints = joint_model.record(
            state.joints, robot_state, torque, self._free(robot_state, bears), settings.control_dt
        )
        return state._replace(gait=following, lift_off_world=lift_off, joints=joints, diagnostics=diagnostics), torque

    def diagnostics(self, state: ControllerState) -> Diagnostics:
        """The last solution of the MPC, saturated torques, and counts of what went wrong since `init`."""
        return state.diagnostics

    def _prepare(self, state: ControllerState, robot_state: RobotState, reference: Reference) -> Plan:
        settings, mpc = self.settings, self.settings.mpc
        free = self._free(robot_state, state.gait.landed)
        joints = joint_model.learn(self.robot, state.joints, robot_state, free, settings.plan_dt)
        robot, stands = joints.told(self.robot), gait.duty(settings.gait, state.gait)
        reference = slowed(reference, joint_model.top_speed(robot, robot_state.base_pos[2], stands))
        body = measure(robot, robot_state)
        feet = self._feet_world(robot_state, body.R_world_base)
        rest = at_rest(
            state.gait.stand, body, robot_state, feet, self.nominal_feet, reference, settings.gait.stand_speed
        )
        # The height to come counts, not the present one.
        height = jnp.minimum(robot_state.base_pos[2], reference.poses[:, 2].min())
        window = jnp.stack([jnp.interp(height, self.strides.height, ends) for ends in self.strides[1:]])
        longest = longest_stride(window[0], window[1], stands, jnp)
        clock = gait.schedule(settings.gait, state.gait, planar_speed(reference).max(), longest, rest, settings.plan_dt)
        footholds = plan_footholds(self.robot, settings, window, self.nominal_feet, clock, robot_state, body, reference)
        late = gait.late(settings.gait, clock)  # it still comes down to where it should have landed
        footholds = jnp.where(late[:, None], state.foothold_world, footholds)

        error = jnp.stack([reference.pose[2] - robot_state.base_pos[2], -body.rpy[0], -body.rpy[1]])
        limit = jnp.array(settings.integral_limit)
        integral = state.integral + jnp.array(settings.integral_gain) * error * settings.plan_dt
        integral = jnp.clip(integral, -limit, limit)

        elapsed = settings.plan_dt / 2 + mpc.mpc_dt * jnp.arange(mpc.horizon)
        contact = gait.contacts_ahead(settings.gait, clock, elapsed).astype(jnp.float32)
        support = plan_support(settings.gait, clock, elapsed, feet, footholds, reference)
        qp = robot_qp(self.constants, mpc, robot, robot_state, body, reference, integral, support, contact)
        return Plan(qp, body, clock, footholds, integral, joints, reference.velocity)

    def _swing(self, state: ControllerState, robot_state: RobotState, lift_off: jax.Array) -> torques.SwingTarget:
        """The paths of the feet; a foot that is late reaches down until it touches the ground."""
        settings, clock = self.settings.gait, state.gait
        speed = jnp.sqrt(jnp.sum(state.velocity_planar**2))
        return torques.SwingTarget(
            lift_off,
            state.foothold_world,
            gait.step_height(settings, speed, robot_state.base_pos[2] - self.knee_limit_height, self.least_lift),
            gait.swing_progress(settings, clock),
            gait.swing_duration(settings, clock),
            *fall(gait.late_by(settings, clock)),
        )

    def _free(self, robot_state: RobotState, standing: Bool[Array, "4"]) -> Bool[Array, "4"]:
        """Which legs touch nothing; those in the air by the gait, where they cannot feel."""
        return ~standing if robot_state.foot_contact is None else ~(standing | robot_state.foot_contact)

    def _feet_world(self, robot_state: RobotState, R_world_base: jax.Array) -> jax.Array:
        """Centres of the feet, shape (4, 3) [m]."""
        return robot_state.base_pos + leg_forward_kinematics(self.robot, robot_state.joint_pos) @ R_world_base.T


def fall(late: Float[Array, "4"]) -> tuple[Float[Array, "4"], Float[Array, "4"], Float[Array, "4"]]:
    """How far below their paths feet are that should have landed some time ago [s]: depth, speed, acceleration."""
    gathering = FALL_SPEED / FALL
    depth = FALL * jnp.minimum(late, gathering) ** 2 / 2 + FALL_SPEED * jnp.maximum(late - gathering, 0.0)
    falls = (late > 0) & (depth < FALL_DEPTH)
    speed = jnp.where(falls, FALL * jnp.minimum(late, gathering), 0.0)
    return jnp.minimum(depth, FALL_DEPTH), speed, jnp.where(falls & (late < gathering), FALL, 0.0)


def make_controller(robot: RobotModel, settings: ControlSettings) -> Controller[PyTree]:
    """The controller that `settings.kind` names: the library's own, or a plugin's.

    Raises:
        BadInput: the plugin's is no `Controller`.
    """
    if settings.kind in CONTROLLERS:
        return make_mpc_controller(robot, settings)
    made = plugins.find("controller", settings.kind)(robot, settings)
    if not isinstance(made, Controller):
        raise BadInput(f"the plugin's controller {settings.kind!r} is {type(made).__name__}, not a Controller")
    return made


def make_mpc_controller(robot: RobotModel, settings: ControlSettings) -> MpcController:
    """The controller of a robot; what does not change is computed here, once.

    Args:
        robot: constants.
        settings: as for the A1; `control.scaling` adapts them to the robot.
    """
    settings = scaled_to(robot, settings)
    with jax.enable_x64(False):
        constants = mpc_constants(settings.mpc)
        return MpcController(
            robot,
            settings,
            constants,
            cascade.make_solver(constants, settings.mpc),
            robot.hip_pos_base[:, :2] + np.stack([np.zeros(4), robot.abad_offset], -1),
            torques.leg_inertia(robot, np.asarray(robot.home_joint_pos, np.float32)),
            hip_to_foot(robot, robot.joint_lower[2]) + robot.foot_radius,
            LEAST_LIFT * (robot.thigh_length + robot.calf_length),
            stride_table(robot),
        )
