"""`agile benchmark SUBJECT`: what each subject takes, and where it is measured."""

import pathlib
from collections.abc import Callable, Mapping

from agile_jax import benchmark
from agile_jax.cli.arguments import parse_experiment
from agile_jax.files import write_json
from agile_jax.progress import Progress
from agile_jax.settings import BadInput, Count, Positive, Settings

Measured = tuple[pathlib.Path | None, Mapping[str, object], str]  # where to write, what, and as a table


class Output(Settings):
    """What every benchmark takes."""

    output: pathlib.Path | None = None
    """Write all numbers there, for example benchmark.json."""


class StartsOptions(Output):
    """A benchmark over starts."""

    starts: Count = 100
    """Starts of the experiment's distribution."""


class MpcOptions(Output):
    """A benchmark of the MPC's solver."""

    problems: Count = 1000
    """Problems of each kind, calm and hard."""


class TrainingOptions(Output):
    """A benchmark of the training."""

    steps: Count = 4
    """Steps of the optimiser in each repetition."""
    repetitions: Count = 20
    """Repetitions of each method."""


class EvaluationOptions(Output):
    """A benchmark of the evaluation."""

    run_dir: pathlib.Path | None = None
    """Where the trained policy is; runs/NAME if not given."""
    threads: Count = 2
    """Threads of the C physics."""


class TrackingOptions(Output):
    """How the controller follows commands, and what it survives."""

    episodes: Count = 200
    """Random commands in every row of the table."""
    duration: Positive = 10.0
    """Length of a tracking episode [s]."""
    disturbed_duration: Positive = 5.0
    """Length of an episode with a disturbance [s]."""


def run_benchmark(argv: list[str], progress: Progress) -> None:
    """Parse, measure, print, and write what was asked for.

    Raises:
        BadInput: no such subject, or a bad option.
    """
    subject, *rest = argv or [""]
    if subject in ("-h", "--help"):
        print("usage: agile benchmark SUBJECT [EXPERIMENT.toml] [OPTIONS]\n")
        print("\n".join(f"{name:<12}{does}" for name, (does, _) in SUBJECTS.items()))
        return
    if subject not in SUBJECTS:
        raise BadInput(f"which benchmark? There are: {', '.join(SUBJECTS)}{f', not {subject}' if subject else ''}")
    output, result, text = SUBJECTS[subject][1](rest, progress)
    print(text)
    if output is not None:
        output.parent.mkdir(parents=True, exist_ok=True)
        write_json(output, result)


def _expert(argv: list[str], progress: Progress) -> Measured:
    experiment, options, _ = parse_experiment("benchmark expert", StartsOptions, argv, benchmark.expert.TABLE)
    result = benchmark.expert.benchmark_expert(experiment, options.starts, progress)
    return options.output, result, benchmark.expert.report(result)


def _mpc(argv: list[str], progress: Progress) -> Measured:
    experiment, options, _ = parse_experiment("benchmark mpc", MpcOptions, argv, benchmark.expert.TABLE)
    result = benchmark.mpc.benchmark_mpc(experiment.control, options.problems, progress)
    return options.output, result, benchmark.mpc.report(result)


def _policy(argv: list[str], progress: Progress) -> Measured:
    experiment, options, _ = parse_experiment("benchmark policy", StartsOptions, argv, benchmark.expert.TABLE)
    result = benchmark.policy.benchmark_policy(experiment, options.starts, progress)
    return options.output, result, benchmark.policy.report(result)


def _training(argv: list[str], progress: Progress) -> Measured:
    experiment, options, _ = parse_experiment(
        "benchmark training", TrainingOptions, argv, benchmark.training.TRAINING_TABLE
    )
    result = benchmark.training.benchmark_training(experiment, options.steps, options.repetitions, progress)
    return options.output, result, benchmark.training.report(result)


def _evaluation(argv: list[str], progress: Progress) -> Measured:
    experiment, options, _ = parse_experiment("benchmark evaluation", EvaluationOptions, argv)
    run_dir = options.run_dir or pathlib.Path("runs") / experiment.name
    result = benchmark.evaluation.benchmark_evaluation(experiment, run_dir, options.threads, progress)
    return options.output, result, benchmark.evaluation.report(result)


def _tracking(argv: list[str], progress: Progress) -> Measured:
    experiment, options, _ = parse_experiment("benchmark tracking", TrackingOptions, argv, benchmark.expert.TABLE)
    durations = options.duration, options.disturbed_duration
    result = benchmark.tracking.benchmark_tracking(experiment, options.episodes, *durations, progress=progress)
    return options.output, result, benchmark.tracking.report(result)


SUBJECTS: dict[str, tuple[str, Callable[[list[str], Progress], Measured]]] = {
    "expert": (
        "solve the same starts with the expert and with its peers, in one thread, and print the ratios",
        _expert,
    ),
    "training": ("the rate of the training's steps, of their matrix products, and of PyTorch, on all cores", _training),
    "mpc": ("solve the MPC's problems of walking robots with ours and with general solvers, on one core", _mpc),
    "policy": ("ask the policy and the expert about the same starts, on one core, and print the ratio", _policy),
    "tracking": ("random commands on flat ground, disturbed and not: velocity and height errors, falls", _tracking),
    "evaluation": (
        "simulated seconds per second of the closed loop, by backend and batch, and where the time goes",
        _evaluation,
    ),
}
