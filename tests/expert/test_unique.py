"""Labels are unique: from any guess the same trajectory, within 1 mm and 5 mm/s (1 mrad, 5 mrad/s) at every node."""

import pathlib

import numpy as np
import pytest

from agile_jax.benchmark.subjects import PAPER  # the paper's starts, from rest
from agile_jax.dataset.starts import draw_start
from agile_jax.experiment import load_experiment
from agile_jax.expert import ExpertSettings, make_expert
from agile_jax.scene import make_scene

TABLE = pathlib.Path(__file__).parents[2] / "experiments" / "table.toml"
POSES, RATES = 1e-3, 5e-3
GUESSES = range(1, 5)
# Starts whose program has several local minima: a face crossed from the side, or a turn across the torso's diagonal.
HARD = (
    ([0.9318384, 0.64656204, 0.23506988, 0.0], "rest"),
    ([0.93944705, -0.62036719, 0.27697703, 0.0], "rest"),
    ([0.61522931, -0.22433677, 0.25995538, -0.67528805], "free"),
    ([0.86654424, 0.5714133, 0.30147879, 0.17344465], "free"),
)


def _assert_unique(expert, start, condition, guesses):
    first = expert.solve(start, condition)
    assert first.status == "solved", (start, first.cause)
    for guess in guesses:
        other = expert.solve(start, condition, guess=guess)
        assert other.status == "solved", (start, guess, other.cause)
        difference = np.abs(other.trajectory.states - first.trajectory.states)
        assert difference[:, :4].max() < POSES, (start, guess, difference.max(0))
        assert difference[:, 4:].max() < RATES, (start, guess, difference.max(0))


@pytest.mark.parametrize(("start", "condition"), HARD)
def test_hard_starts(expert, start, condition):
    _assert_unique(expert, np.array(start), condition, (1, 4))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("experiment", "count", "changes"),
    [
        (PAPER, 60, {}),
        (TABLE, 60, {}),
        (PAPER, 20, {"velocity_bound": "planar_norm"}),
        (TABLE, 20, {"velocity_bound": "planar_norm"}),
        (PAPER, 20, {"transcription": "foh"}),
        (PAPER, 20, {"zero_end_controls": True}),
    ],
)
def test_labels_of_the_general_program(experiment, count, changes):
    """The first starts of an experiment whose labels the fast path does not find."""
    experiment = load_experiment(experiment)
    scene, usual = make_scene(experiment.scene), make_expert(make_scene(experiment.scene), experiment.expert)
    settings = ExpertSettings.model_validate(experiment.expert.model_dump() | changes)
    expert = make_expert(scene, settings)
    found = index = 0
    while found < count:
        start = draw_start(
            scene, experiment.scene, experiment.expert, experiment.dataset, experiment.seed, index
        ).poses[0]
        index += 1
        if usual.solve(start).method != "certified":
            found += 1
            _assert_unique(expert, start, settings.initial_velocity, GUESSES)
