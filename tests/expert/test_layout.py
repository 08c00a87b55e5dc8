"""The order of the general program's variables: what is packed comes back, and each has one place."""

import numpy as np
import pytest

from agile_jax.expert.programs.layout import EDGE_INTERVALS, Layout, Parameters, Phase, Variables

PHASES = (Phase(False, 2), Phase(True, 1), Phase(False, 0))


@pytest.mark.parametrize("linear", [False, True])
def test_packed_variables_come_back(linear):
    layout = Layout(PHASES, 20, linear)
    generator = np.random.default_rng(0)
    variables = Variables(*(generator.normal(size=places.shape) for places in layout.places))
    assert variables.poses.shape == variables.rates.shape == (21, 4)
    assert variables.accelerations.shape == ((21, 4) if linear else (0, 4))
    assert (variables.angles.shape, variables.next_durations.shape) == ((EDGE_INTERVALS,), (2,))
    vector = layout.pack(variables)
    assert sorted(np.concatenate([places.ravel() for places in layout.places])) == list(range(len(vector)))
    for ours, back in zip(variables, layout.unpack(vector), strict=True):
        np.testing.assert_array_equal(ours, back)


def test_stages_follow_one_another():
    """x_0, u_0, x_1, ...: FATROP finds the stages by it. An angle is a control, and so is the next phase's duration."""
    layout = Layout(PHASES, 20, linear=False)
    assert layout.intervals == (9, 3, 8)
    places = layout.places
    for k in range(20):
        assert places.poses[k, 0] < places.rates[k, 0] < places.durations[k] < places.controls[k, 0]
        assert places.controls[k, -1] < places.poses[k + 1, 0]
    np.testing.assert_array_equal(places.angles, places.controls[9:12, -1] + 1)
    np.testing.assert_array_equal(places.next_durations, places.poses[[9, 12], 0] - 1)


def test_parameters_stand_in_the_order_of_their_kinds():
    parameters = Parameters("start", "target", ["a", "b"], ["face"], ["edge"], "lines", "fractions", "weight")
    assert parameters.in_order() == ["start", "target", "a", "b", "face", "edge", "lines", "fractions", "weight"]
