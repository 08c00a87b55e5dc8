"""Motions and traces that are known exactly, in the shapes of a real run."""

import pathlib
from typing import NamedTuple

import numpy as np

from agile_jax.expert import ExpertSettings
from agile_jax.geometry import yaw_to_quaternion
from agile_jax.report.settings import ReportSettings
from agile_jax.robot import RobotSettings, load_robot
from agile_jax.scene import SceneSettings

SECONDS = 3.0  # of every recorded episode
MOMENTS = 151  # at 50 Hz


class RunInputs(NamedTuple):
    """What the report reads of an experiment."""

    scene: SceneSettings
    name: str = "demo"
    expert: ExpertSettings = ExpertSettings(nodes=40)
    policy: None = None  # read only where there are checkpoints
    robot: RobotSettings = RobotSettings()
    report: ReportSettings = ReportSettings(renderer="drawing", width=320, height=180)


def crawl(sideways: float) -> tuple[np.ndarray, np.ndarray]:
    """Time (K,) and qpos (K, 19): the trunk moves from x = 0 to 3 m at y = `sideways`, down to 0.17 m at x = 1.5 m."""
    time = np.linspace(0.0, SECONDS, MOMENTS)
    x = time * 3.0 / SECONDS
    qpos = np.zeros((MOMENTS, 19))
    qpos[:, 0], qpos[:, 1] = x, sideways
    qpos[:, 2] = 0.28 - 0.11 * np.exp(-(((x - 1.5) / 0.5) ** 4))
    qpos[:, 3:7] = yaw_to_quaternion(np.zeros(MOMENTS))
    qpos[:, 7:] = load_robot(RobotSettings()).home_joint_pos
    return time, qpos


def write_traces(folder: pathlib.Path, sideways: list[float]) -> None:
    motions = [crawl(y) for y in sideways]
    time, qpos = (np.stack(parts) for parts in zip(*motions, strict=True))
    generator = np.random.default_rng(0)
    count = len(sideways)
    reference = np.zeros((count, MOMENTS, 8))
    reference[..., :3], reference[..., 4] = qpos[..., :3], 1.0
    np.savez(
        folder / "mujoco-traces.npz",
        time=time,
        qpos=qpos,
        qvel=generator.normal(size=(count, MOMENTS, 18)) * 0.1 + np.eye(18)[0],
        torque=generator.normal(size=(count, MOMENTS, 12)) * 8,
        reference=reference,
        clearance=np.abs(qpos[..., 0] - 1.5) / 2 + 0.02,
        length=np.full(count, MOMENTS),
    )
