"""Robots shared by four devices, which XLA makes of the processor, against the same robots on one."""

import os
import pathlib
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_episodes import STARTS, parts, standing

from agile_jax.simulation import MjxSlots, Rollout, gather, mjx_init, mjx_loop, stream

BRIEF = np.array([0.3, 0.2, 0.2, 0.25])  # [s]


def run(devices: int) -> Rollout:
    loop, _, model = parts()
    slots = MjxSlots(mjx_loop(loop, mjx_init(model), devices), 4, jnp.float32(1.0))
    return gather(6, stream(slots, standing(STARTS[[0, 1, 2, 3, 0, 2]]), BRIEF[[0, 1, 2, 3, 2, 0]]))


@pytest.mark.slow  # it compiles the loop twice
def test_four_devices_give_what_one_gives(tmp_path: pathlib.Path):
    environment = dict(os.environ) | {"XLA_FLAGS": "--xla_force_host_platform_device_count=4", "JAX_PLATFORMS": "cpu"}
    process = subprocess.run(
        [sys.executable, __file__, tmp_path / "four.npz"], env=environment, capture_output=True, text=True
    )
    assert process.returncode == 0, process.stderr
    with np.load(tmp_path / "four.npz") as four:
        assert four["devices"] == 4
        np.testing.assert_array_equal(four["status"], four["status_of_one"])
        np.testing.assert_allclose(four["error"], four["error_of_one"], atol=1e-6)
        np.testing.assert_allclose(four["work"], four["work_of_one"], rtol=1e-5)


if __name__ == "__main__":
    four, one = run(4), run(1)
    np.savez(
        sys.argv[1],
        devices=len(jax.devices()),
        status=four.outcome.status,
        status_of_one=one.outcome.status,
        error=four.outcome.planar_error,
        error_of_one=one.outcome.planar_error,
        work=four.outcome.work,
        work_of_one=one.outcome.work,
    )
