"""General solvers on the MPC's problem, each with the settings that its authors recommend for it.

A peer prepares a problem (not timed: the condensed matrices in the form it wants) and solves it (timed: set-up and
solution, from cold, as for a new state of the robot). One thread. QP solvers take the pyramid inside the cone.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.benchmark.peers.dense_qp import DenseQp, force_bounds, pyramid_rows
from agile_jax.benchmark.peers.hpipm_peer import make_hpipm
from agile_jax.benchmark.peers.qp_peer import Peer, Solve
from agile_jax.control.settings import MpcSettings

INFINITY = 1e20  # what CasADi's plugins and OSQP take for none


class Rows(NamedTuple):
    """minimise 1/2 x'Px + q'x, lower <= A x <= upper, below <= x <= above."""

    P: Float[np.ndarray, "n n"]
    q: Float[np.ndarray, " n"]
    A: Float[np.ndarray, "m n"]
    lower: Float[np.ndarray, " m"]
    upper: Float[np.ndarray, " m"]
    below: Float[np.ndarray, " n"]
    above: Float[np.ndarray, " n"]


def rows(problem: DenseQp) -> Rows:
    """A problem with the pyramid among its rows."""
    pyramid = pyramid_rows(problem)
    below, above = force_bounds(problem, len(problem.q) // 3)
    return Rows(
        problem.P,
        problem.q,
        np.concatenate([pyramid, problem.A]),
        np.concatenate([np.full(len(pyramid), -np.inf), problem.lower]),
        np.concatenate([np.zeros(len(pyramid)), problem.upper]),
        below,
        above,
    )


def make_daqp() -> Peer:
    """Dual active set."""
    import daqp

    def prepare(problem: DenseQp) -> Solve:
        r = rows(problem)
        upper = np.concatenate([r.above, np.minimum(r.upper, 1e30)])
        lower = np.concatenate([r.below, np.maximum(r.lower, -1e30)])
        P, A, sense = np.ascontiguousarray(r.P), np.ascontiguousarray(r.A), np.zeros(len(upper), np.int32)

        def solve() -> np.ndarray | None:
            x, _, flag, _ = daqp.solve(P, r.q, A, upper, lower, sense)
            return np.asarray(x) if flag > 0 else None

        return solve

    return Peer("DAQP, dual active set, defaults", True, prepare)


def make_quadprog() -> Peer:
    """Goldfarb and Idnani."""
    import quadprog

    def prepare(problem: DenseQp) -> Solve:
        r = rows(problem)
        eye = np.eye(len(r.q))
        matrix = np.concatenate([eye, -eye, r.A, -r.A])
        bound = np.concatenate([r.below, -r.above, r.lower, -r.upper])
        finite = np.isfinite(bound)
        q, columns, kept = -r.q, np.asfortranarray(matrix[finite].T), bound[finite]

        def solve() -> np.ndarray | None:
            try:
                x: np.ndarray = quadprog.solve_qp(r.P, q, columns, kept)[0]
            except ValueError:
                return None
            return x

        return solve

    return Peer("quadprog, Goldfarb-Idnani dual active set", True, prepare)


def make_osqp() -> Peer:
    """Operator splitting."""
    import osqp
    import scipy.sparse as sparse

    def prepare(problem: DenseQp) -> Solve:
        r = rows(problem)
        matrix = np.concatenate([np.eye(len(r.q)), r.A])
        lower, upper = np.concatenate([r.below, r.lower]), np.concatenate([r.above, r.upper])
        P, A = sparse.csc_matrix(np.triu(r.P)), sparse.csc_matrix(matrix)

        def solve() -> np.ndarray | None:
            solver = osqp.OSQP()
            solver.setup(P, r.q, A, lower, upper, verbose=False, eps_abs=1e-4, eps_rel=1e-4, max_iter=20_000)
            result = solver.solve()
            return np.asarray(result.x) if result.info.status == "solved" else None

        return solve

    return Peer("OSQP, 1e-4", True, prepare)


def make_piqp() -> Peer:
    """Proximal interior point."""
    import piqp

    def solve(r: Rows) -> np.ndarray | None:
        solver = piqp.DenseSolver()
        solver.settings.verbose = False
        solver.setup(r.P, r.q, None, None, r.A, r.lower, r.upper, r.below, r.above)
        status = solver.solve()
        return np.asarray(solver.result.x) if status == piqp.PIQP_SOLVED else None

    return Peer("PIQP dense, proximal interior point, defaults", True, lambda problem: partial(solve, rows(problem)))


def make_proxqp() -> Peer:
    """Proximal augmented Lagrangian."""
    from proxsuite import proxqp

    def solve(r: Rows) -> np.ndarray | None:
        matrix = np.concatenate([r.A, np.eye(len(r.q))])
        solver = proxqp.dense.QP(len(r.q), 0, len(matrix))
        solver.settings.eps_abs, solver.settings.eps_rel = 1e-5, 0.0
        lower, upper = np.concatenate([r.lower, r.below]), np.concatenate([r.upper, r.above])
        solver.init(r.P, r.q, None, None, matrix, np.maximum(lower, -INFINITY), np.minimum(upper, INFINITY))
        solver.solve()
        solved = solver.results.info.status == proxqp.PROXQP_SOLVED
        return np.asarray(solver.results.x) if solved else None

    return Peer("ProxQP dense, 1e-5", True, lambda problem: partial(solve, rows(problem)))


def make_qpoases() -> Peer:
    """Primal active set, through CasADi."""
    import casadi as ca

    if not ca.has_conic("qpoases"):
        raise ImportError("CasADi was built without qpOASES")
    solvers: dict[tuple[int, int], ca.Function] = {}

    def prepare(problem: DenseQp) -> Solve:
        r = rows(problem)
        shape = len(r.q), len(r.A)
        if shape not in solvers:
            structure = {"h": ca.Sparsity.dense(shape[0], shape[0]), "a": ca.Sparsity.dense(shape[1], shape[0])}
            options: dict[str, bool | int | str] = {
                "printLevel": "none",
                "error_on_fail": False,
                "sparse": False,
                "nWSR": 2000,
            }
            solvers[shape] = ca.conic("qp", "qpoases", structure, options)
        data = {"h": r.P, "g": r.q, "a": r.A, "lba": r.lower, "uba": r.upper, "lbx": r.below, "ubx": r.above}
        solver, arguments = solvers[shape], {key: ca.DM(value) for key, value in data.items()}

        def solve() -> np.ndarray | None:
            x = solver(**arguments)["x"]
            return np.asarray(x).reshape(-1) if solver.stats()["success"] else None

        return solve

    return Peer("qpOASES through CasADi, cold start", True, prepare)


def make_clarabel(tolerance: float = 1e-6, pyramid: bool = False) -> Peer:
    """Interior point over second-order cones."""
    import clarabel
    import scipy.sparse as sparse

    def prepare(problem: DenseQp) -> Solve:
        size = len(problem.q)
        normal = np.eye(size)[2::3]
        parts = [(normal, np.full(len(normal), problem.force_max)), (problem.A, problem.upper)]
        parts.append((-problem.A, -problem.lower))
        if pyramid:
            ramps = pyramid_rows(problem)
            parts.append((ramps, np.zeros(len(ramps))))
        matrix, bound = (np.concatenate(part) for part in zip(*parts, strict=True))
        finite = np.isfinite(bound)
        matrix, bound = matrix[finite], bound[finite]
        cones = [clarabel.NonnegativeConeT(len(bound))]
        if not pyramid:
            block = np.array([[0, 0, -problem.friction], [-1, 0, 0], [0, -1, 0]])
            matrix = np.concatenate([matrix, np.kron(np.eye(size // 3), block)])
            bound = np.concatenate([bound, np.zeros(size)])
            cones += [clarabel.SecondOrderConeT(3)] * (size // 3)
        P, A = sparse.csc_matrix(np.triu(problem.P)), sparse.csc_matrix(matrix)

        def solve() -> np.ndarray | None:
            settings = clarabel.DefaultSettings()
            settings.verbose = False
            settings.max_threads = 1
            settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
            result = clarabel.DefaultSolver(P, problem.q, A, bound, cones, settings).solve()
            return np.array(result.x) if result.status == clarabel.SolverStatus.Solved else None

        return solve

    return Peer(f"Clarabel, second-order cone, {tolerance:g}", pyramid, prepare)


def make_peers(settings: MpcSettings) -> tuple[dict[str, Peer], dict[str, str]]:
    """The peers that can be loaded, and why the others cannot."""
    makers: dict[str, Callable[[], Peer]] = {
        "daqp": make_daqp,
        "quadprog": make_quadprog,
        "qpoases": make_qpoases,
        "osqp": make_osqp,
        "hpipm": lambda: make_hpipm(settings),
        "piqp": make_piqp,
        "proxqp": make_proxqp,
        "clarabel": make_clarabel,
    }
    peers, missing = {}, {}
    for name, make in makers.items():
        try:
            peers[name] = make()
        except ImportError as error:
            missing[name] = str(error)
    return peers, missing
