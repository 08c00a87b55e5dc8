"""Benchmarks against the peers: ratios measured in one process, on the same problems, with their method stated.

`benchmark_expert` compares the expert with the nonlinear programs that a user would write first, `benchmark_mpc` the
MPC's solver with general ones. CasADi and JAX are loaded by running a benchmark, not by importing this package.
"""

from agile_jax.benchmark.expert import TABLE, benchmark_expert, report
from agile_jax.benchmark.metrics import Metric
from agile_jax.benchmark.mpc import benchmark_mpc, report_mpc

__all__ = ["TABLE", "Metric", "benchmark_expert", "benchmark_mpc", "report", "report_mpc"]
