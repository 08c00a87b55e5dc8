"""What the benchmark of the MPC asks of a solver."""

from collections.abc import Callable
from typing import NamedTuple

from jaxtyping import Float
from numpy import ndarray

from agile_jax.benchmark.peers.dense_qp import DenseQp

Solve = Callable[[], Float[ndarray, " n"] | None]  # the forces [N], or None if the solver says that it failed


class Peer(NamedTuple):
    """A solver."""

    about: str
    pyramid: bool  # whether it solves the pyramid instead of the cone
    prepare: Callable[[DenseQp], Solve]  # not timed: condensed matrices to what is timed, set-up and solution
