"""What the benchmark of the MPC asks of a solver."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from agile_jax.benchmark.peers.dense_qp import DenseQp


class Peer(NamedTuple):
    """A solver."""

    about: str
    pyramid: bool  # whether it solves the pyramid instead of the cone
    prepare: Callable[[DenseQp], Any]  # not timed
    solve: Callable[[Any], np.ndarray | None]  # (n,), or None if it says that it failed
