"""Settings of a sweep: what is varied, and by which number the trials are compared."""

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from agile_jax.settings import Settings

LATER_METHODS = ("random", "tpe")
METRIC = r"^(dataset|training|evaluation\.[a-z0-9_]+)\.[a-z0-9_.]+$"


class SweepSettings(Settings):
    """A grid over dotted keys of the experiment."""

    method: Literal["grid"] = "grid"
    metric: str = "training.validation_mse"  # its prefix decides up to which stage a trial runs
    direction: Literal["minimize", "maximize"] = "minimize"
    space: dict[str, Annotated[tuple[Any, ...], Field(strict=False, min_length=1)]] = Field(min_length=1)

    @field_validator("method", mode="before")
    @classmethod
    def _method_exists(cls, method: Any) -> Any:
        if method in LATER_METHODS:
            raise ValueError("this method is not available yet; use 'grid'")
        return method

    @field_validator("metric")
    @classmethod
    def _metric_names_a_stage(cls, metric: str) -> str:
        import re

        if not re.match(METRIC, metric):
            raise ValueError(
                "must be a key of a stage's summary, such as 'training.validation_mse' or "
                "'evaluation.mujoco.success_rate'"
            )
        return metric

    @field_validator("space", mode="before")
    @classmethod
    def _dotted(cls, space: Any) -> Any:
        """An unquoted `training.learning_rate = [...]` is a nested table in TOML; it means the same."""
        return _flatten(space) if isinstance(space, dict) else space

    @field_validator("space")
    @classmethod
    def _keys_can_vary(cls, space: dict[str, tuple[Any, ...]]) -> dict[str, tuple[Any, ...]]:
        for key in space:
            if key.split(".")[0] in ("name", "sweep", "extends"):
                raise ValueError(f"{key} names the experiment or the sweep and cannot vary")
        return space


def _flatten(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat.update(_flatten(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value})
    return flat
