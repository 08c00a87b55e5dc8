"""What a run says of itself at its end."""

import pathlib

import pytest

from agile_jax.cli.results import print_wrapped, result_lines
from agile_jax.pipeline import StageResult

SUMMARIES = {
    "dataset": {"trajectories": 400, "labels_per_second": 123.456, "optimality_gap_median": 1.25e-5},
    "training": {"validation_mse": 1.2345e-3, "noise_floor_mse": 1e-3, "epochs": 150, "seconds": 41.7},
    "evaluation": {
        "episodes": 64,
        "success_rate": 1.0,
        "success_rate_low": 0.94338,
        "success_rate_high": 1.0,
        "arrival_time_ratio_median": 0.9,
        "arrival_time_ratio_same_tolerance_median": 1.0049,
    },
    "report": {},
}
PATHS = {"report": "report.html"}


def results(*stages: str) -> dict[str, StageResult]:
    run_dir = pathlib.Path("runs/quickstart")
    return {
        name: StageResult(name, name == "dataset", run_dir / PATHS.get(name, f"{name}/summary.json"), SUMMARIES[name])
        for name in stages
    }


def test_a_run_ends_with_a_sentence() -> None:
    lines = result_lines(results("dataset", "training", "evaluation", "report"))
    assert (
        lines[0] == "dataset     reused  400 trajectories at 123 a second, 0.0013 % above the lower bound in the median"
    )
    assert lines[1] == "training    made    validation error 0.00123 (noise floor 0.001) after 150 epochs in 41.7 s"
    assert lines[-1] == (
        "64 of 64 starts succeed (95 %: 94.3 to 100 %), arriving in 1.005 of the expert's time; "
        "open runs/quickstart/report.html"
    )


def test_a_stage_alone_ends_with_where_it_is() -> None:
    lines = result_lines(results("dataset"))
    assert len(lines) == 2
    assert lines[-1] == "See runs/quickstart/dataset/summary.json"


def test_lines_wrap_between_words_on_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    line = result_lines(results("dataset", "training", "evaluation", "report"))[-1]
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    print_wrapped(line)
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 40
    assert printed.split() == line.split()
