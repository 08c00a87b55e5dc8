"""HPIPM on the MPC's problem in its sparse form, through CasADi.

States x_k = (positions, velocities) that the forces add to free fall, x_0 = 0, x_{k+1} = A x_k + E B_k f_k (the exact
double integrators of `control.mpc.centroidal`); cost 1/2 x'Wx + h_k' B_k f_k + w/2 |f_k|^2. The condensed problem is
this one with the states substituted.
"""

import numpy as np

from agile_jax.benchmark.peers.dense_qp import DenseQp, force_bounds, pyramid_block
from agile_jax.benchmark.peers.qp_peer import Peer, Solve
from agile_jax.control.settings import MpcSettings

STATE = 12


def make_hpipm(settings: MpcSettings) -> Peer:
    """Interior point with Riccati recursions."""
    import casadi as ca

    if not ca.has_conic("hpipm"):
        raise ImportError("CasADi was built without HPIPM")
    solvers: dict[tuple[int, ...], ca.Function] = {}

    def prepare(problem: DenseQp) -> Solve:
        sizes, forces, rows, cost, bounds = stages(settings, problem)
        nodes = len(sizes)
        matrices = {"h": ca.sparsify(ca.DM(np.diag(cost[0]))), "a": ca.sparsify(ca.DM(rows[0]))}
        if sizes not in solvers:  # one for each pattern of contacts
            structure = {key: matrix.sparsity() for key, matrix in matrices.items()}
            joints = (0, *sizes)
            options: dict[str, bool | int | list[int] | dict[str, float]] = {
                "N": nodes,
                "nx": [STATE] * (nodes + 1),
                "nu": [*sizes, 0],
                "ng": [joints[k] + (sizes[k] // 3 * 7 if k < nodes else 0) for k in range(nodes + 1)],
                "error_on_fail": False,
                "print_time": False,
                "hpipm": {"iter_max": 100, "res_g_max": 1e-6, "res_b_max": 1e-8, "res_d_max": 1e-6, "res_m_max": 1e-6},
            }
            solvers[sizes] = ca.conic("qp", "hpipm", structure, options)
        vectors = {"g": cost[1], "lba": rows[1], "uba": rows[2], "lbx": bounds[0], "ubx": bounds[1]}
        solver, arguments = solvers[sizes], matrices | {key: ca.DM(vector) for key, vector in vectors.items()}

        def solve() -> np.ndarray | None:
            x = solver(**arguments)["x"]
            return np.asarray(x).reshape(-1)[forces] if solver.stats()["success"] else None

        return solve

    return Peer("HPIPM through CasADi, sparse, residuals 1e-6", True, prepare)


def stages(
    settings: MpcSettings, problem: DenseQp
) -> tuple[tuple[int, ...], np.ndarray, tuple[np.ndarray, ...], tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Sizes of the controls, where the forces are, (A, lower, upper), (diagonal, linear), (below, above).

    Variables are x_0, f_0, x_1, ... x_N; rows are, stage by stage, dynamics, joint positions, pyramids, torques.
    """
    qp, dt = problem.qp, settings.mpc_dt
    stands = np.asarray(qp.contact) > 0
    nodes = len(stands)
    sizes = tuple(int(3 * count) for count in stands.sum(1))
    begin = np.cumsum([0, *(STATE + size for size in sizes)])
    count = begin[-1] + STATE
    eye = np.eye(6)
    A = np.block([[eye, dt * eye], [np.zeros((6, 6)), eye]])
    E = np.concatenate([dt**2 / 2 * eye, dt * eye])
    weights = [
        *settings.weight_orientation,
        *settings.weight_position,
        *settings.weight_angular_velocity,
        *settings.weight_velocity,
    ]
    diagonal, linear = np.zeros(count), np.zeros(count)
    below, above = np.full(count, -np.inf), np.full(count, np.inf)
    below[:STATE] = above[:STATE] = 0.0
    rows: list[np.ndarray] = []
    lower: list[np.ndarray] = []
    upper: list[np.ndarray] = []

    def add(place: int, block: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
        row = np.zeros((len(block), count))
        row[:, place : place + block.shape[1]] = block
        rows.append(row)
        lower.append(low)
        upper.append(high)

    for k in range(nodes + 1):
        if k < nodes:
            feet, at = sizes[k] // 3, begin[k] + STATE
            force = slice(at, at + sizes[k])
            B = np.asarray(qp.force_map[k], float)[:, np.repeat(stands[k], 3)]
            diagonal[force], linear[force] = float(qp.force_weight), B.T @ np.asarray(qp.linear[k], float)
            below[force], above[force] = force_bounds(problem, feet)
            add(begin[k], np.concatenate([A, E @ B, -np.eye(STATE)], 1), np.zeros(STATE), np.zeros(STATE))
        if k > 0:
            diagonal[begin[k] : begin[k] + STATE] = weights
            legs = np.repeat(stands[k - 1], 3)
            joint = [np.asarray(part[k - 1], float)[legs] for part in qp.joint]
            add(begin[k], *joint)
        if k < nodes:
            pyramid = np.kron(np.eye(feet), pyramid_block(problem.friction))
            add(at, pyramid, np.full(len(pyramid), -np.inf), np.zeros(len(pyramid)))
            maps, low, high = (np.asarray(part[k], float)[stands[k]] for part in qp.torque)
            torque = np.einsum("fij,fg->figj", maps, np.eye(feet)).reshape(3 * feet, 3 * feet)
            add(at, torque, low.reshape(-1), high.reshape(-1))
    forces = np.concatenate([np.arange(begin[k] + STATE, begin[k + 1]) for k in range(nodes)])
    constraint = np.concatenate(rows), np.concatenate(lower), np.concatenate(upper)
    return sizes, forces, constraint, (diagonal, linear), (below, above)
