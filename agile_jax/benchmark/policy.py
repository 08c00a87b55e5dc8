"""`agile benchmark policy`: one query of the policy against one solve of the expert that it imitates.

Both answer the same starts of the experiment's distribution in one process that is held to one core, in turn, so that
what else the machine does hits both alike. The policy is asked for one pose at a time and for a batch, from NumPy array
to NumPy array, limits and filter included; its weights are random, since the time does not depend on them. The expert's
solve is a label's: every route that could be best, and the independent check. Both have run before the clock starts.
"""

import numpy as np
from jaxtyping import Float

from agile_jax.benchmark.measuring import machine, timed, versions
from agile_jax.benchmark.metrics import Metric, Result, as_json, number, table, text_of
from agile_jax.dataset.starts import draw_start
from agile_jax.experiment import Experiment
from agile_jax.expert import make_expert
from agile_jax.progress import Progress, silent
from agile_jax.scene import make_scene

BATCH = 4096
SINGLE_CALLS = 10  # for each solve of the expert
SPEED_TARGET = 1000.0  # queries in a batch for one solve
METHOD = " ".join((__doc__ or "").partition("\n\n")[2].split())


def benchmark_policy(experiment: Experiment, starts: int = 100, progress: Progress = silent) -> Result:
    """Measure, and return what goes into the JSON file: `metrics` by key and the method."""
    import jax

    from agile_jax.policy import TrainedPolicy, make_policy

    scene, settings = make_scene(experiment.scene), experiment.expert
    expert = make_expert(scene, settings)
    policy = make_policy(scene, settings.limits, experiment.policy)
    velocities = TrainedPolicy(policy, policy.init(jax.random.key(0))).batch
    poses = np.concatenate(
        [
            draw_start(scene, experiment.scene, settings, experiment.dataset, experiment.seed, i).poses
            for i in range(starts)
        ]
    )
    batch = np.resize(poses, (BATCH, poses.shape[1]))

    for i, pose in enumerate(poses):  # builds the solvers that the measured starts need
        progress("warming up", i, starts)
        expert.solve(pose)
    velocities(poses[:1]), velocities(batch)
    singles, batches, solves = [], [], []
    for i, pose in enumerate(poses):
        solves.append(timed(expert.solve, pose)[1].wall)
        batches.append(timed(velocities, batch)[1].wall)
        singles += [timed(velocities, pose[None])[1].wall for _ in range(SINGLE_CALLS)]
        progress("measuring", i + 1, starts, "starts")
    return {
        "benchmark": "policy",
        "experiment": experiment.name,
        "method": METHOD,
        "problem": {
            "starts": starts,
            "batch": BATCH,
            "kind": experiment.policy.kind,
            "hidden_layers": list(experiment.policy.hidden_layers),
            "initial_velocity": settings.initial_velocity,
            "nodes": settings.nodes,
        },
        "machine": machine(),
        "software": versions("agile_jax", "casadi", "jax", "numpy"),
        "metrics": as_json(_metrics(np.array(singles), np.array(batches), np.array(solves))),
    }


def _metrics(
    singles: Float[np.ndarray, " n"], batches: Float[np.ndarray, " m"], solves: Float[np.ndarray, " m"]
) -> list[Metric]:
    """Medians and ratios of the calls' times [s]: single queries, batches of BATCH, solves."""
    found = []
    for key, seconds, unit, scale, meaning in (
        ("expert.solve", solves, "ms", 1e3, "one start"),
        ("policy.single", singles, "us", 1e6, "one pose, a call of its own"),
        ("policy.batch", batches, "ms", 1e3, f"{BATCH} poses in one call"),
        ("policy.query", batches / BATCH, "us", 1e6, f"one pose of {BATCH} in one call"),
    ):
        median, p99 = scale * float(np.median(seconds)), scale * float(np.quantile(seconds, 0.99))
        found.append(Metric(f"{key}_median", median, unit, "lower", meaning))
        found.append(Metric(f"{key}_p99", p99, unit, "lower", "of the same"))
    solve, mean = float(np.median(solves)), float(np.mean(solves))
    query, single = float(np.median(batches)) / BATCH, float(np.median(singles))
    return [
        *found,
        Metric("expert.solve_mean", 1e3 * mean, "ms", "lower", "of the same; a few hard starts take long"),
        Metric("speed_ratio", solve / query, "", "higher", "median solve over median query in a batch", SPEED_TARGET),
        Metric("speed_ratio_mean", mean / float(np.mean(batches)) * BATCH, "", "higher", "mean solve over mean query"),
        Metric("speed_ratio_single", solve / single, "", "higher", "median solve over a query of its own"),
    ]


def report(result: Result) -> str:
    """The result as a table to read."""
    rows = [
        (f"{key} [{metric['unit']}]" if metric["unit"] else key, [number(metric["value"]), metric["meaning"]])
        for key, metric in result["metrics"].items()
    ]
    return text_of(result, table(["value", "of"], rows))
