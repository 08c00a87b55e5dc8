"""A metric: a number with its unit, its direction, what it means and, where there is one, its target."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, TypeAlias

Better: TypeAlias = Literal["higher", "lower", ""]  # "" where neither is
Result: TypeAlias = dict[str, Any]  # what goes into a benchmark's JSON file, or an object in it


class Metric(NamedTuple):
    """One measured number. None stands for a number that does not exist, such as a median over nothing."""

    key: str
    value: float | None
    unit: str  # "" for counts and ratios
    better: Better
    meaning: str
    target: float | None = None

    @property
    def missed(self) -> bool:
        """Whether there is a target and the number is on its wrong side."""
        if self.target is None or self.value is None:
            return False
        return self.value < self.target if self.better == "higher" else self.value > self.target


def as_json(metrics: Sequence[Metric]) -> dict[str, Result]:
    """By key, for a file."""
    return {metric.key: {k: v for k, v in metric._asdict().items() if k != "key"} for metric in metrics}


def missed(metrics: dict[str, Result]) -> list[str]:
    """A line for each metric of `as_json` that is on the wrong side of its target."""
    return [
        f"missed: {key} is {number(metric['value'])}, its target {number(metric['target'])} ({metric['meaning']})"
        for key, metric in metrics.items()
        if Metric(key, **metric).missed
    ]


def text_of(result: Result, *lines: str) -> str:
    """A result to read: the experiment and the problem, the lines, and what missed its target."""
    problem = ", ".join(f"{key} {value}" for key, value in result["problem"].items())
    return "\n".join([f"{result['experiment']}: {problem}", "", *lines, *missed(result["metrics"])])


def comparison(metrics: dict[str, Result], methods: Sequence[str]) -> str:
    """A table of the metrics "METHOD.KEY", a column for each method and a row for each key."""
    rows = []
    for key in dict.fromkeys(key.partition(".")[2] for key in metrics):
        found = [metrics.get(f"{method}.{key}") for method in methods]
        unit = next(metric["unit"] for metric in found if metric)
        cells = [number(metric["value"]) if metric else "" for metric in found]
        rows.append((f"{key} [{unit}]" if unit else key, cells))
    return table(methods, rows)


def table(columns: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    """Plain text: a line of column names, then rows of a title and as many cells, aligned to the right."""
    left = max(len(title) for title, _ in rows)
    widths = [max(len(name), *(len(cells[i]) for _, cells in rows)) for i, name in enumerate(columns)]
    lines = [("", columns), *rows]
    return "\n".join(
        "  ".join([title.ljust(left), *(cell.rjust(width) for cell, width in zip(cells, widths, strict=True))])
        for title, cells in lines
    )


def number(value: float | None) -> str:
    """Four digits, or a dash."""
    return "-" if value is None else f"{value:.4g}"
