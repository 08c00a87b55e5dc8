"""Settings of a sweep: what is varied, and by which number the trials are compared."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Literal, TypeVar

from pydantic import Field, field_validator, model_validator

from agile_jax.settings import Settings
from agile_jax.sweep.numbers import number_error

Points = TypeVar("Points", dict[str, tuple[object, ...]], tuple[dict[str, object], ...])


class SweepSettings(Settings):
    """A grid over dotted keys of the experiment, or a list of points, each with the keys that it changes."""

    method: Literal["grid", "list"] = "grid"
    """grid: every combination of `space`. list: the points of `points`."""
    metric: str = "training.validation_mse"
    """Number of a stage's summary by which trials are compared; its prefix decides up to which stage a trial runs."""
    direction: Literal["minimize", "maximize"] = "minimize"
    """Which metric is better: the least or the greatest."""
    show: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Further numbers of the same stages that the table shows."""
    space: dict[str, Annotated[tuple[object, ...], Field(strict=False, min_length=1)]] = Field(default={})
    """Values of a grid by dotted key."""
    points: Annotated[tuple[dict[str, object], ...], Field(strict=False)] = ()
    """Points of a list, each with the dotted keys that it changes; an empty one changes nothing."""

    @model_validator(mode="after")
    def _has_the_points_of_its_method(self) -> "SweepSettings":
        wanted, other = ("space", "points") if self.method == "grid" else ("points", "space")
        if not getattr(self, wanted) or getattr(self, other):
            raise ValueError(f'method = "{self.method}" needs sweep.{wanted}, not empty, and no sweep.{other}')
        return self

    @field_validator("metric", "show")
    @classmethod
    def _numbers_exist(cls, value: str | tuple[str, ...]) -> str | tuple[str, ...]:
        for metric in (value,) if isinstance(value, str) else value:
            if error := number_error(metric):
                raise ValueError(error)
        return value

    @field_validator("space", mode="before")
    @classmethod
    def _dotted(cls, space: object) -> object:
        """An unquoted `training.learning_rate = [...]` is a nested table in TOML; it means the same."""
        return flatten(space) if isinstance(space, dict) else space

    @field_validator("points", mode="before")
    @classmethod
    def _points_dotted(cls, points: object) -> object:
        if not isinstance(points, list | tuple):
            return points
        return tuple(flatten(point) if isinstance(point, dict) else point for point in points)

    @field_validator("space", "points")
    @classmethod
    def _keys_can_vary(cls, value: Points) -> Points:
        check_keys(value if isinstance(value, dict) else [key for point in value for key in point])
        return value


def check_keys(keys: Iterable[str]) -> None:
    """Raise ValueError for dotted keys that do not say what an experiment is."""
    for key in keys:
        if key.split(".")[0] in ("name", "sweep", "study", "extends"):
            raise ValueError(f"{key} names the experiment or what varies it, and cannot vary")


def flatten(table: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """A nested table as values by dotted key."""
    flat: dict[str, object] = {}
    for key, value in table.items():
        flat.update(flatten(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value})
    return flat
