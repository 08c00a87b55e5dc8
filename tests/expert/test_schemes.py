"""All transcription schemes on the same problems with known answers, and what each leaves between the nodes."""

import numpy as np
import pytest

from agile_jax.expert import ExpertSettings, Trajectory, integrate, make_expert, minimum_time, rejection, verify
from agile_jax.expert.programs.schemes import square_integral, step
from agile_jax.expert.verify import rate_excess
from agile_jax.scene import SceneSettings, make_scene

SCHEMES = ("zoh", "foh", "trapezoidal")


@pytest.fixture(scope="module")
def open_field():
    return make_scene(SceneSettings())


def _analytic(scene, start, settings, condition):
    velocity, acceleration = np.array(settings.velocity), np.array(settings.acceleration)
    return minimum_time(scene.target - start, velocity, acceleration, condition).max()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_steps_against_quadrature(scheme):
    h, pose, rate, u, u_next = 0.3, 0.2, -0.4, 1.1, -0.7
    t = np.linspace(0, h, 200_001)
    control = np.full_like(t, u) if scheme == "zoh" else u + (u_next - u) * t / h
    rates = rate + np.concatenate([[0], np.cumsum((control[1:] + control[:-1]) / 2) * (t[1] - t[0])])
    after, rate_after = step(scheme, pose, rate, h, u, u_next)
    assert rate_after == pytest.approx(rates[-1], abs=1e-9)
    exact = pose + np.trapezoid(rates, t)
    defect = h**2 * (u_next - u) / 12 if scheme == "trapezoidal" else 0.0
    assert after - exact == pytest.approx(defect, abs=1e-9)
    assert square_integral(scheme, h, u, u_next) == pytest.approx(np.trapezoid(control**2, t), abs=1e-8)


@pytest.mark.parametrize("condition", ["rest", "free"])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_free_space(open_field, scheme, condition):
    settings = ExpertSettings(transcription=scheme, method="general")
    expert = make_expert(open_field, settings)
    for start in ([0.0, 0.4, 0.28, 0.0], [2.8, 0.0, 0.28, 0.3], [1.0, -2.5, 0.2, 0.0]):
        solution = expert.solve(start, condition)
        analytic = _analytic(open_field, start, settings, condition)
        assert solution.status == "solved", solution.cause
        assert -1e-4 <= solution.duration / analytic - 1 < 6e-3
        assert solution.dynamics_residual < 1e-6
        if scheme != "trapezoidal":
            assert solution.integration_defect < 1e-6
        assert rate_excess(solution.trajectory, settings) < 1e-6


@pytest.mark.parametrize("scheme", SCHEMES)
def test_under_the_table(scene, under, scheme):
    solution = make_expert(scene, ExpertSettings(transcription=scheme, method="general")).solve([0.0, 0.0, 0.28, 0.0])
    assert solution.status == "solved", solution.cause
    assert solution.branch == "under"
    assert solution.clearance_violation == 0
    assert solution.duration == pytest.approx(under.duration, rel=5e-3)
    assert len(solution.trajectory.controls) == 100 + (scheme != "zoh")


def test_trapezoidal_is_honest_about_its_defect(open_field):
    """Between the same nodes the exact motion under the same linear controls ends elsewhere."""
    defects = {}
    for nodes in (50, 100):
        settings = ExpertSettings(transcription="trapezoidal", method="general", nodes=nodes)
        solution = make_expert(open_field, settings).solve([0.0, 0.4, 0.28, 0.0], "rest")
        trajectory = solution.trajectory
        assert rejection(verify(open_field, settings, trajectory, np.array([0.0, 0.4, 0.28, 0.0]), "rest")) is None
        gap = np.abs(integrate(trajectory) - trajectory.states)
        defects[nodes] = solution.integration_defect
        assert solution.integration_defect == gap.max() > 1e-5
        exact = settings.model_copy(update={"transcription": "foh"})
        assert rejection(verify(open_field, exact, trajectory, trajectory.states[0, :4], "rest")).kind == "dynamics"
    assert defects[100] < defects[50] / 2  # second order


@pytest.mark.parametrize(("scheme", "lost"), [("zoh", 2), ("foh", 1), ("trapezoidal", 1)])
@pytest.mark.parametrize("nodes", [50, 100])
def test_papers_end_controls_cost_what_theory_says(open_field, scheme, lost, nodes):
    """u_0 = u_N = 0 takes one (linear) or two (constant controls) of the N intervals away from the motion.

    Exactly so from rest to rest with full acceleration, coasting and full braking, whose ramps are linear here.
    """
    settings = ExpertSettings(transcription=scheme, zero_end_controls=True, nodes=nodes, effort_weight=1e-4)
    solution = make_expert(open_field, settings).solve([0.0, 0.0, 0.28, 0.0], "rest")
    assert solution.status == "solved", solution.cause
    analytic = solution.lower_bound
    ends = solution.trajectory.controls[[0, -1]]
    assert np.abs(ends).max() < 1e-6
    # Ramp, coast, brake: T = d/V + V/A, and each end loses h (constant) or h / 2 (linear).
    assert solution.duration / analytic == pytest.approx(nodes / (nodes - lost), abs=1.5e-3)


def test_a_rate_that_overshoots_between_nodes_is_caught(open_field):
    settings = ExpertSettings(transcription="foh", velocity=(1.0, 1.0, 1.0, 1.0), acceleration=(9.0, 9.0, 9.0, 9.0))
    times = np.array([0.0, 0.2, 0.4])
    controls = np.zeros((3, 4))
    controls[:, 0] = [4.0, -4.0, -4.0]
    states = np.zeros((3, 8))
    states[0, 4] = states[1, 4] = 1.0
    trajectory = Trajectory(times, states, controls)
    assert rate_excess(trajectory, settings) == pytest.approx(4.0**2 / (2 * 8.0) * 0.2)
