"""`agile benchmark mpc`: our solver against general ones on the MPC's problems of walking robots.

The problems are recorded in MuJoCo from random commands; the hard ones start from disturbed states. All methods get the
same problems with all rows: friction, normal forces, torques and positions of the joints. QP solvers, and
`ours_pyramid`, take the pyramid inside the cone; Clarabel and ours the cone. Accuracy is the largest error in a
component of the first node's forces, which are those that the robot applies, against Clarabel at 1e-9 on the same
constraints; problems that it finds infeasible are left out. Peers are timed for set-up and solution, from cold, of
matrices that were condensed before the clock started; ours for everything after the problem is built, from cold. One
thread; processor time; the best of three passes over all problems.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.benchmark.measuring import machine, timed, versions
from agile_jax.benchmark.metrics import Better, Metric, Result, as_json, missed, number, table
from agile_jax.benchmark.peers.dense_qp import DenseQp, dense_qp, violations
from agile_jax.benchmark.peers.qp_peer import Peer
from agile_jax.benchmark.peers.qp_solvers import make_clarabel, make_peers
from agile_jax.benchmark.workloads.mpc_problems import record_problems
from agile_jax.control.mpc.problem import MpcConstants, Qp, mpc_constants
from agile_jax.control.mpc.solver.cascade import cold_start, make_solver
from agile_jax.control.settings import ControlSettings, MpcSettings
from agile_jax.progress import Progress, silent

BATCHES = (64, 1024)
GPU_BATCHES = (64, 1024, 4096)
ACCURATE = 0.1  # [N]
PASSES = 3
EXACT = 1e-9
CONDITIONS = {"calm": 0.5, "hard": 1.0}  # ours at batch over the fastest peer: the target
METHOD = " ".join((__doc__ or "").partition("\n\n")[2].split())


class Measured(NamedTuple):
    """One method on one condition's problems."""

    forces: list[np.ndarray | None]  # (n,) of each problem
    rate: float  # solves a second and core
    latencies: np.ndarray  # wall time of single solves [s]; empty for batches
    pyramid: bool


def benchmark_mpc(settings: ControlSettings, count: int = 1000, progress: Progress = silent) -> Result:
    """Measure, and return what goes into the JSON file: `metrics` by key, and the method.

    Args:
        settings: of the controller.
        count: problems of each kind.
        progress: is told of each solver.
    """
    recorded = record_problems(settings, count, progress=progress)
    constants = mpc_constants(settings.mpc)
    peers, missing = make_peers(settings.mpc)
    gpu = jax.default_backend() != "cpu"
    metrics: list[Metric] = []
    for condition in CONDITIONS:
        qp = getattr(recorded, condition)
        problems = [dense_qp(constants, qp, index) for index in range(count)]
        exact: dict[bool, list[np.ndarray | None]] = {}
        for pyramid in (False, True):
            progress(condition, 0, count, "exact solutions")
            reference = make_clarabel(EXACT, pyramid)
            exact[pyramid] = [reference.prepare(problem)() for problem in problems]
        found: dict[str, Measured] = {}
        for name, peer in peers.items():
            progress(condition, 0, count, name)
            found[name] = measure_peer(peer, problems)
        for name, batch, pyramid in ours(gpu):
            progress(condition, 0, count, name)
            found[name] = measure_ours(settings.mpc, constants, qp, problems, batch, pyramid)
        metrics += condition_metrics(condition, found, problems, exact)
    return {
        "benchmark": "mpc",
        "method": METHOD,
        "peers": {name: peer.about for name, peer in peers.items()} | missing,
        "missing": sorted(missing),
        "problem": {"count": count, "horizon": settings.mpc.horizon, "mpc_dt_s": settings.mpc.mpc_dt},
        "machine": machine(device=str(jax.devices()[0].device_kind)),
        "software": versions("agile_jax", "jax", "casadi", "numpy", *peers),
        "metrics": as_json(metrics),
    }


def ours(gpu: bool) -> list[tuple[str, int, bool]]:
    """Name, batch and whether the pyramid, of the variants of our solver."""
    batches = GPU_BATCHES if gpu else BATCHES
    return [
        ("ours_1", 1, False),
        *((f"ours_{batch}", batch, False) for batch in batches),
        *((f"ours_pyramid_{batch}", batch, True) for batch in batches),
    ]


def measure_peer(peer: Peer, problems: list[DenseQp]) -> Measured:
    """All problems one by one."""
    solves = [peer.prepare(problem) for problem in problems]
    solves[0]()
    forces: list[np.ndarray | None] = []
    best, latencies = np.inf, np.full(len(problems), np.inf)
    for _ in range(PASSES):
        cpu, forces = 0.0, []
        for i, solve in enumerate(solves):
            x, spent = timed(solve)
            forces.append(x)
            cpu, latencies[i] = cpu + spent.cpu, min(latencies[i], spent.wall)
        best = min(best, cpu)
    return Measured(forces, len(problems) / best, latencies, peer.pyramid)


def measure_ours(
    settings: MpcSettings, constants: MpcConstants, qp: Qp, problems: list[DenseQp], batch: int, pyramid: bool
) -> Measured:
    """All problems in batches, the last one filled up with the first problems."""
    shape = settings.model_copy(update={"friction_cone": "pyramid" if pyramid else "cone"})
    solve_one = make_solver(constants, shape)
    cold = cold_start(settings.horizon)
    single = jax.jit(lambda problem: solve_one(problem, cold).forces)
    many = jax.jit(jax.vmap(lambda problem: solve_one(problem, cold).forces))
    count = len(problems)
    parts = [np.arange(first, first + batch) % count for first in range(0, count, batch)]
    if batch == 1:
        inputs = [jax.tree.map(lambda values, i=i: jnp.asarray(values[i]), qp) for i in range(count)]
        solve = single
    else:
        inputs = [jax.tree.map(lambda values, part=part: jnp.asarray(values[part]), qp) for part in parts]
        solve = many

    def run(data: Qp) -> jax.Array:
        return jax.block_until_ready(solve(data))

    jax.block_until_ready((run(inputs[0]), inputs))
    results: list[jax.Array] = []
    best, latencies = np.inf, np.full(len(inputs), np.inf)
    for _ in range(PASSES):
        cpu, results = 0.0, []
        for i, data in enumerate(inputs):
            found, spent = timed(run, data)
            results.append(found)
            cpu, latencies[i] = cpu + spent.cpu, min(latencies[i], spent.wall)
        # A GPU works while its processor waits: there, the clock on the wall counts.
        best = min(best, float(latencies.sum()) if jax.default_backend() != "cpu" else cpu)
    rows = np.asarray(jnp.stack(results) if batch == 1 else jnp.concatenate(results), float)[:count]
    forces: list[np.ndarray | None] = [
        row.reshape(-1)[problem.columns] for row, problem in zip(rows, problems, strict=True)
    ]
    return Measured(forces, batch * len(inputs) / best, latencies if batch == 1 else np.empty(0), pyramid)


def condition_metrics(
    condition: str,
    found: dict[str, Measured],
    problems: list[DenseQp],
    exact: dict[bool, list[np.ndarray | None]],
) -> list[Metric]:
    """The metrics of all methods on one kind of problems."""
    metrics: list[Metric] = []
    accurate: dict[str, float] = {}
    for name, measured in found.items():
        errors, broken = [], []
        failed = 0
        for problem, x, best in zip(problems, measured.forces, exact[measured.pyramid], strict=True):
            if best is None:
                continue
            if x is None:
                failed += 1
                continue
            first = int(problem.columns[:12].sum())
            errors.append(np.abs(x - best)[:first].max())
            broken.append(violations(problem, x, measured.pyramid))
        share = float(np.sum(np.array(errors) <= ACCURATE) / max(len(errors) + failed, 1))
        accurate[name] = share * measured.rate
        cone, torque, joint = np.max(np.array(broken), 0) if broken else [np.nan] * 3

        def add(key: str, value: float | None, unit: str, better: Better, meaning: str, name: str = name) -> None:
            metrics.append(Metric(f"{condition}.{name}.{key}", value, unit, better, meaning))

        add("solves_per_core_second", measured.rate, "1/s", "higher", "")
        add("accurate_share", share, "", "higher", f"first node's forces within {ACCURATE} N of the optimum")
        add("error_median", float(np.median(errors)), "N", "lower", "of the first node's forces")
        add("error_worst", float(np.max(errors)), "N", "lower", "of the first node's forces")
        add("failed", failed, "", "lower", "problems without an answer")
        add("cone_violation", float(cone), "N", "lower", "worst")
        add("torque_violation", float(torque), "Nm", "lower", "worst")
        add("joint_violation", float(joint), "rad", "lower", "worst, predicted")
        if len(measured.latencies):
            add("latency_median", 1e3 * float(np.median(measured.latencies)), "ms", "lower", "wall time of one solve")
            add("latency_p99", 1e3 * float(np.quantile(measured.latencies, 0.99)), "ms", "lower", "the same")
    skipped = sum(best is None for best in exact[False])
    metrics.append(Metric(f"{condition}.infeasible", skipped, "", "", "problems without a solution, left out"))
    peers = {name: rate for name, rate in accurate.items() if not name.startswith("ours")}
    if peers:
        fastest = max(peers, key=lambda name: peers[name])
        for name, rate in accurate.items():
            if name.startswith("ours"):
                meaning = f"accurate solves a second and core, over those of {fastest}"
                target = CONDITIONS[condition] if name == "ours_64" else None
                ratio = rate / peers[fastest]
                metrics.append(Metric(f"{condition}.{name}.speed_ratio", ratio, "", "higher", meaning, target))
    return [metric._replace(target=5.0) if metric.key.endswith("ours_1.latency_p99") else metric for metric in metrics]


def report(result: Result) -> str:
    """The result as tables to read."""
    metrics = result["metrics"]
    lines = [f"mpc: {result['problem']['count']} problems of each kind, {result['machine']['device']}"]
    for condition in CONDITIONS:
        keys = [key.split(".") for key in metrics if key.startswith(f"{condition}.") and key.count(".") == 2]
        names = list(dict.fromkeys(name for _, name, _ in keys))
        columns = list(dict.fromkeys(column for _, _, column in keys))
        rows = []
        for name in names:
            cells = [metrics.get(f"{condition}.{name}.{column}") for column in columns]
            rows.append((name, [number(cell["value"]) if cell else "" for cell in cells]))
        titles = []
        for column in columns:
            unit = next(metric["unit"] for key, metric in metrics.items() if key.endswith(f".{column}"))
            titles.append(f"{column} [{unit}]" if unit else column)
        infeasible = number(metrics[f"{condition}.infeasible"]["value"])
        lines += ["", f"{condition} (infeasible: {infeasible})", table(titles, rows)]
    lines += [f"{name}: not measured: {result['peers'][name]}" for name in result["missing"]]
    return "\n".join([*lines, *missed(metrics)])
