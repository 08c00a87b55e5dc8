"""The suite runs JAX on the CPU unless told otherwise, and keeps what it compiled for the next run."""

import os
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import pytest
from jaxtyping import install_import_hook

CHECKED = [  # packages whose annotations, shapes too, are checked at every call in these tests
    "agile_jax.report",
    "agile_jax.geometry",
    "agile_jax.scene",
    "agile_jax.policy",
]
install_import_hook(CHECKED, "beartype.beartype")


def pytest_configure(config: pytest.Config) -> None:
    folder = Path(config.rootpath) / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
