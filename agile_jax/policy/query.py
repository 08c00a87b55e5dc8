"""A policy compiled for callers that hold NumPy arrays and know no JAX."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.policy.field import Policy
from agile_jax.policy.network import PolicyParameters


def make_velocities(policy: Policy, parameters: PolicyParameters | None = None) -> Callable[[np.ndarray], np.ndarray]:
    """The policy's velocity, poses (n, 4) -> (n, 4), compiled once for each n.

    Args:
        policy: the policy.
        parameters: trained ones; random ones when not given, which take as long.
    """
    parameters = policy.init(jax.random.key(0)) if parameters is None else parameters
    compiled = jax.jit(jax.vmap(policy.velocity, (None, 0)))

    def velocities(poses: np.ndarray) -> np.ndarray:
        return np.asarray(compiled(parameters, jnp.asarray(poses, jnp.float32)))

    return velocities
