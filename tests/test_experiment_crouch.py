"""What the legs allow a crouching robot, worked out by an experiment: `scene.crouch`."""

import pathlib

import numpy as np
import pytest

from agile_jax.control.settings import ControlSettings
from agile_jax.control.top_speed import top_speeds
from agile_jax.experiment import Experiment, load_experiment, to_toml
from agile_jax.experiment.crouch import convex_below
from agile_jax.experiment.experiment import with_overrides
from agile_jax.robot.settings import RobotSettings
from agile_jax.scene import make_scene, top_speed
from agile_jax.settings import BadInput
from agile_jax.store.artefact import LABELS, key

SHIPPED = pathlib.Path(__file__).parents[1] / "experiments"


def labels_key(experiment: Experiment) -> str:
    return key(LABELS, experiment.model_dump(mode="json"))


def test_a_file_that_says_nothing_gets_what_the_legs_allow() -> None:
    experiment = Experiment(name="n")
    scene, legs = make_scene(experiment.scene), top_speeds(RobotSettings(), ControlSettings())
    assert experiment.scene.crouch.by == "legs"
    assert 0 <= scene.lower[2] - legs.heights[0] < 1e-3
    assert 0.11 < scene.lower[2] < 0.13  # an A1
    heights = np.linspace(scene.lower[2], scene.upper[2], 200)
    allowed = np.interp(heights, legs.heights, legs.speeds)
    planned = np.minimum(top_speed(scene, heights), max(experiment.expert.velocity[:2]))
    assert (planned <= allowed + 1e-3).all()
    assert (planned >= np.minimum(allowed, 1.0) - 0.05).all()


def test_longer_periods_and_lower_bounds_of_the_velocity_leave_less_to_say() -> None:
    def speeds(overrides: dict[str, object]) -> dict[float, float]:
        crouch = with_overrides(Experiment(name="n"), overrides, "a test").scene.crouch
        return dict(zip(crouch.heights, crouch.speeds, strict=True))

    usual, longer = speeds({}), speeds({"control.gait.shortest_period": 0.25})
    lowest = min(usual)
    assert longer[lowest] == pytest.approx(usual[lowest] * 0.2 / 0.25, abs=2e-3)
    assert max(longer) > max(usual)
    assert max(speeds({"expert.velocity": [0.7, 0.5, 0.3, 1.0]})) < max(usual)
    assert speeds({"expert.velocity": [0.4, 0.3, 0.3, 1.0]}) == {}
    assert speeds({"scene.lower": [-1.5, -3.0, 0.16, -3.2]}) == {}


def test_labels_depend_on_the_gait_only_where_the_legs_are_slower_than_the_bounds() -> None:
    for lower, matters in ((0.16, False), (0.0, True)):
        base = with_overrides(Experiment(name="n"), {"scene.lower": [-1.5, -3.0, lower, -3.2]}, "a test")
        other = with_overrides(base, {"control.gait.shortest_period": 0.201}, "a test")
        assert (labels_key(base) != labels_key(other)) is matters


def test_the_papers_table_is_planned_at_heights_at_which_the_legs_are_fast_enough() -> None:
    experiment = load_experiment(SHIPPED / "table.toml")
    assert experiment.scene.crouch.lowest == 0.155
    assert experiment.scene.crouch.heights == ()


def test_numbers_given_by_hand_stay(tmp_path: pathlib.Path) -> None:
    crouch = {"by": "hand", "lowest": 0.2, "heights": [0.2, 0.3], "speeds": [0.3, 0.6]}
    experiment = Experiment.model_validate({"name": "n", "scene": {"crouch": crouch}})
    assert experiment.scene.crouch.heights == (0.2, 0.3)
    assert make_scene(experiment.scene).lower[2] == 0.2
    for one in (experiment, Experiment(name="n")):
        (tmp_path / "again.toml").write_text(to_toml(one))
        assert load_experiment(tmp_path / "again.toml") == one


def test_no_plan_is_lower_than_the_legs_can_walk(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "low.toml"
    file.write_text('name = "low"\n[scene]\nlower = [-1.5, -3.0, 0.1, -3.2]\n')
    with pytest.raises(BadInput, match=rf"{file}: scene.lower = .* cannot walk below z = 0.1[12]. m"):
        load_experiment(file)
    file.write_text(file.read_text() + '[scene.crouch]\nby = "hand"\n')
    assert make_scene(load_experiment(file).scene).lower[2] == 0.1


def test_the_convex_function_below_points_is_the_largest() -> None:
    generator = np.random.default_rng(0)
    for _ in range(50):
        x, y = np.sort(generator.uniform(0, 1, 12)), np.cumsum(generator.uniform(0.1, 1, 12))
        below = np.array(convex_below(list(zip(x.tolist(), y.tolist(), strict=True))))
        slopes = np.diff(below[:, 1]) / np.diff(below[:, 0])
        assert (np.diff(slopes) > 0).all()
        at = np.interp(x, *below.T)
        assert (at <= y + 1e-12).all()
        # Every convex function below the points is below it at each of them: it lies on a chord between two.
        chords = [y[i] + (y[j] - y[i]) * (x - x[i]) / (x[j] - x[i]) for i in range(12) for j in range(i + 1, 12)]
        within = [(x >= x[i]) & (x <= x[j]) for i in range(12) for j in range(i + 1, 12)]
        lowest = np.where(within, chords, np.inf).min(0)
        np.testing.assert_allclose(at, lowest, atol=1e-12)
