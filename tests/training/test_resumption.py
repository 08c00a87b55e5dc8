import os
import pathlib
import shutil
import signal
import subprocess
import sys

import jax
import numpy as np
import pytest
from synthetic import BRIEF, LIMITS, SMALL, fit, smooth_samples, train_small

from agile_jax.policy import make_policy
from agile_jax.settings import BadInput
from agile_jax.training import FitProblem, Keeping, fit_policy
from agile_jax.training.checkpoint import load_parameters, restore_checkpoint
from agile_jax.training.optimizer import make_optimizer


def final(directory, policy, settings=BRIEF):
    """The last checkpoint: parameters and optimiser states by seed, and the policy."""
    parameters = policy.init(jax.random.key(0))
    state = {"parameters": parameters, "optimizer": make_optimizer(settings, 64).init(parameters.network)}
    if settings.select == "best":
        state["kept"] = parameters
    by_seed = jax.tree.map(lambda leaf: jax.numpy.stack([leaf] * settings.seeds), state)
    return restore_checkpoint(directory / "checkpoints", parameters, by_seed)


def assert_same_ending(directory, uninterrupted, policy, settings=BRIEF):
    ours, theirs = final(directory, policy, settings), final(uninterrupted, policy, settings)
    assert ours.step == theirs.step
    for a, b in zip(jax.tree.leaves(ours[1:3]), jax.tree.leaves(theirs[1:3]), strict=True):
        assert np.array_equal(a, b)
    assert (directory / "metrics.jsonl").read_bytes() == (uninterrupted / "metrics.jsonl").read_bytes()


def test_killed_training_ends_with_the_same_bits(uninterrupted, tmp_path):
    """SIGKILL after epoch 5: checkpoints are at 2 and 4, so epoch 5 is done again and its row written again."""
    script = pathlib.Path(__file__).with_name("synthetic.py")
    process = subprocess.Popen(
        [sys.executable, script, tmp_path], stdout=subprocess.PIPE, text=True, env=dict(os.environ)
    )
    for line in process.stdout:
        if int(line) >= 5:
            process.send_signal(signal.SIGKILL)
            break
    assert process.wait(60) == -signal.SIGKILL
    process.stdout.close()
    with open(tmp_path / "metrics.jsonl", "a") as file:
        file.write('{"epoch": 6, "lear')  # a torn line
    policy, _ = train_small(tmp_path)
    assert_same_ending(tmp_path, uninterrupted, policy)


@pytest.mark.parametrize(
    "fault", ["flipped bit", "truncated", "deleted", "no integrity.json", "garbled integrity.json"]
)
def test_damaged_checkpoint_is_set_aside_and_the_one_before_used(fault, uninterrupted, tmp_path, capsys):
    shutil.copytree(uninterrupted, tmp_path / "copy")
    directory = tmp_path / "copy"
    step = directory / "checkpoints" / "8"
    array = max((step / "state").rglob("*"), key=lambda path: path.stat().st_size if path.is_file() else 0)
    data = bytearray(array.read_bytes())
    if fault == "flipped bit":
        data[len(data) // 2] ^= 1
        array.write_bytes(data)
    elif fault == "truncated":
        array.write_bytes(data[: len(data) // 2])
    elif fault == "deleted":
        array.unlink()
    elif fault == "no integrity.json":
        (step / "integrity.json").unlink()
    else:
        (step / "integrity.json").write_bytes((step / "integrity.json").read_bytes()[:-40])
    policy, _ = train_small(directory)
    said = capsys.readouterr().out
    assert said.count("\n") == 1
    assert "set aside" in said
    assert str(step) in said
    assert (directory / "checkpoints" / "8.damaged").is_dir()
    assert_same_ending(directory, uninterrupted, policy)


def test_without_a_sound_checkpoint_training_begins_anew_and_loading_is_refused(uninterrupted, tmp_path, capsys):
    shutil.copytree(uninterrupted, tmp_path / "copy")
    directory = tmp_path / "copy"
    for file in directory.glob("checkpoints/*/integrity.json"):
        file.write_text("{}")
    policy = make_policy_of_tests()
    with pytest.raises(BadInput, match=r"checkpoints/8: integrity\.json is damaged .*`agile train"):
        load_parameters(directory, policy)
    assert {path.name for path in (directory / "checkpoints").iterdir()} == {"6", "8"}  # a reader changes nothing
    train_small(directory)
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert_same_ending(directory, uninterrupted, policy)


@pytest.mark.parametrize("fault", ["flipped bit", "deleted", "another one"])
def test_a_finished_training_is_read_as_it_ended_or_not_at_all(fault, uninterrupted, tmp_path):
    """The step before, though sound, is another policy."""
    directory, policy = tmp_path / "copy", make_policy_of_tests()
    shutil.copytree(uninterrupted, directory)
    step = directory / "checkpoints" / "8"
    if fault == "flipped bit":
        array = max((step / "policy").rglob("*"), key=lambda path: path.stat().st_size if path.is_file() else 0)
        data = bytearray(array.read_bytes())
        data[len(data) // 2] ^= 1
        array.write_bytes(data)
    else:
        shutil.rmtree(step)
    if fault == "another one":
        fit(policy, smooth_samples(500), smooth_samples(100, 1), BRIEF, 4, tmp_path / "other")
        shutil.copytree(tmp_path / "other" / "checkpoints" / "8", step)
    with pytest.raises(BadInput, match=r"checkpoints/8: .*; `agile train .*` goes on from the last sound checkpoint"):
        load_parameters(directory, policy)
    if fault == "another one":
        shutil.rmtree(step)
    train_small(directory)
    assert_same_ending(directory, uninterrupted, policy)
    for a, b in zip(*(jax.tree.leaves(load_parameters(d, policy)) for d in (directory, uninterrupted)), strict=True):
        assert np.array_equal(a, b)


def test_a_training_that_was_killed_is_not_read(uninterrupted, tmp_path):
    directory = tmp_path / "copy"
    shutil.copytree(uninterrupted, directory)
    (directory / "finished.json").unlink()
    with pytest.raises(BadInput, match=r"the training is not finished; `agile train"):
        load_parameters(directory, make_policy_of_tests())


def test_fewer_epochs_than_there_are_is_refused(tmp_path):
    policy, samples = make_policy_of_tests(), (smooth_samples(500), smooth_samples(100, 1))
    keeping = Keeping(tmp_path, {"data": "synthetic"})
    fit_policy(FitProblem(policy, *samples, BRIEF.model_copy(update={"epochs": 4}), 3), keeping)
    with pytest.raises(BadInput, match=r"holds 4 epochs, more than training\.epochs = 2"):
        fit_policy(FitProblem(policy, *samples, BRIEF.model_copy(update={"epochs": 2}), 3), keeping)


def make_policy_of_tests():
    from synthetic import table_scene

    return make_policy(table_scene(), LIMITS, SMALL)


def test_checkpoint_of_other_settings_is_refused_with_the_difference(uninterrupted):
    policy = make_policy_of_tests()
    labels = smooth_samples(500), smooth_samples(100, 1)
    faster = BRIEF.model_copy(update={"learning_rate": 0.02})
    with pytest.raises(BadInput, match=r"training\.learning_rate: 0\.01 there, 0\.02 asked for"):
        fit(policy, *labels, faster, 3, uninterrupted)
    with pytest.raises(BadInput, match="data: 'synthetic' there, 'other' asked for"):
        fit(policy, *labels, BRIEF, 3, uninterrupted, data="other")
    with pytest.raises(BadInput, match="seed: 3 there, 4 asked for"):
        fit(policy, *labels, BRIEF, 4, uninterrupted)


def test_checkpoint_of_another_network_is_refused(uninterrupted):
    from synthetic import table_scene

    wider = make_policy(table_scene(), LIMITS, SMALL.model_copy(update={"hidden_layers": (16, 17)}))
    with pytest.raises(BadInput, match="another network"):
        load_parameters(uninterrupted, wider)


def test_only_the_last_checkpoints_are_kept_each_with_its_integrity(uninterrupted):
    steps = sorted(path.name for path in (uninterrupted / "checkpoints").iterdir())
    assert steps == ["6", "8"]
    assert len(list(uninterrupted.glob("checkpoints/**/integrity.json"))) == 2
