"""The MPC's quadratic program as the matrices that general solvers take, in float64.

    minimise 1/2 x' P x + q' x    subject to    lower <= A x <= upper,  x in friction cones,  0 <= f_z <= f_max

x holds the forces of the feet that stand; A the limits of torques, then of joint positions, without empty rows.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from agile_jax.arrays import AnyArray
from agile_jax.control.mpc.problem import MpcConstants, Qp

Array = np.ndarray


class DenseQp(NamedTuple):
    """One condensed problem with n forces' components."""

    P: Float[Array, "n n"]
    q: Float[Array, " n"]
    A: Float[Array, "m n"]  # torques, then joint positions
    lower: Float[Array, " m"]
    upper: Float[Array, " m"]
    friction: float
    force_max: float  # [N]
    columns: Bool[Array, " all"]  # which of all 12N components of the forces are in x
    qp: Qp  # the same problem, its arrays NumPy's


class Violations(NamedTuple):
    """By how much a solution breaks its constraints."""

    cone: float  # [N]
    torque: float  # [Nm]
    joint: float  # [rad]


def dense_qp(constants: MpcConstants, qp: Qp, index: int) -> DenseQp:
    """Problem `index` of a batch."""

    def of(values: AnyArray) -> Array:
        return np.asarray(values[index], float)

    force_map, joint_map, torque_map = of(qp.force_map), of(qp.joint.map), of(qp.torque.map)
    nodes = len(force_map)
    eye, H = np.eye(nodes), np.asarray(constants.hessian, float)
    columns = np.repeat(of(qp.contact).reshape(-1) > 0, 3)
    B = np.einsum("kij,kl->kilj", force_map, eye).reshape(6 * nodes, 12 * nodes)[:, columns]
    torque = np.einsum("fij,fg->figj", torque_map.reshape(-1, 3, 3), np.eye(4 * nodes)).reshape(12 * nodes, -1)
    response = np.kron(np.asarray(constants.response, float), np.eye(6))
    joint = np.einsum("kij,kl->kilj", joint_map, eye).reshape(12 * nodes, 6 * nodes) @ response @ B
    return DenseQp(
        P=B.T @ H @ B + float(qp.force_weight[index]) * np.eye(B.shape[1]),
        q=B.T @ of(qp.linear).reshape(-1),
        A=np.concatenate([torque[columns][:, columns], joint[columns]]),
        lower=np.concatenate([of(qp.torque.lower).reshape(-1)[columns], of(qp.joint.lower).reshape(-1)[columns]]),
        upper=np.concatenate([of(qp.torque.upper).reshape(-1)[columns], of(qp.joint.upper).reshape(-1)[columns]]),
        friction=float(qp.friction[index]),
        force_max=float(qp.force_max[index]),
        columns=columns,
        qp=jax.tree.map(lambda values: np.asarray(values[index]), qp),
    )


def pyramid_block(friction: float) -> Array:
    """R of R f <= 0: the pyramid |f_x| <= mu f_z, |f_y| <= mu f_z of one foot. Shape (4, 3)."""
    return np.array([[1, 0, -friction], [-1, 0, -friction], [0, 1, -friction], [0, -1, -friction]])


def pyramid_rows(problem: DenseQp) -> Array:
    """The pyramids of all feet. Shape (4F, n)."""
    return np.kron(np.eye(len(problem.q) // 3), pyramid_block(problem.friction))


def force_bounds(problem: DenseQp, feet: int) -> tuple[Array, Array]:
    """Bounds on the forces of so many feet that the pyramid implies; with them every variable is bounded."""
    side = problem.friction * problem.force_max
    return np.tile([-side, -side, 0.0], feet), np.tile([side, side, problem.force_max], feet)


def violations(problem: DenseQp, x: Array, pyramid: bool) -> Violations:
    """By how much a solution x (n,) breaks its constraints."""
    force = x.reshape(-1, 3)
    planar = np.abs(force[:, :2]).max(-1) if pyramid else np.hypot(force[:, 0], force[:, 1])
    normal = np.maximum(-force[:, 2], force[:, 2] - problem.force_max)
    rows = problem.A @ x
    over = np.maximum(problem.lower - rows, rows - problem.upper)
    torque, joint = np.split(np.maximum(over, 0.0), 2)
    cone = np.maximum(planar - problem.friction * force[:, 2], normal)
    return Violations(max(float(cone.max()), 0.0), float(torque.max()), float(joint.max()))
