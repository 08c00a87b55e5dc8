"""The optimal feedback law (s, s') -> s'': a policy that knows its own velocity.

From rest to rest the best velocity is no function of the pose alone, but the best acceleration is one of pose and
velocity together:

    u(s, v) = base(s, v) + gain(s) * A * bound(net(features(s), v / V))
    base    = clip((b(s) - v) / blend_time, -A, A)

with b the braking law (braking.py), A and V the bounds, bound(y) = 2 tanh(y / 2) and the gain of the residual field,
which vanishes at the target: there the law is a damped spring whatever the network says. Its labels are the expert's
accelerations from rest.

A tracker gets the velocity a tick later, v + clip(u, -A, A) dt, within the bounds and, with `field_filter`, kept from
obstacles like the field's.
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from agile_jax.arrays import AnyArray
from agile_jax.policy.braking import braking_law, network_gain
from agile_jax.policy.features import features
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Encoding, Learns, Policy, Seconds, in_precision_of
from agile_jax.scene import POSE_SIZE, pose_error

FROM_REST_SECONDS = 1.0  # of the acceleration from rest, in `velocity_from_rest`


class FeedbackLaw(Policy):
    """The acceleration of a state, a pose and its velocity."""

    learns: ClassVar[Learns] = "acceleration"

    @property
    def scale(self) -> Float[np.ndarray, "4"]:
        """The bounds of the acceleration [m/s^2, rad/s^2]."""
        return np.asarray(self.limits.acceleration)

    def encode(self, inputs: Float[AnyArray, "8"]) -> Encoding:
        """Error, walls and velocity, the braking spring and the network's gain of a state [m, rad, m/s, rad/s]."""
        state = jnp.asarray(inputs)
        pose, velocity = state[:POSE_SIZE], state[POSE_SIZE:]
        limits, blend_time = self.limits, self.settings.blend_time
        law = braking_law(pose_error(self.scene, pose, jnp), limits, self.settings.approach_rate)
        base = jnp.clip((law.velocity - velocity) / blend_time, -limits.acceleration, limits.acceleration)
        found = jnp.concatenate([features(self.scene, pose, self.wall_length), velocity / limits.velocity])
        return Encoding(found, base, network_gain(law, blend_time)[None])

    def command(
        self, parameters: PolicyParameters, pose: Float[AnyArray, "4"], velocity: Float[AnyArray, "4"], dt: Seconds
    ) -> Float[Array, "4"]:
        """The velocity [m/s, rad/s] after `dt` [s] of the acceleration at a state, within limits and filter."""
        pose, velocity = in_precision_of(parameters, pose), in_precision_of(parameters, velocity)
        bound = self.limits.acceleration
        wanted = self.output(parameters, self.encode(jnp.concatenate([pose, velocity])))
        after = pose + velocity * dt
        result = self.limited(after, velocity + jnp.clip(wanted, -bound, bound) * dt)
        return self.filtered(after, result) if self.settings.field_filter else result

    def velocity_from_rest(self, parameters: PolicyParameters, pose: Float[AnyArray, "4"]) -> Float[Array, "4"]:
        """The velocity [m/s, rad/s] after a second of the acceleration from rest at the pose [m, rad]."""
        return self.command(parameters, pose, jnp.zeros(POSE_SIZE, jnp.float32), FROM_REST_SECONDS)
