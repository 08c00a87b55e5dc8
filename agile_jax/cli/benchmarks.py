"""`agile benchmark SUBJECT`: what each subject takes, and where it is measured."""

import dataclasses
import pathlib
from typing import Any

from agile_jax.cli.arguments import parse_experiment
from agile_jax.progress import Progress
from agile_jax.settings import BadInput

SUBJECTS = {
    "expert": "solve the same starts with the expert and with its peers, in one thread, and print the ratios",
    "training": "the rate of the training's steps, of their matrix products, and of PyTorch, on all cores",
    "mpc": "solve the MPC's problems of walking robots with ours and with general solvers, on one core",
    "policy": "ask the policy and the expert about the same starts, on one core, and print the ratio",
    "tracking": "random commands on flat ground, disturbed and not: velocity and height errors, falls",
    "evaluation": "simulated seconds per second of the closed loop, by backend and batch, and where the time goes",
}
Measured = tuple[pathlib.Path | None, dict[str, Any], str]  # where to write, what, and as a table


@dataclasses.dataclass(frozen=True)
class StartsOptions:
    """A benchmark over starts."""

    starts: int = 100
    """Starts of the experiment's distribution."""
    output: pathlib.Path | None = None
    """Write all numbers there, for example benchmark.json."""


@dataclasses.dataclass(frozen=True)
class MpcOptions:
    """A benchmark of the MPC's solver."""

    problems: int = 1000
    """Problems of each kind, calm and hard."""
    output: pathlib.Path | None = None
    """Write all numbers there, for example mpc.json."""


@dataclasses.dataclass(frozen=True)
class TrainingOptions:
    """A benchmark of the training."""

    steps: int = 4
    """Steps of the optimiser in each repetition."""
    repetitions: int = 20
    """Of each method; the fastest counts."""
    output: pathlib.Path | None = None
    """Write all numbers there, for example benchmark.json."""


@dataclasses.dataclass(frozen=True)
class EvaluationOptions:
    """A benchmark of the evaluation."""

    run_dir: pathlib.Path | None = None
    """Where the trained policy is; runs/NAME if not given."""
    threads: int = 2
    """Of the C physics."""
    output: pathlib.Path | None = None
    """Write all numbers there, for example benchmark.json."""


@dataclasses.dataclass(frozen=True)
class TrackingOptions:
    """How the controller follows commands, and what it survives."""

    episodes: int = 200
    """Random commands of every row."""
    duration: float = 10.0
    """Of a tracking episode [s]."""
    disturbed_duration: float = 5.0
    """Of an episode with a disturbance [s]."""
    output: pathlib.Path | None = None
    """Write all numbers there, for example tracking.json."""


def run_benchmark(argv: list[str], progress: Progress) -> None:
    """Parse, measure, print, and write what was asked for.

    Raises:
        BadInput: no such subject, or a bad option.
    """
    from agile_jax.files import write_json

    subject, *rest = argv or [""]
    if subject in ("-h", "--help"):
        print("usage: agile benchmark SUBJECT [EXPERIMENT.toml] [OPTIONS]\n")
        print("\n".join(f"{name:<12}{does}" for name, does in SUBJECTS.items()))
        return
    if subject not in SUBJECTS:
        raise BadInput(f"which benchmark? There are: {', '.join(SUBJECTS)}{f', not {subject}' if subject else ''}")
    output, result, text = globals()[f"_{subject}"](rest, progress)
    print(text)
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        write_json(output, result)


def _positive(name: str, value: int) -> int:
    if value < 1:
        raise BadInput(f"{name} = {value} must be at least 1")
    return value


def _expert(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.expert import TABLE, benchmark_expert, report

    experiment, options = parse_experiment("benchmark expert", StartsOptions(), argv, TABLE)
    result = benchmark_expert(experiment, _positive("starts", options.starts), progress)
    return options.output, result, report(result)


def _mpc(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.expert import TABLE
    from agile_jax.benchmark.mpc import benchmark_mpc, report_mpc

    experiment, options = parse_experiment("benchmark mpc", MpcOptions(), argv, TABLE)
    result = benchmark_mpc(experiment.control, _positive("problems", options.problems), progress)
    return options.output, result, report_mpc(result)


def _policy(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.expert import TABLE
    from agile_jax.benchmark.policy import benchmark_policy, report_policy

    experiment, options = parse_experiment("benchmark policy", StartsOptions(), argv, TABLE)
    result = benchmark_policy(experiment, _positive("starts", options.starts), progress)
    return options.output, result, report_policy(result)


def _training(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.training import TRAINING_TABLE, benchmark_training, report_training

    experiment, options = parse_experiment("benchmark training", TrainingOptions(), argv, TRAINING_TABLE)
    result = benchmark_training(experiment, options.steps, options.repetitions, progress)
    return options.output, result, report_training(result)


def _evaluation(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.evaluation import benchmark_evaluation, report

    experiment, options = parse_experiment("benchmark evaluation", EvaluationOptions(), argv)
    run_dir = options.run_dir or pathlib.Path("runs") / experiment.name
    result = benchmark_evaluation(experiment, run_dir, _positive("threads", options.threads), progress)
    return options.output, result, report(result)


def _tracking(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.expert import TABLE
    from agile_jax.benchmark.tracking import benchmark_tracking, report

    experiment, options = parse_experiment("benchmark tracking", TrackingOptions(), argv, TABLE)
    if options.episodes < 1 or min(options.duration, options.disturbed_duration) <= 0:
        raise BadInput("episodes and durations must be positive")
    durations = options.duration, options.disturbed_duration
    result = benchmark_tracking(experiment, options.episodes, *durations, progress=progress)
    return options.output, result, report(result)
