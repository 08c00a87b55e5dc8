"""The suite runs JAX on the CPU unless told otherwise, and keeps what it compiled for the next run."""

import os
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import pytest
from jaxtyping import install_import_hook

CHECKED = [  # packages whose annotations, shapes too, are checked at every call in these tests
    "agile_jax.report",
    "agile_jax.control",
    "agile_jax.evaluation",
    "agile_jax.expert",
    "agile_jax.geometry",
    "agile_jax.robot",
    "agile_jax.scene",
    "agile_jax.simulation",
    "agile_jax.policy",
    "agile_jax.dataset",
    "agile_jax.store",
    "agile_jax.pipeline",
    "agile_jax.run_directory",
    "agile_jax.training",
]
install_import_hook(CHECKED, "beartype.beartype")


def pytest_configure(config: pytest.Config) -> None:
    folder = Path(config.rootpath) / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


@pytest.fixture(scope="session")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of a run whose stages are all done, in seconds: its numbers say nothing."""
    import agile_jax as aj

    smoke = Path(__file__).parents[1] / "experiments" / "smoke.toml"
    small = {"dataset.trajectories": 16, "dataset.shard_size": 16, "training.epochs": 5, "report.video": False}
    experiment = aj.load_experiment(smoke, small | {"evaluation.episodes": 2, "evaluation.batch": 1})
    return aj.run(experiment, tmp_path_factory.mktemp("runs") / "quickstart").directory


@pytest.fixture(autouse=True, scope="module")
def _plugins_of_one_file():
    """What the tests of one file register is forgotten with its end: workers of another could not load it."""
    from agile_jax import plugins

    before = dict(plugins._registered)
    yield
    plugins._registered.clear()
    plugins._registered.update(before)
