"""Settings of a study: which number is varied, over which values, and what tells its curves apart."""

from decimal import Decimal
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from agile_jax.settings import Fraction, Settings
from agile_jax.sweep.settings import check_keys, flatten

Number = int | float
MOST_VALUES = 1000


class StudySettings(Settings):
    """One number of the experiment is varied; at each value the same starts are evaluated."""

    vary: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    """Dotted key of the number, for example "scene.obstacles.0.underside"; several keys all get the same value."""
    values: Annotated[tuple[Number, ...], Field(strict=False)] = ()
    """The values; or give `range`."""
    range: Annotated[tuple[Number, Number, Number], Field(strict=False)] | None = None
    """First, last and step of evenly spaced values; the last one is there if a whole number of steps leads to it."""
    curves: dict[str, Annotated[tuple[object, ...], Field(strict=False, min_length=1)]] = Field(default={})
    """Values of other dotted keys: a curve for each combination of them."""
    label: str = ""
    """What the number is called in the figure; its dotted key if not given."""
    unit: str = ""
    """Unit of the number, in the figure and in the names of columns."""
    hold: Fraction = 0.99
    """Success rate from which on a value counts as one at which the robot holds."""

    @field_validator("vary", mode="before")
    @classmethod
    def _one_key(cls, vary: object) -> object:
        return (vary,) if isinstance(vary, str) else vary

    @field_validator("vary", "curves")
    @classmethod
    def _keys_can_vary(cls, keys: tuple[str, ...] | dict[str, object]) -> tuple[str, ...] | dict[str, object]:
        check_keys(keys)
        return keys

    @field_validator("curves", mode="before")
    @classmethod
    def _dotted(cls, curves: object) -> object:
        """An unquoted `evaluation.planner = [...]` is a nested table in TOML; it means the same."""
        return flatten(curves) if isinstance(curves, dict) else curves

    @model_validator(mode="after")
    def _has_values(self) -> "StudySettings":
        if bool(self.values) == (self.range is not None):
            raise ValueError("needs either `values`, not empty, or `range`")
        if self.range is not None:
            first, last, step = self.range
            if step <= 0 or not 0 <= (last - first) / step <= MOST_VALUES:
                raise ValueError(
                    f"range = {list(self.range)}: are first, last and step: the step is above 0, the last value is not "
                    f"below the first, and at most {MOST_VALUES} steps above it"
                )
        if len(set(self.values)) < len(self.values):
            raise ValueError(f"values = {list(self.values)}: one is there twice")
        if both := set(self.vary) & self.curves.keys():
            raise ValueError(f"{', '.join(sorted(both))} cannot be varied along the curves and tell them apart, too")
        return self

    @property
    def numbers(self) -> tuple[Number, ...]:
        """All values, in increasing order."""
        if self.range is None:
            return tuple(sorted(self.values))
        kind = int if all(isinstance(end, int) for end in self.range) else float
        first, last, step = (Decimal(str(end)) for end in self.range)  # 3 * 0.1 is 0.3 there
        count = int((last - first) / step) + 1
        return tuple(kind(first + number * step) for number in range(count))

    @property
    def axis(self) -> str:
        """What the figure's axis is called."""
        name = self.label or ", ".join(self.vary)
        return f"{name} [{self.unit}]" if self.unit else name
