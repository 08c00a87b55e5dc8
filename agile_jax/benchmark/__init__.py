"""Benchmarks against the peers: ratios measured in one process, on the same problems, with their method stated.

`benchmark_expert` compares the expert with the nonlinear programs that a user would write first. CasADi is loaded by
running a benchmark, not by importing this package. `benchmark_training` compares the training with the machine and with
PyTorch.
"""

from agile_jax.benchmark.expert import TABLE, benchmark_expert, report
from agile_jax.benchmark.metrics import Metric
from agile_jax.benchmark.training import TRAINING_TABLE, benchmark_training, report_training

__all__ = [
    "TABLE",
    "TRAINING_TABLE",
    "Metric",
    "benchmark_expert",
    "benchmark_training",
    "report",
    "report_training",
]
