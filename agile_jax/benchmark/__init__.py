"""Benchmarks against the peers: ratios measured in one process, on the same problems, with their method stated.

`benchmark_expert` compares the expert with the nonlinear programs that a user would write first. CasADi is loaded by
running a benchmark, not by importing this package. `benchmark_policy` compares the policy with the expert.
"""

from agile_jax.benchmark.expert import TABLE, benchmark_expert, report
from agile_jax.benchmark.metrics import Metric
from agile_jax.benchmark.policy import benchmark_policy, report_policy

__all__ = ["TABLE", "Metric", "benchmark_expert", "benchmark_policy", "report", "report_policy"]
