"""A trained policy for callers that hold NumPy arrays and know no JAX."""

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy
from agile_jax.policy.single_precision import in_single_precision
from agile_jax.scene import POSE_SIZE


@dataclass(frozen=True, eq=False)
class TrainedPolicy:
    """A policy and its parameters, from NumPy arrays to NumPy arrays. Compiled once for each number of poses.

    Attributes:
        policy: what was trained.
        parameters: of it; random ones (`policy.init`) take as long.
    """

    policy: Policy
    parameters: PolicyParameters

    def __call__(self, pose: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
        """The velocity [m/s, rad/s] to which it drives a robot that rests at a pose [x, y, z, yaw] [m, rad]."""
        return self.batch(np.asarray(pose)[None])[0]

    @in_single_precision
    def batch(self, poses: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
        """The same of many poses."""
        return np.asarray(self._velocities(self.parameters, jnp.asarray(poses, jnp.float32)))

    @in_single_precision
    def command(
        self, pose: Float[np.ndarray, "4"], velocity: Float[np.ndarray, "4"], dt: float
    ) -> Float[np.ndarray, "4"]:
        """The velocity [m/s, rad/s] that a robot at a pose [m, rad] with a velocity shall have after `dt` [s]."""
        state = jnp.asarray(pose, jnp.float32), jnp.asarray(velocity, jnp.float32)
        return np.asarray(self._command(self.parameters, *state, jnp.float32(dt)))

    def __repr__(self) -> str:
        """One line."""
        kind, layers = self.policy.settings.kind, list(self.policy.settings.hidden_layers)
        return f"TrainedPolicy({kind}, hidden_layers={layers}, {POSE_SIZE} outputs)"

    @cached_property
    def _velocities(self):  # type: ignore[no-untyped-def]
        return jax.jit(jax.vmap(self.policy.velocity_from_rest, (None, 0)))

    @cached_property
    def _command(self):  # type: ignore[no-untyped-def]
        return jax.jit(self.policy.command)
