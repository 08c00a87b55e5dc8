"""`agile benchmark expert`: our labels against single solves of what a user would write first.

All methods solve the same starts of the experiment's distribution, one after the other for each start, in one process
of one thread. Problems are built and every solver has run once before the clock starts. Ours does all that a label
takes: every route that could be best, the choice between them, and the independent check; a peer solves one nonlinear
program from one guess, unchecked. What each returns is then measured alike: accelerations integrated exactly,
clearance exact at 12 points inside every interval.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from agile_jax.benchmark.measuring import Spent, machine, timed, versions
from agile_jax.benchmark.metrics import Metric, Result, as_json, comparison, text_of
from agile_jax.benchmark.peers.peer_path import Defects, PeerSolution, measure
from agile_jax.dataset.starts import draw_start
from agile_jax.experiment import Experiment
from agile_jax.expert import Expert, ExpertSettings, make_expert, verify
from agile_jax.expert.verify import BOUND_TOLERANCE, CLEARANCE_TOLERANCE, DYNAMICS_TOLERANCE
from agile_jax.progress import Progress, silent
from agile_jax.scene import Scene, make_scene

WIDTH = 5e-3  # [m] of the smoothed face distance
LONGER = 1e-4  # relative; by this much our durations may exceed a peer's
SPEED_TARGET = 10.0  # our labels over opti's solves, per second and core
METHOD = " ".join((__doc__ or "").partition("\n\n")[2].split())
PEERS = {
    "opti": "CasADi Opti, trapezoidal, IPOPT with MUMPS; clearance: the maximum of the face distances",
    "opti_smooth": f"the same; the maximum smoothed over {1e3 * WIDTH:g} mm, which rounds the obstacles' edges",
    "rockit": "rockit, multiple shooting, Runge-Kutta, IPOPT with MUMPS; the smoothed maximum",
}


class Attempt(NamedTuple):
    """One method on one start."""

    solved: bool
    status: str
    duration: float  # [s] of the path
    spent: Spent  # on the solve
    defects: Defects


def benchmark_expert(experiment: Experiment, starts: int = 100, progress: Progress = silent) -> Result:
    """Measure, and return what goes into the JSON file: `metrics` by key, `starts` one by one, and the method."""
    settings = experiment.expert
    scene = make_scene(experiment.scene)
    poses = [
        draw_start(scene, experiment.scene, settings, experiment.dataset, experiment.seed, i).poses[0]
        for i in range(starts)
    ]
    methods, missing = _methods(scene, settings)

    for name, solve in methods.items():  # each builds its solvers; ours builds one for each number of phases
        for i, pose in enumerate(poses if name == "ours" else poses[:1]):
            progress("warming up", i, starts, name)
            solve(pose)
    attempts: dict[str, list[Attempt]] = {name: [] for name in methods}
    for i, pose in enumerate(poses):
        for name, solve in methods.items():
            attempts[name].append(solve(pose))
        progress("measuring", i + 1, starts, "starts")
    return {
        "benchmark": "expert",
        "experiment": experiment.name,
        "method": METHOD,
        "peers": PEERS | dict.fromkeys(missing, "not installed"),
        "problem": {
            "starts": starts,
            "distribution": experiment.dataset.starts,
            "seed": experiment.seed,
            "initial_velocity": settings.initial_velocity,
            "nodes": settings.nodes,
            "clearance_margin_m": settings.clearance_margin,
        },
        "machine": machine(),
        "software": versions("agile_jax", "casadi", "numpy"),
        "metrics": as_json([metric for name in methods for metric in _metrics(name, attempts)]),
        "starts": [
            {"start": pose.tolist(), **{name: _row(attempts[name][i]) for name in methods}}
            for i, pose in enumerate(poses)
        ],
    }


def _methods(scene: Scene, settings: ExpertSettings) -> tuple[dict[str, Callable[[np.ndarray], Attempt]], list[str]]:
    """By name, ours last; and the names of those that are not installed."""
    from agile_jax.benchmark.peers.opti_peer import make_opti_peer
    from agile_jax.benchmark.peers.rockit_peer import make_rockit_peer, rockit_is_installed

    peers = {
        "opti": make_opti_peer(scene, settings, 0.0),
        "opti_smooth": make_opti_peer(scene, settings, WIDTH),
    }
    if rockit_is_installed():
        peers["rockit"] = make_rockit_peer(scene, settings, WIDTH)
    methods = {name: _timed_peer(scene, settings, solve) for name, solve in peers.items()}
    methods["ours"] = _timed_expert(scene, settings, make_expert(scene, settings))
    return methods, [name for name in PEERS if name not in peers]


def _timed_peer(
    scene: Scene, settings: ExpertSettings, solve: Callable[[np.ndarray], PeerSolution]
) -> Callable[[np.ndarray], Attempt]:
    def attempt(start: np.ndarray) -> Attempt:
        found, spent = timed(solve, start)
        defects = measure(scene, settings, found.path)
        return Attempt(found.success, found.status, float(found.path.times[-1]), spent, defects)

    return attempt


def _timed_expert(scene: Scene, settings: ExpertSettings, expert: Expert) -> Callable[[np.ndarray], Attempt]:
    def attempt(start: np.ndarray) -> Attempt:
        found, spent = timed(expert.solve, start)
        if found.status != "solved":
            return Attempt(False, found.cause, 0.0, spent, Defects(np.inf, np.inf, np.inf))
        check = verify(scene, settings, found.trajectory, start)
        defects = Defects(check.dynamics_residual, check.bound_violation, check.clearance_violation)
        return Attempt(True, f"{found.branch}, gap {found.gap:.1e}", found.duration, spent, defects)

    return attempt


def _accepted(attempt: Attempt) -> bool:
    """Whether a path would pass as a label, by the tolerances of the expert's own check."""
    return (
        attempt.solved
        and attempt.defects.dynamics <= DYNAMICS_TOLERANCE
        and attempt.defects.bounds <= BOUND_TOLERANCE
        and attempt.defects.clearance <= CLEARANCE_TOLERANCE
    )


def _row(attempt: Attempt) -> Result:
    return {
        "solved": attempt.solved,
        "status": attempt.status,
        "duration_s": attempt.duration,
        "solve_ms": 1e3 * attempt.spent.wall,
        "clearance_violation_m": attempt.defects.clearance if attempt.solved else None,
    }


def _metrics(name: str, attempts: dict[str, list[Attempt]]) -> list[Metric]:
    """Those of one method, and, for a peer, ours against it."""
    mine, ours = attempts[name], attempts["ours"]
    solved = [attempt for attempt in mine if attempt.solved]
    milliseconds = [1e3 * attempt.spent.wall for attempt in mine]
    wall, cpu = (sum(seconds) for seconds in zip(*(attempt.spent for attempt in mine), strict=True))

    def over(values: list[float], reduce: Callable[[list[float]], float]) -> float | None:
        return float(reduce(values)) if values else None

    found = [
        Metric("solved", len(solved), "", "higher", "starts whose solver claims success; ours: a label"),
        Metric("accepted", sum(map(_accepted, mine)), "", "higher", "of these, passing the expert's independent check"),
        Metric("duration_median", over([a.duration for a in solved], np.median), "s", "lower", "of the solved starts"),
        Metric("solve_time_median", over(milliseconds, np.median), "ms", "lower", "wall time of one start"),
        Metric("solve_time_p95", over(milliseconds, lambda x: np.quantile(x, 0.95)), "ms", "lower", "of the same"),
        Metric("solved_per_core_second", len(solved) / cpu, "1/s", "higher", "solved starts over processor time"),
        Metric("cores_used", cpu / wall, "", "", "processor time over wall time; above 1 if threads were at work"),
        Metric(
            "worst_clearance_violation",
            over([a.defects.clearance for a in solved], max),
            "m",
            "lower",
            "shortfall of the exact clearance below the margin, at and between nodes",
        ),
        Metric(
            "worst_dynamics_defect",
            over([a.defects.dynamics for a in solved], max),
            "m, rad, m/s, rad/s",
            "lower",
            "deviation of a node from the accelerations, integrated exactly",
        ),
    ]
    if name != "ours":
        found += _against(mine, ours, found[5].value)
    return [metric._replace(key=f"{name}.{metric.key}") for metric in found]


def _against(peer: list[Attempt], ours: list[Attempt], rate: float | None) -> list[Metric]:
    """Ours against a peer."""
    both = [(mine, its) for mine, its in zip(ours, peer, strict=True) if mine.solved and its.solved]
    every = [mine.duration / its.duration - 1 for mine, its in both]
    fair = [mine.duration / its.duration - 1 for mine, its in both if its.defects.clearance <= CLEARANCE_TOLERANCE]
    our_rate = sum(mine.solved for mine in ours) / sum(mine.spent.cpu for mine in ours)
    over = "of our duration over the peer's, minus 1"
    return [
        Metric(
            "speed_ratio",
            our_rate / rate if rate else None,
            "",
            "higher",
            "our labels over its solves, per core and second",
            SPEED_TARGET,
        ),
        Metric("excess_median", float(np.median(every)) if every else None, "", "lower", f"median {over}"),
        Metric("excess_worst", max(every, default=None), "", "lower", f"largest {over}"),
        Metric(
            "excess_worst_where_clear",
            max(fair, default=None),
            "",
            "lower",
            f"largest {over}, where the peer's path keeps the margin, too",
            LONGER,
        ),
        Metric(
            "longer", sum(x > LONGER for x in every), "", "lower", f"starts from which we are longer by over {LONGER:g}"
        ),
        Metric("longer_where_clear", sum(x > LONGER for x in fair), "", "lower", "of these, its path keeps the margin"),
        Metric("shorter", sum(x < -LONGER for x in every), "", "higher", f"starts we are shorter by over {LONGER:g}"),
    ]


def report(result: Result) -> str:
    """The result as a table to read."""
    metrics = result["metrics"]
    names = [name for name in (*PEERS, "ours") if f"{name}.solved" in metrics]
    missing = [f"{name}: {text}" for name, text in result["peers"].items() if text == "not installed"]
    return text_of(result, comparison(metrics, names), *missing)
