"""The points of a grid: identity, validation, metric."""

import pathlib

import pytest

from agile_jax.experiment import Experiment, experiment_hash, with_overrides
from agile_jax.files import write_json
from agile_jax.settings import BadInput
from agile_jax.sweep.settings import SweepSettings
from agile_jax.sweep.trials import Number, Trial, best, make_trials, read_number, table

SPACE = {"training.learning_rate": [0.1, 0.2], "seed": [0, 1, 2]}


def sweep(space: dict | None = None, **settings: object) -> Experiment:
    return with_overrides(Experiment(name="s"), {"sweep": {"space": space or SPACE, **settings}}, "test")


def test_the_grid_is_the_product() -> None:
    trials = make_trials(sweep(), pathlib.Path("runs/s"))
    points = [(trial.values["training.learning_rate"], trial.values["seed"]) for trial in trials]
    assert points == [(0.1, 0), (0.1, 1), (0.1, 2), (0.2, 0), (0.2, 1), (0.2, 2)]
    for trial in trials:
        assert trial.experiment.training.learning_rate == trial.values["training.learning_rate"]
        assert trial.experiment.sweep is None
        assert trial.hash == experiment_hash(trial.experiment)
        assert trial.run_dir == pathlib.Path("runs/s/trials") / trial.hash[:12]


def test_identity_is_what_a_trial_is_and_not_where_it_stands() -> None:
    few = {trial.hash for trial in make_trials(sweep({"seed": [1, 2]}), pathlib.Path())}
    many = {trial.hash for trial in make_trials(sweep({"seed": [3, 2, 1]}, metric="training.test_mse"), pathlib.Path())}
    assert few < many
    # 0 is the default: a point equal to the base experiment is the base experiment
    assert make_trials(sweep({"seed": [0]}), pathlib.Path())[0].hash == experiment_hash(Experiment(name="other"))
    assert len(make_trials(sweep({"seed": [1, 1]}), pathlib.Path())) == 1


def listed(points: list[dict], **settings: object) -> Experiment:
    values = {"sweep": {"method": "list", "points": points, **settings}}
    return with_overrides(Experiment(name="s"), values, "test")


def test_a_list_has_its_points_in_order_each_with_its_own_keys(tmp_path: pathlib.Path) -> None:
    points = [{}, {"seed": 3}, {"training": {"learning_rate": 0.5}, "seed": 4}, {}]
    experiment = listed(points, show=["training.noise_floor_mse", "training.seconds"])
    trials = make_trials(experiment, tmp_path)
    assert [trial.values for trial in trials] == [{}, {"seed": 3}, {"training.learning_rate": 0.5, "seed": 4}]
    assert trials[0].hash == experiment_hash(Experiment(name="other"))
    assert trials[2].experiment.training.learning_rate == 0.5
    write_json(trials[1].run_dir / "training/summary.json", {"noise_floor_mse": None, "seconds": 7.5})
    settings = experiment.sweep
    assert settings is not None
    done = trials[1]._replace(
        status="done", metric=0.25, shown=tuple(read_number(key, trials[1].run_dir).value for key in settings.show)
    )
    assert done.shown == (None, 7.5)
    lines = table(experiment, [trials[0], done]).splitlines()
    assert "training.noise_floor_mse  training.seconds" in lines[0]
    assert "nothing changed" in lines[1]
    assert lines[2].split() == ["*", done.hash[:12], "seed", "=", "3", "0.25", "7.5", "done"]


def test_a_method_has_points_of_its_own_kind() -> None:
    with pytest.raises(BadInput, match=r"needs sweep\.points"):
        listed([])
    with pytest.raises(BadInput, match=r"needs sweep\.space, not empty, and no sweep\.points"):
        sweep(points=[{"seed": 1}])
    with pytest.raises(BadInput, match="name names the experiment"):
        listed([{"name": "x"}])
    with pytest.raises(BadInput, match=r"sweep\.points: training\.epochs = 0"):
        make_trials(listed([{"training.epochs": 0}]), pathlib.Path())
    with pytest.raises(BadInput, match="must be a number of a stage's summary"):
        listed([{}], show=["validation_mse"])


def test_all_bad_points_are_named_at_once() -> None:
    with pytest.raises(BadInput) as caught:
        make_trials(sweep({"training.learning_rate": [0.1, -1.0], "expert.nods": [10], "seed": [-1]}), pathlib.Path())
    text = str(caught.value)
    assert "sweep.space: training.learning_rate = -1.0" in text
    assert "expert.nods: unknown key; did you mean expert.nodes?" in text
    assert "seed = -1" in text
    assert len(text.splitlines()) == 3


def test_a_nested_table_means_the_dotted_key() -> None:
    nested = SweepSettings.model_validate({"space": {"training": {"learning_rate": [1.0]}}})
    assert nested.space == {"training.learning_rate": (1.0,)}


def test_a_trial_runs_as_far_as_its_metric_needs() -> None:
    for metric, stages in (
        ("dataset.trajectories", ("dataset",)),
        ("training.validation_mse", ("dataset", "training")),
        ("evaluation.mujoco.success_rate", ("dataset", "training", "evaluation")),
    ):
        (trial,) = make_trials(sweep({"seed": [1]}, metric=metric), pathlib.Path())
        assert trial.stages == stages


def test_only_a_policy_needs_labels_and_a_training_to_be_evaluated() -> None:
    space = {"evaluation.planner": ["policy", "open_loop"]}
    policy, path = make_trials(sweep(space, metric="evaluation.mujoco.success_rate"), pathlib.Path())
    assert (policy.stages, path.stages) == (("dataset", "training", "evaluation"), ("evaluation",))
    shown = sweep(space, metric="evaluation.mujoco.success_rate", show=["dataset.trajectories"])
    assert make_trials(shown, pathlib.Path())[1].stages == ("dataset", "evaluation")


def test_metrics_are_finite_numbers_or_a_reason(tmp_path: pathlib.Path) -> None:
    write_json(tmp_path / "evaluation/mujoco.json", {"success_rate": 0.5, "failures": {"fall": 2}, "nothing": None})

    def read(key: str) -> Number:
        return read_number(key, tmp_path)

    assert read("evaluation.mujoco.success_rate") == Number(0.5, "")
    assert read("evaluation.mujoco.failures.fall").value == 2.0
    assert "which cannot be compared" in read("evaluation.mujoco.nothing").cause
    assert "it has failures, nothing, success_rate" in read("evaluation.mujoco.succes_rate").cause
    assert "has no seconds" in read("training.seconds").cause


def test_the_best_and_the_table() -> None:
    experiment = sweep({"seed": [1, 2, 3]})
    trials = make_trials(experiment, pathlib.Path())
    values: list[Trial] = [
        trials[0]._replace(status="done", metric=2.0),
        trials[1]._replace(status="done", metric=1.0),
        trials[2]._replace(status="failed", cause="no luck"),
    ]
    assert experiment.sweep is not None
    assert best(experiment.sweep, values) == values[1]
    upwards = experiment.sweep.model_copy(update={"direction": "maximize"})
    assert best(upwards, values) == values[0]
    assert best(upwards, trials) is None
    lines = table(experiment, values).splitlines()
    assert [line[0] for line in lines] == [" ", " ", "*", " "]
    assert "failed: no luck" in lines[3]


def test_a_trial_has_a_name_of_its_own_for_going_on_from_it() -> None:
    long = sweep({"seed": [1, 2]}).model_copy(update={"name": "n" * 64})
    trials = make_trials(long, pathlib.Path("swept"))
    for trial in trials:
        assert trial.experiment.name.endswith(trial.hash[:12])
        assert Experiment.model_validate(trial.experiment.model_dump()).name == trial.experiment.name
        assert experiment_hash(trial.experiment) == trial.hash
    assert len({trial.experiment.name for trial in trials} | {long.name}) == 3
