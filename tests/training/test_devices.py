"""Data-parallel training on four devices, which XLA makes of the processor, and resumption on another number."""

import contextlib
import json
import os
import pathlib
import socket
import subprocess
import sys

import jax
import numpy as np
import pytest
from synthetic import BRIEF, LIMITS, SMALL, fit, smooth_samples, table_scene, train_small

from agile_jax.policy import make_policy
from agile_jax.settings import BadInput
from agile_jax.training.checkpoint import load_parameters

HALFWAY = 4


def train_on_four(directory: pathlib.Path) -> str:
    """Train in a process that sees four devices; its output."""
    environment = dict(os.environ) | {"XLA_FLAGS": "--xla_force_host_platform_device_count=4", "JAX_PLATFORMS": "cpu"}
    script = [sys.executable, pathlib.Path(__file__), directory]
    process = subprocess.run(script, env=environment, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    return process.stdout


def parameters_in(directory):
    policy = make_policy(table_scene(), LIMITS, SMALL)
    return jax.tree.leaves(load_parameters(directory, policy))


def assert_close(directory, other):
    for a, b in zip(parameters_in(directory), parameters_in(other), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    ours, theirs = ((path / "metrics.jsonl").read_text().splitlines() for path in (directory, other))
    for a, b in zip(ours, theirs, strict=True):
        assert json.loads(a) == pytest.approx(json.loads(b), rel=1e-4)


class StopError(Exception):
    pass


def stop_halfway(work, done, total, note=""):
    if done == HALFWAY + 1:
        raise StopError


def test_four_devices_give_the_result_of_one_and_take_up_each_others_checkpoints(uninterrupted, tmp_path):
    whole, to_one, to_four = tmp_path / "whole", tmp_path / "to one", tmp_path / "to four"
    with pytest.raises(StopError):
        train_small(to_four, stop_halfway)
    (tmp_path / "to four" / "metrics.jsonl").unlink()
    done = json.loads(train_on_four(tmp_path))
    assert done == {"devices": 4, "split": True}
    assert_close(whole, uninterrupted)
    assert_close(to_four, uninterrupted)

    assert {path.name for path in (to_one / "checkpoints").iterdir()} == {"2", "4"}
    train_small(to_one)
    assert_close(to_one, uninterrupted)


@pytest.mark.slow
def test_two_processes_give_the_result_of_one(uninterrupted, tmp_path):
    """As on two hosts with a shared folder (docs/cluster.md), by jax.distributed over the loopback interface."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    environment = dict(os.environ) | {"JAX_PLATFORMS": "cpu"}
    environment.pop("XLA_FLAGS", None)
    command = [sys.executable, str(pathlib.Path(__file__)), str(tmp_path), address]
    processes = [subprocess.Popen([*command, str(number)], env=environment) for number in range(2)]
    try:
        assert [process.wait(300) for process in processes] == [0, 0]
    finally:
        for process in processes:
            process.kill()
    for a, b in zip(parameters_in(tmp_path), parameters_in(uninterrupted), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)


def train_on_two_hosts(directory: pathlib.Path, address: str, number: int) -> None:
    jax.distributed.initialize(address, 2, number)
    policy = make_policy(table_scene(), LIMITS, SMALL)
    two = BRIEF.model_copy(update={"devices": 2})
    fit(policy, smooth_samples(500), smooth_samples(100, 1), two, 3, directory)


def test_too_few_devices_are_refused(tmp_path):
    policy = make_policy(table_scene(), LIMITS, SMALL)
    settings = BRIEF.model_copy(update={"devices": 64})
    with pytest.raises(BadInput, match=r"training\.devices = 64, but JAX finds \d"):
        fit(policy, smooth_samples(500), smooth_samples(100, 1), settings, 0, tmp_path)


if __name__ == "__main__" and len(sys.argv) > 2:
    train_on_two_hosts(pathlib.Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]))
elif __name__ == "__main__":  # in the process with four devices
    four = BRIEF.model_copy(update={"devices": 4})
    policy = make_policy(table_scene(), LIMITS, SMALL)
    labels = smooth_samples(500), smooth_samples(100, 1)
    root = pathlib.Path(sys.argv[1])
    fitted = fit(policy, *labels, four, 3, root / "whole")
    fit(policy, *labels, four, 3, root / "to four")
    with contextlib.suppress(StopError):
        fit(policy, *labels, four, 3, root / "to one", stop_halfway)
    from agile_jax.training.epochs import compile_training
    from agile_jax.training.fit import FitProblem, prepare
    from agile_jax.training.samples import SI

    prepared = prepare(FitProblem(policy, *labels, four, 3))
    compiled = compile_training(policy, four, prepared.state, prepared.training, prepared.validation, prepared.keys, SI)
    text = compiled._epoch.as_text()
    # Each device multiplies its 16 of the 64 rows of a batch, and the gradients are added up.
    split = "f32[16,16]" in text and "all-reduce" in text and "f32[64,16]" not in text
    print(json.dumps({"devices": len(fitted.by_seed.normalization.mean.devices()), "split": split}))
