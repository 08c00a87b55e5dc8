"""The numbers by which trials are compared are those that the summaries have."""

import pathlib
import re

import pytest

from agile_jax.sweep.numbers import NUMBERS, number_error

PACKAGE = pathlib.Path(__file__).parents[2] / "agile_jax"


@pytest.mark.parametrize("metric", ["dataset.failed.infeasible", "evaluation.mjx.failures.fall", "training.test_mse"])
def test_numbers_that_summaries_have(metric: str) -> None:
    assert number_error(metric) is None


@pytest.mark.parametrize("metric", ["loss", "training", "evaluation.mujoco", "policy.kind", "training.test_mse.x"])
def test_numbers_that_no_summary_has(metric: str) -> None:
    assert number_error(metric)


@pytest.mark.parametrize("stage", NUMBERS)
def test_every_listed_number_is_written_somewhere(stage: str) -> None:
    from agile_jax.control import Counts

    files = [*PACKAGE.glob("dataset/*.py"), *PACKAGE.glob("training/**/*.py"), *PACKAGE.glob("evaluation/*.py")]
    written = {name for file in files for name in re.findall(r'"([a-z_0-9]+)"', file.read_text())}
    assert set(NUMBERS[stage]) <= written | set(Counts._fields) | {"aggregation_asked", "aggregation_answered"}
