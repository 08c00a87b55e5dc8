"""Problems recorded from a short walk, shared by the tests of the solver."""

import jax
import jax.numpy as jnp
import pytest

from agile_jax.benchmark.workloads.mpc_problems import Problems, record_problems
from agile_jax.control import ControlSettings
from agile_jax.control.mpc.problem import Qp


@pytest.fixture(scope="session")
def recorded() -> Problems:
    return record_problems(ControlSettings(), 40, seed=3, plans=45)


@pytest.fixture(scope="session")
def problems(recorded: Problems) -> Qp:
    """8 calm and 24 hard problems as one batch."""
    return jax.tree.map(lambda calm, hard: jnp.concatenate([calm[:8], hard[:24]]), recorded.calm, recorded.hard)
