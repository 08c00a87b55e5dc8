"""The independent check catches what a solver may get wrong."""

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, Trajectory, integrate, rejection, verify
from agile_jax.expert.verify import dense_poses

PAPER_START = np.array([0.0, 0.0, 0.28, 0.0])


def straight(poses, duration):
    """Constant velocity through evenly spaced poses: exact dynamics between equal steps."""
    poses = np.asarray(poses, float)
    times = np.linspace(0, duration, len(poses))
    rates = np.gradient(poses, times, axis=0)
    return Trajectory(times, np.hstack([poses, rates]), np.zeros((len(poses) - 1, 4)))


def test_accepts_the_experts_solution(under, scene, settings):
    residuals = verify(scene, settings, under.trajectory, PAPER_START)
    assert rejection(residuals) is None
    assert residuals.clearance_violation == 0
    assert residuals.min_clearance >= settings.clearance_margin


def test_integration_matches_a_fine_euler_scheme(under):
    trajectory = under.trajectory
    state, error = trajectory.states[0].copy(), 0.0
    exact = integrate(trajectory)
    for k, u in enumerate(trajectory.controls):
        h = (trajectory.times[k + 1] - trajectory.times[k]) / 2000
        for _ in range(2000):
            state[:4] += h * (state[4:] + h * u / 2)
            state[4:] += h * u
        error = max(error, np.abs(state - exact[k + 1]).max())
    assert error < 1e-9


def test_catches_a_path_that_cuts_through_the_table_between_two_nodes(scene, settings):
    """Both nodes are clear of the table; only the interval between them is not."""
    trajectory = straight([[0.5, 0, 0.28, 0], [2.5, 0, 0.28, 0]], 10.0)
    ends = trajectory.states[:, :4]
    from agile_jax.scene import clearance

    assert (clearance(scene, ends) > settings.clearance_margin).all()
    residuals = verify(scene, settings, trajectory, ends[0])
    assert residuals.min_clearance < 0
    assert residuals.clearance_violation > settings.clearance_margin
    assert dense_poses(trajectory).shape[0] >= 11


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda t: t._replace(states=t.states + np.eye(101, 8, k=-50) * 1e-4), "dynamics_residual"),
        (lambda t: t._replace(controls=t.controls * 1.001), "dynamics_residual"),
        (lambda t: t._replace(times=t.times * 0.999), "dynamics_residual"),
        (lambda t: t._replace(states=t.states + np.array([1e-3] + [0] * 7)), "end_residual"),
        (lambda t: t._replace(states=t.states + np.array([0, 0, -0.05] + [0] * 5)), "bound_violation"),
        (lambda t: t._replace(states=t.states + np.array([0, 0, 0.02] + [0] * 5)), "clearance_violation"),
        (lambda t: t._replace(times=-t.times), "bound_violation"),
    ],
)
def test_catches_wrong_trajectories(under, scene, settings, change, field):
    good = verify(scene, settings, under.trajectory, PAPER_START)
    bad = verify(scene, settings, change(under.trajectory), PAPER_START)
    assert getattr(bad, field) > max(1e-5, 10 * getattr(good, field))
    found = rejection(bad)
    assert found is not None
    assert f"{field} {getattr(bad, field):.2e} exceeds" in found.text or found.kind in ("dynamics", "ends")


def test_catches_violated_bounds_and_end_conditions(under, scene, settings):
    slow = ExpertSettings(velocity=(0.9, 0.5, 0.3, 1.0))
    assert verify(scene, slow, under.trajectory, PAPER_START).bound_violation == pytest.approx(0.1, abs=1e-3)
    weak = ExpertSettings(acceleration=(1.4, 1.5, 1.0, 3.0))
    assert verify(scene, weak, under.trajectory, PAPER_START).bound_violation == pytest.approx(0.1, abs=1e-3)
    moving = straight([PAPER_START, scene.target], 10.0)
    assert verify(scene, settings, moving, PAPER_START, "free").end_residual == pytest.approx(0.3)
    ends = ExpertSettings(zero_end_controls=True)
    assert verify(scene, ends, under.trajectory, PAPER_START).end_residual > 1


def test_nan_is_never_accepted(under, scene, settings):
    states = under.trajectory.states.copy()
    states[50, 2] = np.nan
    assert rejection(verify(scene, settings, under.trajectory._replace(states=states), PAPER_START))
