"""Motions and traces that are known exactly, in the shapes of a real run."""

import pathlib

import numpy as np

from agile_jax.evaluation.traces import save_traces
from agile_jax.experiment import Experiment
from agile_jax.expert import ExpertSettings
from agile_jax.report.settings import ReportSettings
from agile_jax.robot import RobotSettings, load_robot
from agile_jax.scene import SceneSettings
from agile_jax.simulation import Trace

SECONDS = 3.0  # of every recorded episode
MOMENTS = 151  # at 50 Hz


def known_experiment(scene: SceneSettings) -> Experiment:
    """What the report reads of a run with drawn pictures."""
    return Experiment(
        name="demo",
        scene=scene,
        expert=ExpertSettings(nodes=40),
        report=ReportSettings(renderer="drawing", width=320, height=180),
    )


def crawl(sideways: float) -> tuple[np.ndarray, np.ndarray]:
    """Time (K,) and qpos (K, 19): the trunk moves from x = 0 to 3 m at y = `sideways`, down to 0.17 m at x = 1.5 m."""
    time = np.linspace(0.0, SECONDS, MOMENTS)
    x = time * 3.0 / SECONDS
    qpos = np.zeros((MOMENTS, 19))
    qpos[:, 0], qpos[:, 1] = x, sideways
    qpos[:, 2] = 0.28 - 0.11 * np.exp(-(((x - 1.5) / 0.5) ** 4))
    qpos[:, 3:7] = [1.0, 0.0, 0.0, 0.0]
    qpos[:, 7:] = load_robot(RobotSettings()).home_joint_pos
    return time, qpos


def known_trace(sideways: float = 0.0, seed: int = 0) -> Trace:
    """The motion of `crawl` with rates, torques and a clearance that look like a robot's."""
    time, qpos = crawl(sideways)
    generator = np.random.default_rng(seed)
    reference = np.zeros((MOMENTS, 8))
    reference[:, :3], reference[:, 4] = qpos[:, :3], 1.0
    return Trace(
        time=time,
        qpos=qpos,
        qvel=generator.normal(size=(MOMENTS, 18)) * 0.1 + np.eye(18)[0],
        torque=generator.normal(size=(MOMENTS, 12)) * 8,
        reference=reference,
        mpc_status=np.zeros(MOMENTS, np.int8),
        mpc_residual=np.zeros(MOMENTS),
        saturated=np.zeros((MOMENTS, 12), bool),
        clearance=np.abs(qpos[:, 0] - 1.5) / 2 + 0.02,
    )


def write_traces(folder: pathlib.Path, sideways: list[float]) -> None:
    """A recorded episode of each `known_trace`, as an evaluation stores it."""
    save_traces(folder / "mujoco-traces.npz", [known_trace(y, seed) for seed, y in enumerate(sideways)])
