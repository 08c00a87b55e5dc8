"""What a peer returns, and how far it is from what it should be: the same measures for every transcription."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.expert import ExpertSettings
from agile_jax.scene import POSE_SIZE, Scene, clearance

DENSE = 12  # points inside every interval at which clearance is measured, as for our own labels


class PeerPath(NamedTuple):
    """States on a grid, and accelerations that are linear over each of the T intervals."""

    times: Float[np.ndarray, " nodes"]  # T+1 of them, from 0 [s]
    states: Float[np.ndarray, "nodes 8"]  # [x y z yaw, rates] [m, rad, m/s, rad/s]
    first_controls: Float[np.ndarray, "T 4"]  # at the interval's begin [m/s^2, rad/s^2]
    last_controls: Float[np.ndarray, "T 4"]  # at its end; equal where the acceleration is constant over the interval


class PeerSolution(NamedTuple):
    """What a peer's solver says it has found."""

    path: PeerPath
    success: bool
    status: str


class Defects(NamedTuple):
    """Distances of a path from the problem; zero or rounding error when it solves it."""

    dynamics: float  # largest deviation of a node from the accelerations integrated exactly [m, rad, m/s, rad/s]
    bounds: float  # largest excess over a bound at a node
    clearance: float  # largest shortfall of the torso's exact clearance below the margin, at and between nodes [m]


def measure(scene: Scene, settings: ExpertSettings, path: PeerPath) -> Defects:
    """How far a path is from solving the problem."""
    poses, rates = path.states[:, :POSE_SIZE], path.states[:, POSE_SIZE:]
    excess = [
        scene.lower - poses,
        poses - scene.upper,
        np.abs(rates) - np.array(settings.velocity),
        np.abs(path.first_controls) - np.array(settings.acceleration),
        np.abs(path.last_controls) - np.array(settings.acceleration),
    ]
    nearest = float(np.min(clearance(scene, dense_poses(path))))
    return Defects(
        dynamics=float(np.abs(integrate(path) - path.states).max()),
        bounds=max(0.0, *(float(e.max()) for e in excess)),
        clearance=max(0.0, settings.clearance_margin - nearest),
    )


def integrate(path: PeerPath) -> np.ndarray:
    """States from integrating the accelerations exactly from the first state, shape (T+1, 8)."""
    h = np.diff(path.times)[:, None]
    first, last = path.first_controls, path.last_controls
    rates = path.states[0, POSE_SIZE:] + _sums(h * (first + last) / 2)
    poses = path.states[0, :POSE_SIZE] + _sums(h * rates[:-1] + h**2 * (2 * first + last) / 6)
    return np.concatenate([poses, rates], axis=1)


def dense_poses(path: PeerPath, points: int = DENSE) -> np.ndarray:
    """Poses at every node and `points` times inside each interval, each from its node's state; shape (..., 4)."""
    h = np.diff(path.times)[:, None, None]
    t = h * (np.arange(points + 1) / (points + 1))[None, :, None]
    pose, rate = path.states[:-1, None, :POSE_SIZE], path.states[:-1, None, POSE_SIZE:]
    first, last = path.first_controls[:, None, :], path.last_controls[:, None, :]
    inside = pose + t * rate + t**2 / 2 * first + t**3 / (6 * np.maximum(h, 1e-12)) * (last - first)
    return np.concatenate([inside.reshape(-1, POSE_SIZE), path.states[-1:, :POSE_SIZE]])


def _sums(steps: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
