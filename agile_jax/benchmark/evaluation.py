"""`agile benchmark evaluation`: speed of the closed loop by backend and batch, and where the time goes.

Every robot walks from a start of the experiment's distribution under the trained policy; everything that an evaluation
does is in the time: policy, reference, MPC, feet, torques, physics, clearance, outcome. Compilation is not: each
function has run before the clock starts. The parts of the C backend are timed one by one in the same run. Physics alone
replays the recorded torques through one call of `mujoco.rollout`: what no controller in the loop can exceed. Of several
repetitions the fastest counts, because other work on the machine can only slow it down. Workers (`evaluation.where`)
are one for each core, measured at the same time, the median of the repetitions of each; their speeds are added up.
"""

import pathlib
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import mujoco
import mujoco.rollout
import numpy as np

from agile_jax.benchmark.measuring import machine, timed, versions
from agile_jax.benchmark.metrics import Metric, Result, as_json, number, table
from agile_jax.engine import TaskFailure, TasksFailedError, open_engine
from agile_jax.evaluation.backend import Backend, command_parameters, make_backend
from agile_jax.evaluation.stage import evaluation_starts
from agile_jax.experiment import Experiment
from agile_jax.progress import Progress, silent
from agile_jax.simulation import Episode, MjxSlots, MujocoSlots, Sensed
from agile_jax.simulation.plan_cycle import on_host, plan_cycle

METHOD = " ".join((__doc__ or "").partition("\n\n")[2].split())
SIMULATED = 1.0  # in one repetition [s]
REPETITIONS = 3
ENDLESS = 1e6  # time limit of the episodes [s]: none ends while the clock runs
WORKER_REPETITIONS = 5
WORKER_BATCHES = (64, 128)
CPU_BATCHES = {"mujoco": (1, 16, 64, 256), "mjx": (1, 16, 64)}
GPU_BATCHES = {"mujoco": (64, 256), "mjx": (64, 1024, 4096)}
LOOP_TARGET = {"cpu": 15.0, "gpu": 600.0}  # simulated seconds per second of the best batch


class Parts(NamedTuple):
    """Wall time of the parts of the C backend's loop [s], for `SIMULATED` seconds of every robot."""

    plan: float
    act: float
    physics: float
    replay: float  # the same physics in one call of mujoco.rollout


def benchmark_evaluation(
    experiment: Experiment, run_dir: pathlib.Path, threads: int = 2, progress: Progress = silent
) -> Result:
    """Measure, and return what goes into the JSON file.

    Args:
        experiment: all settings.
        run_dir: holds the policy under `training/`.
        threads: of the C physics.
        progress: is told of each measurement.
    """
    device = jax.devices()[0]
    batches = CPU_BATCHES if device.platform == "cpu" else GPU_BATCHES
    plan = [(backend, batch) for backend, sizes in batches.items() for batch in sizes]
    metrics: list[Metric] = []
    best: dict[str, float] = {}
    for done, (backend, batch) in enumerate(plan):
        progress("measuring", done, len(plan), f"{backend}, {batch} robots")
        speed, parts = _measure(_inputs(experiment, backend, batch), run_dir, batch, threads)
        best[backend] = max(best.get(backend, 0.0), speed)
        metrics.append(
            Metric(f"{backend}_{batch}_speed", speed, "s/s", "higher", "simulated seconds per second, all included")
        )
        if parts is not None:
            metrics += _part_metrics(batch, parts)
    if device.platform == "cpu":
        for batch in WORKER_BATCHES:
            progress("measuring", len(plan), len(plan) + 1, f"workers, {batch} robots each")
            speed, workers = _workers_speed(_inputs(experiment, "mujoco", batch), run_dir, batch)
            best["workers"] = max(best.get("workers", 0.0), speed)
            meaning = f"the same in {workers} workers of {batch} robots each"
            metrics.append(Metric(f"workers_{batch}_speed", speed, "s/s", "higher", meaning))
    target = LOOP_TARGET["cpu" if device.platform == "cpu" else "gpu"]
    fastest = max(best.values())
    metrics.append(Metric("best_speed", fastest, "s/s", "higher", "of the fastest backend and batch", target))
    return {
        "benchmark": "evaluation",
        "experiment": experiment.name,
        "method": METHOD,
        "machine": machine(device=str(device.device_kind), threads=threads),
        "software": versions("agile_jax", "jax", "mujoco", "mujoco-mjx"),
        "metrics": as_json(metrics),
    }


def report(result: Result) -> str:
    """The numbers as a table, with the method."""
    rows = [
        (key, (number(metric["value"]), metric["unit"], metric["meaning"])) for key, metric in result["metrics"].items()
    ]
    return f"{table(('value', 'unit', 'meaning'), rows)}\n\n{result['method']}"


def _inputs(experiment: Experiment, backend: str, batch: int) -> Experiment:
    settings = experiment.evaluation.model_copy(update={"backend": backend, "episodes": batch, "planner": "policy"})
    return experiment.model_copy(update={"evaluation": settings})


def _workers_speed(experiment: Experiment, run_dir: pathlib.Path, batch: int) -> tuple[float, int]:
    """The speed of all workers together, and their number."""
    with open_engine() as engine:
        tasks = [(experiment, run_dir.resolve(), batch)] * engine.workers
        results = [result for _, result in engine.map(_worker_speed, tasks)]
    speeds = [result for result in results if not isinstance(result, TaskFailure)]
    for failure in results:
        if isinstance(failure, TaskFailure):
            raise TasksFailedError(f"a worker failed: {failure.cause}")
    return sum(speeds), len(speeds)


def _worker_speed(task: tuple[Experiment, pathlib.Path, int]) -> float:
    """The speed of one worker. Runs there."""
    experiment, run_dir, batch = task
    _, simulated, repeat = _prepare(experiment, run_dir, batch, 1)
    return batch * simulated / float(np.median([repeat() for _ in range(WORKER_REPETITIONS)]))


def _measure(experiment: Experiment, run_dir: pathlib.Path, batch: int, threads: int) -> tuple[float, Parts | None]:
    backend, simulated, repeat = _prepare(experiment, run_dir, batch, threads)
    slots = backend.slots
    speed = batch * simulated / min(repeat() for _ in range(REPETITIONS))
    if isinstance(slots, MjxSlots):
        return speed, None
    qpos, keys = backend.qpos(evaluation_starts(experiment)), backend.keys(np.arange(batch))
    return speed, _parts(slots, qpos, keys, threads, backend.plan_dt)


def _prepare(
    experiment: Experiment, run_dir: pathlib.Path, batch: int, threads: int
) -> tuple[Backend, float, Callable[[], float]]:
    """The compiled loop, what a repetition simulates of each robot [s], and a repetition, which gives its time [s]."""
    backend = make_backend(experiment, command_parameters(experiment, run_dir / "training"), batch, threads)
    qpos = backend.qpos(evaluation_starts(experiment))
    slots, everyone, limits = backend.slots, np.arange(batch), np.full(batch, ENDLESS)
    segment = backend.plan_dt if isinstance(slots, MujocoSlots) else backend.plan_dt * slots.plans_per_advance
    advances = max(1, round(SIMULATED / segment))

    def begin() -> None:
        slots.begin(everyone, qpos, limits, None, backend.keys(everyone))

    begin()
    slots.advance()  # compiles
    begin()
    return backend, advances * segment, lambda: timed(lambda: [slots.advance() for _ in range(advances)])[1].wall


class _Timed:
    """The loop of `MujocoSlots` with a clock on each of its parts."""

    def __init__(self, slots: MujocoSlots) -> None:
        self._slots = slots
        self.plan_seconds = self.act_seconds = self.physics_seconds = 0.0
        self.torques: list[np.ndarray] = []  # (n, 12) of every step [Nm]

    def plan(self, episode: Episode, sensed: Sensed) -> Episode:
        episode, spent = timed(lambda: jax.block_until_ready(self._slots.plan(episode, sensed)))
        self.plan_seconds += spent.wall
        return episode

    def act(self, episode: Episode, sensed: Sensed) -> Episode:
        begun = time.perf_counter()
        episode = jax.block_until_ready(self._slots.loop.act(episode, sensed))
        self.torques.append(np.asarray(episode.torque, np.float64))
        self.act_seconds += time.perf_counter() - begun
        return episode

    def step(self, world: None, episode: Episode) -> tuple[None, Sensed]:
        sensed, spent = timed(self._slots.physics.step, self.torques[-1])
        self.physics_seconds += spent.wall
        return world, sensed


def _parts(slots: MujocoSlots, qpos: np.ndarray, keys: np.ndarray, threads: int, plan_dt: float) -> Parts:
    """The time of each part of the loop: the fastest of the repetitions."""
    acts = slots.loop.acts_per_plan
    plans = max(1, round(SIMULATED / plan_dt))
    runs = []
    for _ in range(REPETITIONS):
        clocked = _Timed(slots)
        sensed = slots.physics.reset(qpos)
        episodes = slots.loop.first(sensed, np.full(len(qpos), ENDLESS, np.float32), keys)
        for _ in range(plans):
            _, episodes, sensed = plan_cycle(
                clocked.plan, clocked.act, clocked.step, None, episodes, sensed, acts, on_host
            )
        runs.append(clocked)

    model = slots.physics.model
    state = np.zeros((len(qpos), 1 + model.nq + model.nv))
    state[:, 1 : 1 + model.nq] = qpos
    torques = np.nan_to_num(np.stack(runs[-1].torques, 1))
    data = [mujoco.MjData(model) for _ in range(min(threads, len(qpos)))]
    with mujoco.rollout.Rollout(nthread=len(data) if len(data) > 1 else 0) as replay:
        run = lambda: replay.rollout([model] * len(qpos), data, state, torques)  # noqa: E731
        fastest = min(timed(run)[1].wall for _ in range(REPETITIONS))
    return Parts(
        min(run.plan_seconds for run in runs),
        min(run.act_seconds for run in runs),
        min(run.physics_seconds for run in runs),
        fastest,
    )


def _part_metrics(batch: int, parts: Parts) -> list[Metric]:
    total = parts.plan + parts.act + parts.physics
    share = {"plan": "policy, reference, MPC", "act": "feet, torques, clearance, outcome", "physics": "C MuJoCo"}
    metrics = [
        Metric(f"mujoco_{batch}_{name}_share", getattr(parts, name) / total, "", "", f"of the time: {what}")
        for name, what in share.items()
    ]
    replayed = batch * SIMULATED / parts.replay
    controlled = batch * SIMULATED / (parts.plan + parts.act)
    return [
        *metrics,
        Metric(
            f"mujoco_{batch}_without_physics", controlled, "s/s", "higher", "the loop's speed if physics took no time"
        ),
        Metric(f"mujoco_{batch}_physics_alone", replayed, "s/s", "higher", "mujoco.rollout with the same torques"),
        Metric(f"mujoco_{batch}_of_physics_alone", parts.replay / total, "", "higher", "the loop's speed over that"),
    ]
