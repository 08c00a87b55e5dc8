"""A second implementation of motion between nodes, for the tests of this folder."""

import numpy as np


def state_at(trajectory, t):
    """States at times t, shape (n, 8), from piecewise-constant controls."""
    k = np.clip(np.searchsorted(trajectory.times, t, side="right") - 1, 0, len(trajectory.controls) - 1)
    dt = (t - trajectory.times[k])[:, None]
    pose, rate, u = trajectory.states[k, :4], trajectory.states[k, 4:], trajectory.controls[k]
    return np.hstack([pose + dt * rate + dt**2 / 2 * u, rate + dt * u])


def largest_difference(one, other):
    """Largest difference of poses [m, rad] and of rates [m/s, rad/s] at 300 times of the shorter of two motions."""
    t = np.linspace(0, min(one.times[-1], other.times[-1]), 300)
    difference = np.abs(state_at(one, t) - state_at(other, t))
    return difference[:, :4].max(), difference[:, 4:].max()
