"""Experiments: the settings of all stages in one file, read, checked as a whole, and told apart by hashes."""

from agile_jax.experiment.experiment import (
    STAGES,
    Experiment,
    experiment_hash,
    json_schema,
    load_experiment,
    to_toml,
    with_overrides,
)

__all__ = [
    "STAGES",
    "Experiment",
    "experiment_hash",
    "json_schema",
    "load_experiment",
    "to_toml",
    "with_overrides",
]
