"""JAX's flag for 64 bits changes neither success nor a bit of the results."""

import os
import pathlib
import subprocess
import sys

import jax
import numpy as np
import pytest
from synthetic import ACCELERATION, BRIEF, LIMITS, SMALL, TARGET, fit, smooth_samples, table_scene

from agile_jax.policy import make_policy
from agile_jax.policy.export import exported_module
from agile_jax.training import Samples, make_follower
from agile_jax.training.kinematic_test.follow import Followed


def everything(folder: pathlib.Path) -> dict[str, np.ndarray]:
    """A training of each kind, resumed, and what its policy does: queries, kinematic runs, exported module."""
    found = {}
    for kind in ("residual", "plain", "feedback"):
        policy = make_policy(table_scene(), LIMITS, SMALL.model_copy(update={"kind": kind}))
        samples = [smooth_samples(200), smooth_samples(100, 1)]
        if kind == "feedback":
            samples = [Samples(np.concatenate([s.inputs, 0.1 * s.outputs], -1), s.outputs) for s in samples]
        settings = BRIEF.model_copy(update={"epochs": 2, "checkpoint_every": 1, "select": "best", "seeds": 2})
        fit(policy, *samples, settings, 3, folder / kind)
        fitted = fit(policy, *samples, settings, 3, folder / kind)
        assert {leaf.dtype for leaf in jax.tree.leaves(fitted.by_seed)} == {np.dtype(np.float32)}
        poses = TARGET - np.random.default_rng(0).uniform(0, 1, (20, 4)) * [2.0, 0.3, 0.05, 0.2]
        follower = make_follower(policy, table_scene(), 2.0, 0.02, ACCELERATION)
        followed = follower(fitted.parameters, poses, np.full(20, 2.0))
        module = jax.export.deserialize(bytearray(exported_module(fitted.policy)))
        assert {aval.dtype for aval in module.out_avals} == {np.dtype(np.float32)}
        found |= {f"{kind} {name}": array for name, array in zip(Followed._fields, followed, strict=True)}
        found |= {f"{kind} batch": fitted.policy.batch(poses), f"{kind} one": fitted.policy(poses[0])}
        found[f"{kind} command"] = fitted.policy.command(poses[0], np.full(4, 0.1), 0.02)
        found |= {f"{kind} {i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(fitted.by_seed))}
        found[f"{kind} rows"] = np.array(str(fitted.rows))
    return found


@pytest.mark.parametrize("resumed", [False, True])
def test_the_flag_changes_nothing(tmp_path, resumed):
    """Also where a training of a process without the flag is taken up."""
    environment = dict(os.environ) | {"JAX_ENABLE_X64": "1", "JAX_PLATFORMS": "cpu"}
    expected = everything(tmp_path / "here")
    folder = tmp_path / ("here" if resumed else "there")
    subprocess.run([sys.executable, __file__, folder, tmp_path / "x64.npz"], env=environment, check=True)
    with np.load(tmp_path / "x64.npz") as found:
        assert set(found.files) == set(expected)
        for name in expected:
            np.testing.assert_array_equal(found[name], expected[name], err_msg=name)
            assert found[name].dtype == expected[name].dtype, name


if __name__ == "__main__":
    assert jax.config.jax_enable_x64
    np.savez(sys.argv[2], **everything(pathlib.Path(sys.argv[1])))
