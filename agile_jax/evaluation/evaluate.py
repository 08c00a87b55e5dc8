"""Closed-loop evaluation: starts, expert times, episodes in chunks, summary.

Each chunk of episodes is committed as it finishes; a killed evaluation goes on with the next one. Chunks are padded to
one batch size, so that there is one compilation and the numbers do not depend on how many episodes are asked for.
"""

import io
import pathlib
import time
import zipfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np

from agile_jax.control import ControlSettings
from agile_jax.engine import Engine
from agile_jax.evaluation.expert_time import expert_times
from agile_jax.evaluation.settings import EvaluationSettings
from agile_jax.evaluation.summary import summarize
from agile_jax.expert import ExpertSettings
from agile_jax.files import hash_json, write_atomic, write_json
from agile_jax.policy import PolicySettings, load_parameters, make_policy
from agile_jax.progress import silent
from agile_jax.robot import RobotSettings, build_mujoco_model, load_robot, standing_qpos
from agile_jax.scene import SceneSettings, make_scene, sample_starts
from agile_jax.simulation import (
    ClosedLoop,
    MujocoPhysics,
    Rollout,
    Trace,
    make_closed_loop,
    make_mjx_physics,
    run_mjx,
    run_mujoco,
)

START_STREAM = 7_001  # sets the evaluation's random stream apart from those of dataset and training


class Inputs(Protocol):
    """The settings that an evaluation reads; an Experiment has them."""

    seed: int
    scene: SceneSettings
    expert: ExpertSettings
    policy: PolicySettings
    robot: RobotSettings
    control: ControlSettings
    evaluation: EvaluationSettings


class Backend(NamedTuple):
    """What simulates a batch."""

    loop: ClosedLoop
    run: Callable[[np.ndarray, np.ndarray, int], Rollout]  # (qpos, time limits, traced)


def time_limit(expert_time: np.ndarray) -> np.ndarray:
    """Time that an episode has: 2 T* + 3 s."""
    return 2 * expert_time + 3.0


def evaluation_starts(inputs: Inputs) -> np.ndarray:
    """Start poses that no training has seen, shape (episodes, 4) [m, rad]."""
    start = inputs.scene.start
    return sample_starts(
        make_scene(inputs.scene),
        np.array(start.mean),
        np.array(start.std),
        inputs.evaluation.episodes,
        inputs.expert.clearance_margin,
        (inputs.seed, START_STREAM, inputs.evaluation.seed),
    ).poses


def make_backend(
    inputs: Inputs, training_directory: pathlib.Path, batch: int, threads: int, progress: Callable[[int, int, str], None]
) -> Backend:
    """Compose policy, controller and physics.

    Args:
        inputs: settings.
        training_directory: holds the policy's checkpoints.
        batch: episodes at once.
        threads: of the C physics.
        progress: called with (episodes ended, episodes, note).
    """
    scene = make_scene(inputs.scene)
    velocity_limit, acceleration_limit = np.array(inputs.expert.velocity), np.array(inputs.expert.acceleration)
    policy = make_policy(scene, velocity_limit, acceleration_limit, inputs.policy)
    parameters = load_parameters(training_directory, policy)
    robot = load_robot(inputs.robot)
    loop = make_closed_loop(scene, robot, inputs.control, policy.velocity, acceleration_limit)
    model = build_mujoco_model(scene, inputs.robot, inputs.control.control_dt)
    if inputs.evaluation.backend == "mjx":
        reset, step = make_mjx_physics(model)
        return Backend(loop, lambda qpos, limits, traced: run_mjx(loop, reset, step, parameters, qpos, limits))
    physics = MujocoPhysics(model, batch, threads)
    return Backend(
        loop,
        lambda qpos, limits, traced: run_mujoco(
            loop, physics, parameters, qpos, limits, scene, traced=traced, progress=progress
        ),
    )


def initial_qpos(inputs: Inputs, starts: np.ndarray) -> np.ndarray:
    """The robot standing at each start, shape (n, 19)."""
    robot = load_robot(inputs.robot)
    return np.stack([np.asarray(standing_qpos(robot, start)) for start in starts])


def evaluate(
    inputs: Inputs,
    run_directory: pathlib.Path,
    engine: Callable[[], AbstractContextManager[Engine]],
    threads: int = 2,
    progress: Callable[[int, int, str], None] = silent,
) -> dict[str, Any]:
    """Run the episodes and write `evaluation/<backend>.json`, `.npz` and `-traces.npz`.

    Args:
        inputs: settings, for example an Experiment.
        run_directory: holds `training/`.
        engine: opens the work engine for the expert's times.
        threads: of the C physics.
        progress: called with (episodes ended, episodes, note).

    Returns:
        The summary (keys in DESIGN section 3).
    """
    backend = inputs.evaluation.backend
    folder = run_directory / "evaluation"
    chunks = folder / f"{backend}-chunks"
    chunks.mkdir(parents=True, exist_ok=True)
    identity = hash_json(
        [
            inputs.seed,
            *(
                settings.model_dump(mode="json")
                for settings in (
                    inputs.scene,
                    inputs.expert,
                    inputs.policy,
                    inputs.robot,
                    inputs.control,
                    inputs.evaluation,
                )
            ),
            checkpoint_identity(run_directory / "training"),
        ]
    )
    starts = evaluation_starts(inputs)
    expert_file = chunks / "expert.npz"
    known = load_chunk(expert_file, identity)
    if known is None:
        progress(0, len(starts), "expert times")
        durations, branches = expert_times(inputs.scene, inputs.expert, starts, engine)
        known = {"expert_time": durations, "branch": np.array(branches)}
        save_chunk(expert_file, identity, known)
    expert_time = known["expert_time"]
    # Where the expert found no path the episode still runs, with a limit that a path would not need.
    longest = float(np.nanmax(expert_time)) if np.isfinite(expert_time).any() else 10.0
    limits = time_limit(np.where(np.isfinite(expert_time), expert_time, longest))

    batch = min(inputs.evaluation.batch, len(starts))
    simulator: Backend | None = None
    rows: list[dict[str, np.ndarray]] = []
    for number, first in enumerate(range(0, len(starts), batch)):
        path = chunks / f"chunk-{number:04d}.npz"
        row = load_chunk(path, identity)
        if row is None:
            if simulator is None:
                simulator = make_backend(inputs, run_directory / "training", batch, threads, progress)
            selected = np.arange(first, first + batch) % len(starts)  # the last chunk is padded with the first starts
            valid = min(batch, len(starts) - first)
            begun = time.perf_counter()
            traced = min(inputs.evaluation.traced, valid) if number == 0 else 0
            rollout = simulator.run(initial_qpos(inputs, starts[selected]), limits[selected], traced)
            row = rows_of(rollout, valid) | {"seconds": np.array(time.perf_counter() - begun)}
            if rollout.traces:
                save_traces(folder / f"{backend}-traces.npz", rollout.traces)
            save_chunk(path, identity, row)
        rows.append(row)
        progress(min(first + batch, len(starts)), len(starts), "episodes")
    columns = {name: np.concatenate([row[name] for row in rows]) for name in rows[0] if name != "seconds"}
    columns |= {"start": starts, "expert_time": expert_time, "time_limit": limits, "branch": known["branch"]}
    seconds = float(sum(row["seconds"] for row in rows))
    summary = {"backend": backend, "device": device_name(backend)} | summarize(columns, inputs.control, seconds)
    buffer = io.BytesIO()
    np.savez(buffer, **columns)
    write_atomic(folder / f"{backend}.npz", buffer.getvalue())
    write_json(folder / f"{backend}.json", summary)
    return summary


def device_name(backend: str) -> str:
    """Where physics ran."""
    return "cpu" if backend == "mujoco" else str(jax.devices()[0].device_kind)


def rows_of(rollout: Rollout, count: int) -> dict[str, np.ndarray]:
    """One entry per episode."""
    outcome = rollout.outcome
    steps = np.maximum(outcome.steps, 1)
    columns = {
        "outcome": outcome.status.astype(np.int8),
        "success": outcome.status == 0,
        "end_time": outcome.time,
        "arrival_time": np.where(outcome.status == 0, outcome.inside_since, np.nan),
        "min_clearance": outcome.min_clearance,
        "final_error": outcome.planar_error,
        "velocity_tracking_rmse": np.sqrt(outcome.velocity_error_sum / steps),
        "torque_saturation": outcome.saturated / (12 * steps),
        "steps": outcome.steps,
        "mpc_failures": rollout.mpc_failures,
        "plans": rollout.plans,
    }
    return {name: np.asarray(values)[:count] for name, values in columns.items()}


def checkpoint_identity(training_directory: pathlib.Path) -> str:
    """What distinguishes the trained policy: the hashes of its last checkpoint's files."""
    files = sorted(training_directory.glob("checkpoints/**/integrity.json"), key=lambda path: path.parts)
    return hash_json([path.read_text() for path in files])


def save_chunk(path: pathlib.Path, identity: str, columns: dict[str, np.ndarray]) -> None:
    """Commit the columns of some episodes."""
    buffer = io.BytesIO()
    np.savez(buffer, identity=np.array(identity), **columns)
    write_atomic(path, buffer.getvalue())


def load_chunk(path: pathlib.Path, identity: str) -> dict[str, np.ndarray] | None:
    """The columns of a committed chunk; None when it is not there, damaged, or of other settings."""
    try:
        with np.load(path, allow_pickle=False) as file:
            columns = {name: file[name] for name in file.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    if str(columns.pop("identity", "")) != identity:
        return None
    return columns


def save_traces(path: pathlib.Path, traces: list[Trace]) -> None:
    """Traces padded to the longest with their last sample; `length` tells how many samples count."""
    longest = max(len(trace.time) for trace in traces)

    def pad(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, np.repeat(values[-1:], longest - len(values), 0)])

    columns = {name: np.stack([pad(getattr(trace, name)) for trace in traces]) for name in Trace._fields}
    buffer = io.BytesIO()
    np.savez(buffer, length=np.array([len(trace.time) for trace in traces]), **columns)
    write_atomic(path, buffer.getvalue())
