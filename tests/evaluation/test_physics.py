"""Which physics an evaluation runs in, and how it steps."""

import pathlib
from functools import partial

import numpy as np
import pytest
from near import near

from agile_jax.engine import open_engine
from agile_jax.evaluation.stage import evaluate

INLINE = partial(open_engine, "inline")


def columns(experiment, folder: pathlib.Path) -> dict[str, np.ndarray]:
    assert evaluate(experiment, folder, INLINE)["success_rate"] == 1.0
    with np.load(folder / "evaluation" / f"{experiment.evaluation.backend}.npz") as file:
        return dict(file)


@pytest.fixture(scope="module")
def usual(tmp_path_factory) -> dict[str, np.ndarray]:
    return columns(near(episodes=2), tmp_path_factory.mktemp("usual"))


@pytest.mark.parametrize(
    "settings",
    [{"physics": {"substeps": 2, "integrator": "implicit", "cone": "elliptic"}}, {"backend": "pybullet"}],
    ids=lambda settings: settings.get("backend", "finer steps"),
)
def test_another_physics_arrives_alike(settings: dict, usual: dict[str, np.ndarray], tmp_path: pathlib.Path):
    """The same walk: not equal, but near."""
    if settings.get("backend") == "pybullet":
        pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install 'agile_jax[pybullet]'")
    found = columns(near(episodes=2, **settings), tmp_path)
    assert np.abs(found["arrival_time"] - usual["arrival_time"]).max() < 0.1
    assert not np.array_equal(found["work"], usual["work"])
    np.testing.assert_allclose(found["work"], usual["work"], rtol=0.3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"backend": "mjx", "physics": {"substeps": 2}}, 'leave it out, or use "mujoco" or "pybullet"'),
        ({"backend": "pybullet", "physics": {"integrator": "rk4"}}, "physics.integrator = 'rk4' has no effect with"),
        ({"backend": "mjx", "physics": {"cone": "elliptic"}}, 'no effect with backend = "mjx"; leave it out, or use'),
        ({"physics": {"rotor_reaction": False}}, 'no effect with backend = "mujoco"; leave it out, or use "pybullet"'),
        ({"backend": "mjx", "planner": "open_loop"}, 'use "mujoco" or "pybullet"'),
        ({"physics": {"substeps": 0}}, "greater than or equal to 1"),
    ],
)
def test_physics_that_a_backend_has_not_is_refused(settings: dict, message: str):
    with pytest.raises(ValueError, match=message):
        near(**settings)
