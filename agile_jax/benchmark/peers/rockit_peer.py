"""The same problem in rockit (MECO, KU Leuven), with the settings of its motion planning examples: multiple shooting,
one Runge-Kutta step an interval, piecewise-constant controls, IPOPT with `expand`, smoothed obstacles.

The problem is transcribed once into a function of start and guess, as rockit advises for repeated solves, and only
the call of this function is timed.
"""

from collections.abc import Callable
from importlib.util import find_spec

import casadi as ca
import numpy as np

from agile_jax.benchmark.peers.face_distances import face_distances
from agile_jax.benchmark.peers.opti_peer import SHORTEST, straight_line
from agile_jax.benchmark.peers.peer_path import PeerPath, PeerSolution
from agile_jax.expert import ExpertSettings
from agile_jax.scene import POSE_SIZE, Scene

OPTIONS = {"expand": True, "print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.option_file_name": ""}


def rockit_is_installed() -> bool:
    """Whether `pip install agile_jax[benchmark]` was done."""
    return find_spec("rockit") is not None


def make_rockit_peer(scene: Scene, settings: ExpertSettings, width: float) -> Callable[[np.ndarray], PeerSolution]:
    """A function that solves from a start pose, shape (4,); `width` smooths the face distance [m]."""
    from rockit import FreeTime, MultipleShooting, Ocp

    velocity, acceleration = ca.DM(settings.velocity), ca.DM(settings.acceleration)
    ocp = Ocp(T=FreeTime(1.0))
    start = ocp.parameter(POSE_SIZE)
    ocp.set_value(start, scene.target)
    pose, rate = ocp.state(POSE_SIZE), ocp.state(POSE_SIZE)
    control = ocp.control(POSE_SIZE)
    ocp.set_der(pose, rate)
    ocp.set_der(rate, control)
    ocp.add_objective(ocp.T)

    ocp.subject_to(ocp.T >= SHORTEST)
    ocp.subject_to(ca.DM(scene.lower) <= (pose <= ca.DM(scene.upper)))
    ocp.subject_to(-velocity <= (rate <= velocity))
    ocp.subject_to(-acceleration <= (control <= acceleration))
    for distance in face_distances(scene, pose, width):
        ocp.subject_to(distance >= settings.clearance_margin)
    ocp.subject_to(ocp.at_t0(pose) == start)
    ocp.subject_to(ocp.at_tf(pose) == ca.DM(scene.target))
    ocp.subject_to(ocp.at_tf(rate) == 0)
    if settings.initial_velocity == "rest":
        ocp.subject_to(ocp.at_t0(rate) == 0)
    if settings.zero_end_controls:
        ocp.subject_to(ocp.at_t0(control) == 0)
        ocp.subject_to(ocp.at_tf(control) == 0)
    ocp.solver("ipopt", OPTIONS)
    ocp.method(MultipleShooting(N=settings.nodes, M=1, intg="rk"))

    times, poses = ocp.sample(pose, grid="control")
    _, rates = ocp.sample(rate, grid="control")
    _, controls = ocp.sample(control, grid="control-")  # one an interval
    function = ocp.to_function(
        "solve",
        [ocp.value(start), ocp.value(ocp.T), poses, rates, controls],  # arguments: the start, and the guess
        [times, poses, rates, controls],
    )

    def solve(at: np.ndarray) -> PeerSolution:
        line, guess = straight_line(at, scene.target, settings)
        speed = np.tile((scene.target - at) / guess, (settings.nodes + 1, 1))
        found = function(at, guess, line.T, speed.T, np.zeros((POSE_SIZE, settings.nodes)))
        times, poses, rates, controls = (np.array(value).T for value in found)
        stats = function.stats()
        path = PeerPath(times.ravel(), np.concatenate([poses, rates], axis=1), controls, controls)
        return PeerSolution(path, bool(stats["success"]), str(stats["return_status"]))

    return solve
