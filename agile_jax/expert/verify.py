"""The independent check of a trajectory: NumPy only, sharing nothing with the solver but the problem.

The controls are integrated from the stated initial condition in closed form; clearance is the exact one of the scene
(the torso's box with its yaw), at many points inside every interval.
"""

import numpy as np

from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import Residuals, Trajectory
from agile_jax.scene import POSE_SIZE, Scene, clearance

DENSE = 12  # points inside every interval at which clearance is measured

DYNAMICS_TOLERANCE = 1e-6  # [m, rad, m/s, rad/s]
END_TOLERANCE = 1e-6  # [m, rad, m/s, rad/s]
BOUND_TOLERANCE = 1e-6  # [m, rad, m/s, rad/s, m/s^2, rad/s^2]
CLEARANCE_TOLERANCE = 0.0  # [m]


def integrate(trajectory: Trajectory) -> np.ndarray:
    """States from integrating the controls exactly from the first state. Shape (T+1, 8)."""
    steps = np.diff(trajectory.times)[:, None]
    rates = trajectory.states[0, POSE_SIZE:] + np.concatenate(
        [np.zeros((1, POSE_SIZE)), np.cumsum(steps * trajectory.controls, axis=0)]
    )
    moves = steps * rates[:-1] + steps**2 / 2 * trajectory.controls
    poses = trajectory.states[0, :POSE_SIZE] + np.concatenate([np.zeros((1, POSE_SIZE)), np.cumsum(moves, axis=0)])
    return np.concatenate([poses, rates], axis=1)


def dense_poses(trajectory: Trajectory, points: int = DENSE) -> np.ndarray:
    """Poses at every node and `points` times inside each interval, shape (T * (points + 1) + 1, 4)."""
    steps = np.diff(trajectory.times)[:, None, None]
    t = steps * (np.arange(points + 1) / (points + 1))[None, :, None]
    pose, rate = trajectory.states[:-1, None, :POSE_SIZE], trajectory.states[:-1, None, POSE_SIZE:]
    inside = pose + t * rate + t**2 / 2 * trajectory.controls[:, None, :]
    return np.concatenate([inside.reshape(-1, POSE_SIZE), trajectory.states[-1:, :POSE_SIZE]])


def verify(
    scene: Scene,
    settings: ExpertSettings,
    trajectory: Trajectory,
    start: np.ndarray,
    initial_velocity: str | None = None,
) -> Residuals:
    """Measure how far a trajectory is from solving the problem.

    Args:
        scene: obstacles, target and bounds of the pose.
        settings: bounds, margin, end conditions.
        trajectory: T intervals.
        start: pose, shape (4,).
        initial_velocity: "rest" or "free"; None takes the settings'.
    """
    states, controls = trajectory.states, trajectory.controls
    poses, rates = states[:, :POSE_SIZE], states[:, POSE_SIZE:]
    ends = [poses[0] - start, poses[-1] - scene.target, rates[-1]]
    if (initial_velocity or settings.initial_velocity) == "rest":
        ends.append(rates[0])
    if settings.zero_end_controls:
        ends += [controls[0], controls[-1]]
    excess = [
        scene.lower - poses,
        poses - scene.upper,
        np.abs(rates) - np.array(settings.velocity),
        np.abs(controls) - np.array(settings.acceleration),
        -np.diff(trajectory.times)[:, None],
    ]
    nearest = float(clearance(scene, dense_poses(trajectory)).min())
    return Residuals(
        dynamics_residual=float(np.abs(integrate(trajectory) - states).max()),
        end_residual=float(max(np.abs(end).max() for end in ends)),
        bound_violation=max(0.0, *(float(e.max()) for e in excess)),
        clearance_violation=max(0.0, settings.clearance_margin - nearest),
        min_clearance=nearest,
    )


def rejection(residuals: Residuals) -> str:
    """Why a trajectory with these residuals is not accepted; "" when it is. NaN is never accepted."""
    limits = (
        ("dynamics_residual", DYNAMICS_TOLERANCE),
        ("end_residual", END_TOLERANCE),
        ("bound_violation", BOUND_TOLERANCE),
        ("clearance_violation", CLEARANCE_TOLERANCE),
    )
    for name, limit in limits:
        if not getattr(residuals, name) <= limit:
            return f"{name} {getattr(residuals, name):.2e} exceeds {limit:.0e}"
    return ""
