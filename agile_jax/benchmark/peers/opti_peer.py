"""The formulation that a user of CasADi would write first: Opti, trapezoidal collocation, IPOPT.

    minimise    T
    subject to  x_{k+1} - x_k = h (f_k + f_{k+1}) / 2,   f = (s', u),   h = T / N,
                bounds, end conditions,   face distance of s_k >= margin at every node.

One phase, one initial guess on the straight line, no effort in the objective. In its favour: the problem is built
once, with the start as a parameter, `expand` turns it into scalar expressions, and only the solver's call is timed.
"""

from collections.abc import Callable

import casadi as ca
import numpy as np

from agile_jax.benchmark.peers.face_distances import face_distances
from agile_jax.benchmark.peers.peer_path import PeerPath, PeerSolution
from agile_jax.expert import ExpertSettings
from agile_jax.scene import POSE_SIZE, Scene

OPTIONS: dict[str, bool] = {"expand": True, "print_time": False}
# All else is the default.
IPOPT: dict[str, int | str] = {"print_level": 0, "sb": "yes", "linear_solver": "mumps", "option_file_name": ""}
SHORTEST = 1e-3  # [s]


def make_opti_peer(scene: Scene, settings: ExpertSettings, width: float) -> Callable[[np.ndarray], PeerSolution]:
    """A function that solves from a start pose, shape (4,); `width` smooths the face distance [m]."""
    count = settings.nodes
    velocity, acceleration = np.array(settings.velocity), np.array(settings.acceleration)
    opti = ca.Opti()
    start = opti.parameter(POSE_SIZE)
    duration = opti.variable()
    pose, rate, control = (opti.variable(POSE_SIZE, count + 1) for _ in range(3))

    opti.minimize(duration)
    h = duration / count
    opti.subject_to(pose[:, 1:] == pose[:, :-1] + h / 2 * (rate[:, 1:] + rate[:, :-1]))
    opti.subject_to(rate[:, 1:] == rate[:, :-1] + h / 2 * (control[:, 1:] + control[:, :-1]))
    opti.subject_to(duration >= SHORTEST)
    for k in range(count + 1):
        opti.subject_to(opti.bounded(scene.lower, pose[:, k], scene.upper))
        opti.subject_to(opti.bounded(-velocity, rate[:, k], velocity))
        opti.subject_to(opti.bounded(-acceleration, control[:, k], acceleration))
        for distance in face_distances(scene, pose[:, k], width):
            opti.subject_to(distance >= settings.clearance_margin)
    opti.subject_to(pose[:, 0] == start)
    opti.subject_to(pose[:, -1] == scene.target)
    opti.subject_to(rate[:, -1] == 0)
    if settings.initial_velocity == "rest":
        opti.subject_to(rate[:, 0] == 0)
    if settings.zero_end_controls:
        opti.subject_to(control[:, 0] == 0)
        opti.subject_to(control[:, -1] == 0)
    opti.solver("ipopt", OPTIONS, IPOPT)

    def solve(at: np.ndarray) -> PeerSolution:
        line, guess = straight_line(at, scene.target, settings)
        opti.set_value(start, at)
        opti.set_initial(duration, guess)
        opti.set_initial(pose, line.T)
        opti.set_initial(rate, np.tile((scene.target - at) / guess, (count + 1, 1)).T)
        opti.set_initial(control, 0)
        try:
            found: ca.OptiSol | ca.OptiAdvanced = opti.solve()
        except RuntimeError:  # Opti's way to say that the solver has failed
            found = opti.debug
        controls = np.array(found.value(control)).T
        path = PeerPath(
            times=float(found.value(duration)) * np.linspace(0, 1, count + 1),
            states=np.concatenate([np.array(found.value(pose)), np.array(found.value(rate))]).T,
            first_controls=controls[:-1],
            last_controls=controls[1:],
        )
        stats = opti.stats()
        return PeerSolution(path, bool(stats["success"]), str(stats["return_status"]))

    return solve


def straight_line(start: np.ndarray, target: np.ndarray, settings: ExpertSettings) -> tuple[np.ndarray, float]:
    """Poses from start to target, shape (T+1, 4), and a duration that fits [s]: the peers' initial guess."""
    velocity, acceleration = np.array(settings.velocity), np.array(settings.acceleration)
    fraction = np.linspace(0, 1, settings.nodes + 1)[:, None]
    duration = float(np.max(np.abs(target - start) / velocity) + np.max(velocity / acceleration))
    return start + fraction * (target - start), duration
