"""Benchmarks against the peers: ratios measured in one process, on the same problems, with their method stated.

`benchmark_expert` compares the expert with the nonlinear programs that a user would write first. CasADi is loaded by
running a benchmark, not by importing this package. `benchmark_policy` compares the policy with the expert,
`benchmark_training` the training with the machine and with PyTorch.
"""

from agile_jax.benchmark.expert import TABLE, benchmark_expert, report
from agile_jax.benchmark.metrics import Metric
from agile_jax.benchmark.policy import benchmark_policy, report_policy
from agile_jax.benchmark.training import TRAINING_TABLE, benchmark_training, report_training

__all__ = [
    "TABLE",
    "TRAINING_TABLE",
    "Metric",
    "benchmark_expert",
    "benchmark_policy",
    "benchmark_training",
    "report",
    "report_policy",
    "report_training",
]
