"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .experiment import (
    STAGES as STAGES,
    Experiment as Experiment,
    experiment_hash as experiment_hash,
    json_schema as json_schema,
    load_experiment as load_experiment,
    to_toml as to_toml,
    with_overrides as with_overrides,
)
