"""What a run says of itself at its end: a line for each stage, then one sentence with the result."""

import shutil
import sys
import textwrap
from collections.abc import Mapping

from agile_jax.pipeline import StageResult

Summary = Mapping[str, object]


def result_lines(results: Mapping[str, StageResult]) -> list[str]:
    """The lines that are printed after the stages."""
    lines = [
        f"{name:<12}{'reused' if one.reused else 'made':<8}{_ABOUT[name](one.summary)}" for name, one in results.items()
    ]
    last, done = list(results.values())[-1], results.get("evaluation")
    where = f"{'open' if last.stage == 'report' else 'see'} {last.path}"
    return [*lines, f"{success(done.summary)}; {where}" if done else f"{where[:1].upper()}{where[1:]}"]


def print_wrapped(line: str) -> None:
    """Print a line, on a terminal broken between words only."""
    if not sys.stdout.isatty():
        print(line)
        return
    width = shutil.get_terminal_size().columns
    print(textwrap.fill(line, width, break_long_words=False, break_on_hyphens=False, subsequent_indent="    "))


def success(summary: Summary) -> str:
    """How many episodes of an evaluation succeeded, with the 95 % interval, and how quickly."""
    episodes, rate = _number(summary, "episodes"), _number(summary, "success_rate")
    low, high = 100 * _number(summary, "success_rate_low"), 100 * _number(summary, "success_rate_high")
    text = f"{rate * episodes:.0f} of {episodes:.0f} starts succeed (95 %: {low:.3g} to {high:.3g} %)"
    ratio = summary.get("arrival_time_ratio_same_tolerance_median")
    return text + (f", arriving in {ratio:.3f} of the expert's time" if isinstance(ratio, float) else "")


def number(value: object) -> str:
    """A value to read: floats with four digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _dataset(summary: Summary) -> str:
    rate, gap = summary.get("labels_per_second"), summary.get("optimality_gap_median")
    text = f"{summary.get('trajectories')} trajectories"
    text += f" at {rate:.3g} a second" if isinstance(rate, float) else ""
    return text + (f", {100 * gap:.2g} % above the lower bound in the median" if isinstance(gap, float) else "")


def _training(summary: Summary) -> str:
    floor, seconds = summary.get("noise_floor_mse"), _number(summary, "seconds")
    text = f"validation error {_number(summary, 'validation_mse'):.3g}"
    text += f" (noise floor {floor:.3g})" if isinstance(floor, float) else ""
    return f"{text} after {summary.get('epochs')} epochs in {seconds:.3g} s"


def _report(summary: Summary) -> str:
    del summary
    return "figures, video and page"


def _number(summary: Summary, key: str) -> float:
    value = summary.get(key)
    return float(value) if isinstance(value, int | float) else float("nan")


_ABOUT = {"dataset": _dataset, "training": _training, "evaluation": success, "report": _report}
