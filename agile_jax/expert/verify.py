"""The independent check of a trajectory: NumPy only, sharing nothing with the solver but the problem.

The controls are integrated from the stated initial condition in closed form, by the scheme that the labels claim;
clearance is the exact one of the scene (the torso's box with its yaw). Clearance and the bounds of the pose are
measured at many points inside every interval.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.expert.settings import ExpertSettings, InitialVelocity, checked_initial_velocity
from agile_jax.expert.solution import Residuals, Trajectory
from agile_jax.scene import POSE_SIZE, Scene, clearance, facing

DENSE = 12  # points inside every interval at which clearance is measured

DYNAMICS_TOLERANCE = 1e-6  # [m, rad, m/s, rad/s]
END_TOLERANCE = 1e-6  # [m, rad, m/s, rad/s]
BOUND_TOLERANCE = 1e-6  # [m, rad, m/s, rad/s, m/s^2, rad/s^2]
CLEARANCE_TOLERANCE = 0.0  # [m]


RejectionKind = Literal["dynamics", "ends", "bounds", "clearance"]


class Rejection(NamedTuple):
    """Why a trajectory is not accepted."""

    kind: RejectionKind
    text: str  # the residual, and its limit


def integrate(trajectory: Trajectory, scheme: str | None = None) -> Float[np.ndarray, "nodes 8"]:
    """States from integrating the controls from the first state.

    Args:
        trajectory: T intervals.
        scheme: "trapezoidal" integrates the rates by the trapezoidal rule; anything else integrates exactly.
    """
    steps, controls = np.diff(trajectory.times)[:, None], trajectory.controls
    if len(controls) == len(steps):
        changes, moved = steps * controls, steps**2 / 2 * controls
    else:
        here, there = controls[:-1], controls[1:]
        changes = steps * (here + there) / 2
        moved = steps**2 * ((here + there) / 4 if scheme == "trapezoidal" else (2 * here + there) / 6)
    zero = np.zeros((1, POSE_SIZE))
    rates = trajectory.states[0, POSE_SIZE:] + np.concatenate([zero, np.cumsum(changes, axis=0)])
    moves = steps * rates[:-1] + moved
    poses = trajectory.states[0, :POSE_SIZE] + np.concatenate([zero, np.cumsum(moves, axis=0)])
    return np.concatenate([poses, rates], axis=1)


def dense_poses(trajectory: Trajectory, points: int = DENSE, scheme: str | None = None) -> Float[np.ndarray, "n 4"]:
    """Poses at every node and `points` times inside each interval, n = T (points + 1) + 1 [m, rad].

    Trapezoidal collocation takes the pose for a parabola between nodes; the others for the integral of the controls.
    """
    steps = np.diff(trajectory.times)[:, None, None]
    share = (np.arange(points + 1) / (points + 1))[None, :, None]
    t = steps * share
    pose, rate = trajectory.states[:-1, None, :POSE_SIZE], trajectory.states[:-1, None, POSE_SIZE:]
    if len(trajectory.controls) == len(steps):
        inside = pose + t * rate + t**2 / 2 * trajectory.controls[:, None, :]
    elif scheme == "trapezoidal":
        inside = pose + t * rate + t * share / 2 * (trajectory.states[1:, None, POSE_SIZE:] - rate)
    else:
        here, there = trajectory.controls[:-1, None, :], trajectory.controls[1:, None, :]
        inside = pose + t * rate + t**2 / 2 * here + t**2 * share / 6 * (there - here)
    return np.concatenate([inside.reshape(-1, POSE_SIZE), trajectory.states[-1:, :POSE_SIZE]])


def dense_rates(trajectory: Trajectory, points: int = DENSE, scheme: str | None = None) -> Float[np.ndarray, "n 4"]:
    """Rates at the times of `dense_poses` [m/s, rad/s]."""
    steps = np.diff(trajectory.times)[:, None, None]
    share = (np.arange(points + 1) / (points + 1))[None, :, None]
    rates, controls = trajectory.states[:, POSE_SIZE:], trajectory.controls
    if len(controls) == len(steps):
        inside = rates[:-1, None] + share * steps * controls[:, None]
    elif scheme == "trapezoidal":
        inside = (1 - share) * rates[:-1, None] + share * rates[1:, None]
    else:
        here, there = controls[:-1, None], controls[1:, None]
        inside = rates[:-1, None] + share * steps * (here + share / 2 * (there - here))
    return np.concatenate([inside.reshape(-1, POSE_SIZE), rates[-1:]])


def least_clearance(scene: Scene, poses: Float[np.ndarray, "n 4"], every: int = DENSE + 1) -> float:
    """Exact least clearance over poses [m]; infinity without obstacles.

    Clearance changes by no more than the torso's points move. So it is measured at one pose of `every`, and then at
    those of the others that may be nearer to an obstacle than the nearest of these.
    """
    if len(scene.obstacle_centers) == 0:
        return float("inf")
    coarse = clearance(scene, poses[::every])
    nearest = float(coarse.min())
    moved = poses - np.repeat(poses[::every], every, axis=0)[: len(poses)]
    radius = np.hypot(*scene.torso_half_size[:2])
    reach = np.sqrt((moved[:, :3] ** 2).sum(1)) + radius * np.abs(moved[:, 3])
    possible = ~(np.repeat(coarse, every)[: len(poses)] - reach > nearest)  # NaN is possible
    possible[::every] = False
    return min(nearest, float(clearance(scene, poses[possible]).min(initial=np.inf)))


def rate_excess(trajectory: Trajectory, settings: ExpertSettings) -> float:
    """By how much a rate exceeds its bound, at or between nodes; for a norm bound in units of that bound.

    A rate that is linear between nodes is largest at a node; a quadratic one also where its acceleration vanishes.
    """
    rates, controls = trajectory.states[:, POSE_SIZE:], trajectory.controls
    if len(controls) == len(rates):
        here, there = controls[:-1], controls[1:]
        turning = here * there < 0
        change = np.where(turning, here - there, 1.0)
        peaks = rates[:-1] + np.diff(trajectory.times)[:, None] * np.where(turning, here**2 / (2 * change), 0.0)
        rates = np.concatenate([rates, peaks])
    velocity = np.array(settings.velocity)
    excess = float((np.abs(rates) - velocity).max())
    if settings.velocity_bound == "planar_norm":
        excess = max(excess, float(np.hypot(*(rates[:, :2] / velocity[:2]).T).max()) - 1.0)
    return excess


def stride_excess(scene: Scene, trajectory: Trajectory, scheme: str) -> float:
    """By how much a horizontal rate exceeds the top speed at its height, at or between nodes [m/s]; minus infinity
    where there is none. The top speed is interpolated, and goes on beyond the heights that are given."""
    heights, speeds = scene.speed_heights, scene.speed_limits
    if len(heights) == 0:
        return -np.inf
    z = dense_poses(trajectory, scheme=scheme)[:, 2]
    allowed = np.interp(z, heights, speeds)
    for end, beyond in (((0, 1), z < heights[0]), ((-2, -1), z > heights[-1])):
        (z0, z1), (v0, v1) = heights[list(end)], speeds[list(end)]
        allowed = np.where(beyond, v0 + (z - z0) * (v1 - v0) / (z1 - z0), allowed)
    return float((np.abs(dense_rates(trajectory, scheme=scheme)[:, :2]).max(1) - allowed).max())


def verify(
    scene: Scene,
    settings: ExpertSettings,
    trajectory: Trajectory,
    start: Float[np.ndarray, "4"],
    initial_velocity: InitialVelocity | None = None,
) -> Residuals:
    """Measure how far a trajectory is from solving the problem.

    Args:
        scene: obstacles, target and bounds of the pose. Full turns of the yaw are nothing where the bounds hold them.
        settings: bounds, margin, end conditions.
        trajectory: T intervals.
        start: pose [m, rad].
        initial_velocity: "rest" or "free"; None takes the settings'.

    Raises:
        BadInput: another word for the initial velocity.
    """
    condition = checked_initial_velocity(initial_velocity or settings.initial_velocity)
    scene = facing(scene, start)
    states, controls = trajectory.states, trajectory.controls
    poses, rates = states[:, :POSE_SIZE], states[:, POSE_SIZE:]
    ends = [poses[0] - start, poses[-1] - scene.target, rates[-1]]
    if condition == "rest":
        ends.append(rates[0])
    if settings.zero_end_controls:
        ends += [controls[0], controls[-1]]
    scheme = settings.transcription
    dense = dense_poses(trajectory, scheme=scheme)
    excess = [
        scene.lower - dense,
        dense - scene.upper,
        np.abs(controls) - np.array(settings.acceleration),
        -np.diff(trajectory.times)[:, None],
    ]
    defect = float(np.abs(integrate(trajectory) - states).max())
    exact = scheme != "trapezoidal"
    nearest = least_clearance(scene, dense)
    return Residuals(
        dynamics_residual=defect if exact else float(np.abs(integrate(trajectory, scheme) - states).max()),
        integration_defect=defect,
        end_residual=float(max(np.abs(end).max() for end in ends)),
        bound_violation=max(
            0.0,
            rate_excess(trajectory, settings),
            stride_excess(scene, trajectory, scheme),
            *(float(e.max()) for e in excess),
        ),
        clearance_violation=max(0.0, settings.clearance_margin - nearest),
        min_clearance=nearest,
    )


def rejection(residuals: Residuals) -> Rejection | None:
    """Why a trajectory with these residuals is not accepted; None when it is. NaN is never accepted."""
    limits: tuple[tuple[RejectionKind, str, float], ...] = (
        ("dynamics", "dynamics_residual", DYNAMICS_TOLERANCE),
        ("ends", "end_residual", END_TOLERANCE),
        ("bounds", "bound_violation", BOUND_TOLERANCE),
        ("clearance", "clearance_violation", CLEARANCE_TOLERANCE),
    )
    for kind, name, limit in limits:
        value: float = getattr(residuals, name)
        if not value <= limit:
            return Rejection(kind, f"{name} {value:.2e} exceeds {limit:.0e}")
    return None
