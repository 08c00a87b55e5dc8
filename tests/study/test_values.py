"""The values of a study as experiments, what is refused of them, and their numbers as rows and figures."""

import csv
import io
import json
import pathlib

import numpy as np
import pytest

from agile_jax.evaluation import wilson_interval
from agile_jax.experiment import Experiment, load_experiment, with_overrides
from agile_jax.files import write_json
from agile_jax.report.figures.study_figures import draw_arrival, draw_clearance, draw_success, study_figure
from agile_jax.report.figures.style import new_axes
from agile_jax.settings import BadInput
from agile_jax.study import StudySettings, list_values, make_rows, run_study, sentences
from agile_jax.study.rows import longest_stretch, to_csv, to_curves

BASE = pathlib.Path(__file__).parents[2] / "experiments" / "base.toml"
UNDERSIDE = "scene.obstacles.0.underside"


def study(vary: str | list[str] = UNDERSIDE, **settings: object) -> Experiment:
    values = {"evaluation.planner": "open_loop", "study": {"vary": vary} | settings}
    return with_overrides(load_experiment(BASE), values, "test")


def test_spaced_values_are_the_decimal_numbers_that_are_written() -> None:
    spaced = StudySettings(vary=("x",), range=(0.19, 0.32, 0.005)).numbers
    assert len(spaced) == 27
    assert [f"{value!r}" for value in spaced[:4]] == ["0.19", "0.195", "0.2", "0.205"]
    assert spaced[-1] == 0.32
    assert StudySettings(vary=("x",), range=(0, 5, 2)).numbers == (0, 2, 4)
    assert all(isinstance(value, int) for value in StudySettings(vary=("x",), range=(0, 5, 2)).numbers)
    assert StudySettings(vary=("x",), values=(3, 1, 2)).numbers == (1, 2, 3)


def test_each_value_is_an_experiment_of_its_own(tmp_path: pathlib.Path) -> None:
    experiment = study(values=[0.25, 0.2], curves={"seed": [3, 4]})
    trials = list_values(experiment, tmp_path)
    assert [(t.experiment.seed, t.experiment.scene.obstacles[0].underside) for t in trials] == [
        (3, 0.2), (3, 0.25), (4, 0.2), (4, 0.25)
    ]  # fmt: skip
    assert len({trial.run_dir for trial in trials}) == 4
    assert {trial.stages for trial in trials} == {("evaluation",)}
    assert all(trial.experiment.study is None and trial.status == "new" for trial in trials)
    (learned,) = list_values(with_overrides(study(values=[0.25]), {"evaluation.planner": "policy"}, "test"), tmp_path)
    assert learned.stages == ("dataset", "training", "evaluation")
    assert list(tmp_path.iterdir()) == []


def test_several_keys_get_the_same_value(tmp_path: pathlib.Path) -> None:
    (trial,) = list_values(study(["plant.joint_damping", "plant.joint_friction"], values=[0.5]), tmp_path)
    assert (trial.experiment.plant.joint_damping, trial.experiment.plant.joint_friction) == (0.5, 0.5)


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        ({"vary": "scene.obstacles.1.underside", "values": [0.2]}, "scene.obstacles.1.underside: `1` is no index"),
        ({"vary": "scene.obstacle.0.underside", "values": [0.2]}, "scene.obstacle: unknown key; did you mean"),
        ({"values": [-1.0]}, "study: scene.obstacles.0.underside = -1.0: input should be greater than 0"),
        ({"values": [0.8]}, "top = 0.75 must be above underside = 0.8"),
        ({"vary": "evaluation.planner", "values": [0.2]}, "study: evaluation.planner = 0.2: input should be"),
        ({"vary": "control.mpc_horizon.x", "values": [1]}, "control.mpc_horizon"),
        ({"values": []}, "needs either `values`, not empty, or `range`"),
        ({"values": [0.2], "range": [0.1, 0.2, 0.1]}, "needs either `values`, not empty, or `range`"),
        ({"values": [0.2, 0.2]}, "one is there twice"),
        ({"values": ["low"]}, "study.values.0"),
        ({"range": [0.3, 0.2, 0.1]}, "range = [0.3, 0.2, 0.1]: are first, last and step"),
        ({"range": [0.2, 0.3, 0.0]}, "the step is above 0"),
        ({"range": [0.0, 1.0, 1e-9]}, "at most 1000 steps"),
        ({"vary": "name", "values": [1]}, "name names the experiment"),
        ({"values": [0.2], "curves": {UNDERSIDE: [0.2]}}, "cannot be varied along the curves"),
        ({"values": [0.2], "curves": {"evaluation.planner": ["opne_loop"]}}, "did you mean 'open_loop'?"),
    ],
)  # fmt: skip
def test_what_cannot_be_varied_is_refused(settings: dict, part: str, tmp_path: pathlib.Path) -> None:
    with pytest.raises(BadInput) as caught:
        list_values(study(**settings), tmp_path)
    assert part in str(caught.value)


def test_all_bad_values_are_named_at_once(tmp_path: pathlib.Path) -> None:
    with pytest.raises(BadInput) as caught:
        list_values(study(values=[-1.0, 0.25, 0.9]), tmp_path)
    assert len(str(caught.value).splitlines()) == 2
    with pytest.raises(BadInput, match=r"no \[study\] table"):
        list_values(Experiment(name="none"), tmp_path)


def counts(successes: int, others: int) -> dict[str, int]:
    return {"success": successes, "collision": others, "fall": 0, "timeout": 0, "unstable": 0}


def write_summary(run_dir: pathlib.Path, under: tuple[int, int], left: tuple[int, int], clearance: float) -> None:
    """An evaluation's summary: successes and collisions of the starts that go under and of those that go left."""
    successes, episodes = under[0] + left[0], sum(under) + sum(left)
    low, high = wilson_interval(successes, episodes)
    regions = {f"route {name}": counts(*one) for name, one in {"under": under, "left": left}.items() if sum(one)}
    summary = {
        "episodes": episodes,
        "success_rate": successes / episodes,
        "success_rate_low": low,
        "success_rate_high": high,
        "failures": {"collision": episodes - successes},
        "outcomes_by_region": regions | {"nearer than 0.3 m": counts(successes, 0)},
        "min_clearance_m_p05": clearance,
        "min_clearance_m_quantiles": [clearance, 2 * clearance, 3 * clearance],
        "arrival_time_ratio_same_tolerance_median": 1.01,
        "arrival_time_ratio_same_tolerance_p95": 1.04,
        "velocity_tracking_rmse": 0.05,
    }
    write_json(run_dir / "evaluation/mujoco.json", summary)


def known_rows(folder: pathlib.Path) -> tuple[StudySettings, list[dict[str, object]]]:
    """Rows of four values, the last of which has failed."""
    experiment = study(values=[0.19, 0.2, 0.25, 0.3], label="underside", unit="m")
    trials = list_values(experiment, folder)
    write_summary(trials[0].run_dir, (0, 0), (8, 0), 0.02)
    write_summary(trials[1].run_dir, (2, 4), (2, 0), -0.01)
    write_summary(trials[2].run_dir, (7, 1), (0, 0), 0.007)
    done = [trial._replace(status="done") for trial in trials[:3]]
    assert experiment.study is not None
    return experiment.study, make_rows(experiment.study, [*done, trials[3]._replace(status="failed", cause="no luck")])


def test_rows_tell_which_starts_go_under_and_which_round(tmp_path: pathlib.Path) -> None:
    _, rows = known_rows(tmp_path)
    assert [row["value_m"] for row in rows] == [0.19, 0.2, 0.25, 0.3]
    assert [row["starts_under"] for row in rows] == [0, 6, 8, None]
    assert [row["successes_under"] for row in rows] == [0, 2, 7, None]
    assert [row["starts_left"] for row in rows] == [8, 2, 0, None]
    assert [row["failures_collision"] for row in rows] == [0, 4, 1, None]
    assert rows[1]["min_clearance_m_median"] == -0.02
    assert (rows[3]["status"], rows[3]["cause"], rows[3]["success_rate"]) == ("failed", "no luck", None)
    read = list(csv.DictReader(io.StringIO(to_csv(rows).decode())))
    assert [{name: "" if value is None else str(value) for name, value in row.items()} for row in rows] == read


def test_the_figure_shows_the_numbers_of_the_rows(tmp_path: pathlib.Path) -> None:
    settings, rows = known_rows(tmp_path)
    curves = to_curves(settings, rows)
    done = rows[:3]
    ax = draw_success(new_axes(), curves)
    success, under = ax.lines
    np.testing.assert_array_equal(success.get_xdata(), [row["value_m"] for row in done])
    np.testing.assert_array_equal(success.get_ydata(), [row["success_rate"] for row in done])
    np.testing.assert_array_equal(under.get_ydata(), [0, 6 / 8, 1])
    band = {tuple(corner) for corner in ax.collections[0].get_paths()[0].vertices}
    for row in done:
        assert {(row["value_m"], row["success_rate_low"]), (row["value_m"], row["success_rate_high"])} <= band
    low, median, _ = draw_clearance(new_axes(), curves).lines
    np.testing.assert_allclose(low.get_ydata(), [1e3 * row["min_clearance_m_p05"] for row in done])
    np.testing.assert_allclose(median.get_ydata(), [1e3 * row["min_clearance_m_median"] for row in done])
    middle, late, _ = draw_arrival(new_axes(), curves).lines
    assert (set(middle.get_ydata()), set(late.get_ydata())) == ({1.01}, {1.04})
    figure = study_figure(curves, settings.axis)
    assert [panel.get_xlabel() for panel in figure.axes] == ["", "", "underside [m]"]
    nowhere = {"": {name: np.full(3, np.nan) if "clearance" in name else column for name, column in curves[""].items()}}
    assert len(study_figure(nowhere, settings.axis).axes) == 2


def test_a_value_that_fails_is_a_row_with_its_cause(tmp_path: pathlib.Path) -> None:
    """Its process really starts, and ends before any work."""
    (row,) = run_study(study(values=[0.25]), tmp_path, engine="pigeon")
    assert (row["status"], row["success_rate"]) == ("failed", None)
    assert 'engine address "pigeon" is none of' in str(row["cause"])
    assert json.loads((tmp_path / "study.json").read_bytes())["rows"] == [row]
    assert not (tmp_path / "study.png").exists()
    (trial,) = list_values(load_experiment(tmp_path / "experiment.toml"), tmp_path)
    assert (trial.status, trial.cause) == ("failed", row["cause"])


def test_words_say_where_it_holds_and_where_it_breaks(tmp_path: pathlib.Path) -> None:
    settings, rows = known_rows(tmp_path)
    (words,) = sentences(settings, rows)
    assert words == (
        "3 of 4 values are evaluated. From 0.19 m to 0.19 m at least 99 % of the starts succeed. At 0.2 m 50 % do."
    )
    assert longest_stretch([True, False, True, True, False]) == (2, 3)
    assert longest_stretch([True, False, True]) == (2, 2)
    assert longest_stretch([False]) is None
