"""What befalls a training: a full disk, an empty step, kills at any moment. (More in test_resumption.py.)"""

import errno
import json
import os
import pathlib
import random
import resource
import shutil
import signal
import subprocess
import sys
import time

import jax
import pytest
from synthetic import BRIEF, LIMITS, SMALL, fit, smooth_samples, table_scene, train_small
from test_resumption import assert_same_ending, make_policy_of_tests

from agile_jax.policy import make_policy
from agile_jax.settings import BadInput
from agile_jax.training import Samples
from agile_jax.training.checkpoint import restore_checkpoint


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of Orbax, closing its event loop
def test_full_disk_while_saving_is_said_in_one_line_and_training_goes_on_afterwards(uninterrupted, tmp_path):
    """No file may grow beyond a few kB from the second checkpoint on, which fails like a full disk: in the middle of
    a write."""
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def fill(work, done, total, note=""):
        if done == 3:
            resource.setrlimit(resource.RLIMIT_FSIZE, (3000, hard))

    try:
        with pytest.raises(OSError, match="File too large, saving a checkpoint") as caught:
            train_small(tmp_path, fill)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert caught.value.errno == errno.EFBIG
    assert caught.value.filename == str(tmp_path / "checkpoints" / "4")
    assert [path.name for path in (tmp_path / "checkpoints").iterdir()] == ["2"]
    policy, _ = train_small(tmp_path)
    assert_same_ending(tmp_path, uninterrupted, policy)


def test_empty_step_and_rests_of_a_killed_save_are_cleared_away(uninterrupted, tmp_path, capsys):
    shutil.copytree(uninterrupted, tmp_path / "copy")
    folder = tmp_path / "copy" / "checkpoints"
    shutil.rmtree(folder / "8")
    (folder / "8").mkdir()
    (folder / "7.orbax-checkpoint-tmp" / "state").mkdir(parents=True)
    policy, _ = train_small(tmp_path / "copy")
    assert "8: has no integrity.json" in capsys.readouterr().out
    assert {path.name for path in folder.iterdir()} == {"6", "8", "8.damaged"}
    assert_same_ending(tmp_path / "copy", uninterrupted, policy)


def test_nothing_sound_is_left(uninterrupted, tmp_path, capsys):
    shutil.copytree(uninterrupted, tmp_path / "copy")
    for step in (tmp_path / "copy" / "checkpoints").iterdir():
        next(path for path in (step / "policy").rglob("*") if path.is_file()).write_bytes(b"")
    parameters = make_policy_of_tests().init(jax.random.key(0))
    assert restore_checkpoint(tmp_path / "copy" / "checkpoints", parameters) is None
    assert capsys.readouterr().out.count("damaged file policy/") == 2


def test_validation_error_that_is_not_finite_stops_with_the_step(tmp_path):
    """Training may still look well when the held-out samples overflow."""
    policy = make_policy(table_scene(), LIMITS, SMALL.model_copy(update={"kind": "plain"}))
    poses, velocities = smooth_samples(100, 1)
    with pytest.raises(BadInput, match=r"validation error after step 8 \(epoch 1\) is not finite; lower"):
        fit(policy, smooth_samples(500), Samples(poses, velocities + 1e30), BRIEF, 0, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(8))
def test_killed_at_any_moment(number, uninterrupted, tmp_path):
    generator = random.Random(number)
    script = pathlib.Path(__file__).with_name("synthetic.py")
    for _ in range(3):
        process = subprocess.Popen(
            [sys.executable, script, tmp_path], stdout=subprocess.PIPE, text=True, env=dict(os.environ)
        )
        process.stdout.readline()
        time.sleep(generator.uniform(0, 3))
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
    policy, _ = train_small(tmp_path)
    assert_same_ending(tmp_path, uninterrupted, policy)
    rows = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert len(rows) == BRIEF.epochs
