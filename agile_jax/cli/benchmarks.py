"""`agile benchmark SUBJECT`: what each subject takes, and where it is measured."""

import pathlib
from collections.abc import Callable, Mapping

from agile_jax.cli.arguments import parse_experiment
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
    from agile_jax.files import write_json

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
    from agile_jax.benchmark.expert import TABLE, benchmark_expert, report

    experiment, options, _ = parse_experiment("benchmark expert", StartsOptions, argv, TABLE)
    result = benchmark_expert(experiment, options.starts, progress)
    return options.output, result, report(result)


def _mpc(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.expert import TABLE
    from agile_jax.benchmark.mpc import benchmark_mpc, report

    experiment, options, _ = parse_experiment("benchmark mpc", MpcOptions, argv, TABLE)
    result = benchmark_mpc(experiment.control, options.problems, progress)
    return options.output, result, report(result)


def _policy(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.expert import TABLE
    from agile_jax.benchmark.policy import benchmark_policy, report

    experiment, options, _ = parse_experiment("benchmark policy", StartsOptions, argv, TABLE)
    result = benchmark_policy(experiment, options.starts, progress)
    return options.output, result, report(result)


def _training(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.training import TRAINING_TABLE, benchmark_training, report

    experiment, options, _ = parse_experiment("benchmark training", TrainingOptions, argv, TRAINING_TABLE)
    result = benchmark_training(experiment, options.steps, options.repetitions, progress)
    return options.output, result, report(result)


def _evaluation(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.evaluation import benchmark_evaluation, report

    experiment, options, _ = parse_experiment("benchmark evaluation", EvaluationOptions, argv)
    run_dir = options.run_dir or pathlib.Path("runs") / experiment.name
    result = benchmark_evaluation(experiment, run_dir, options.threads, progress)
    return options.output, result, report(result)


def _tracking(argv: list[str], progress: Progress) -> Measured:
    from agile_jax.benchmark.expert import TABLE
    from agile_jax.benchmark.tracking import benchmark_tracking, report

    experiment, options, _ = parse_experiment("benchmark tracking", TrackingOptions, argv, TABLE)
    durations = options.duration, options.disturbed_duration
    result = benchmark_tracking(experiment, options.episodes, *durations, progress=progress)
    return options.output, result, report(result)


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
