"""The subjects of `agile benchmark SUBJECT`: what each takes, and how it is measured. Loads what it measures late."""

import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple

from agile_jax import benchmark
from agile_jax.benchmark.metrics import Result
from agile_jax.experiment import Experiment
from agile_jax.progress import Progress
from agile_jax.settings import Count, Positive, Settings

PAPER = pathlib.Path(__file__).with_name("table.toml")
LARGE_NETWORK = pathlib.Path(__file__).with_name("training.toml")


class Options(Settings):
    """What every benchmark takes."""

    output: pathlib.Path | None = None
    """Write all numbers there, for example benchmark.json."""


class StartsOptions(Options):
    """A benchmark over starts."""

    starts: Count = 100
    """Starts of the experiment's distribution."""


class MpcOptions(Options):
    """A benchmark of the MPC's solver."""

    problems: Count = 1000
    """Problems of each kind, calm and hard."""


class TrainingOptions(Options):
    """A benchmark of the training."""

    steps: Count = 4
    """Steps of the optimiser in each repetition."""
    repetitions: Count = 20
    """Repetitions of each method."""


class EvaluationOptions(Options):
    """A benchmark of the evaluation."""

    run_dir: pathlib.Path | None = None
    """Where the trained policy is; runs/NAME if not given."""
    threads: Count = 2
    """Threads of the C physics."""


class TrackingOptions(Options):
    """How the controller follows commands, and what it survives."""

    episodes: Count = 200
    """Random commands in every row of the table."""
    duration: Positive = 10.0
    """Length of a tracking episode [s]."""
    disturbed_duration: Positive = 5.0
    """Length of an episode with a disturbance [s]."""


class Subject(NamedTuple):
    """What can be measured. The module of its name has `report`, the result as text."""

    about: str
    options: type[Options]
    experiment: pathlib.Path | None  # that is measured when none is given
    measure: Callable[[Experiment, Any, Progress], Result]  # with its options


SUBJECTS = {
    "expert": Subject(
        "solve the same starts with the expert and with its peers, in one thread, and print the ratios",
        StartsOptions,
        PAPER,
        lambda experiment, given, progress: benchmark.expert.benchmark_expert(experiment, given.starts, progress),
    ),
    "training": Subject(
        "the rate of the training's steps, of their matrix products, and of PyTorch, on all cores",
        TrainingOptions,
        LARGE_NETWORK,
        lambda experiment, given, progress: benchmark.training.benchmark_training(
            experiment, given.steps, given.repetitions, progress
        ),
    ),
    "mpc": Subject(
        "solve the MPC's problems of walking robots with ours and with general solvers, on one core",
        MpcOptions,
        PAPER,
        lambda experiment, given, progress: benchmark.mpc.benchmark_mpc(experiment.control, given.problems, progress),
    ),
    "policy": Subject(
        "ask the policy and the expert about the same starts, on one core, and print the ratio",
        StartsOptions,
        PAPER,
        lambda experiment, given, progress: benchmark.policy.benchmark_policy(experiment, given.starts, progress),
    ),
    "tracking": Subject(
        "random commands on flat ground, disturbed and not: velocity and height errors, falls",
        TrackingOptions,
        PAPER,
        lambda experiment, given, progress: benchmark.tracking.benchmark_tracking(
            experiment, given.episodes, given.duration, given.disturbed_duration, progress=progress
        ),
    ),
    "evaluation": Subject(
        "simulated seconds per second of the closed loop, by backend and batch, and where the time goes",
        EvaluationOptions,
        None,
        lambda experiment, given, progress: benchmark.evaluation.benchmark_evaluation(
            experiment, given.run_dir or pathlib.Path("runs") / experiment.name, given.threads, progress
        ),
    ),
}
