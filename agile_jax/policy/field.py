"""Policies that are a velocity field, whose behaviour near the target is designed, not learned.

    v(s) = base(s) + gain(s) * scale * bound(net(features(s)))

plain: base = 0, gain = 1, scale = 1, bound(y) = y, features = s. The paper's field: what it does away from its
samples is anybody's guess.

residual: base is the straight-line braking law towards the target (braking.py), scale = V the velocity bounds,
bound(y) = 2 tanh(y / 2) (base and label differ by 2 V at most), and

    gain = fraction * (1 - exp(-(tau / blend_time)^2))

with tau the time to go of the slowest axis and fraction how close the braking law is to full motion. The gain
vanishes with the error to the power of two, the law only to the power of one: around the target the field is -k e
whatever the network says, so that there is one equilibrium there, at the target, and it is stable. Far away the
network has the authority to turn the field round and along obstacles.

Both are then limited to the velocity bounds and to the top speed at the height (direction kept); the residual field
also, with `field_filter`, to speeds
that can be braked before an obstacle.
"""

import abc

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from agile_jax.arrays import AnyArray
from agile_jax.policy.braking import braking_law, network_gain
from agile_jax.policy.features import features
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Encoding, Policy, Seconds, in_precision_of
from agile_jax.scene import POSE_SIZE, pose_error


class Field(Policy, abc.ABC):
    """A velocity field s -> s'."""

    @abc.abstractmethod
    def velocity(self, parameters: PolicyParameters, pose: Float[AnyArray, "4"]) -> Float[Array, "4"]:
        """The velocity [m/s, rad/s] at a pose [m, rad], within limits and filter."""

    def velocity_from_rest(self, parameters: PolicyParameters, pose: Float[AnyArray, "4"]) -> Float[Array, "4"]:
        """The field's velocity [m/s, rad/s] at the pose [m, rad]."""
        return self.velocity(parameters, pose)

    def command(
        self, parameters: PolicyParameters, pose: Float[AnyArray, "4"], velocity: Float[AnyArray, "4"], dt: Seconds
    ) -> Float[Array, "4"]:
        """The field's velocity [m/s, rad/s] where the robot will be after `dt` [s]: it cannot change before."""
        return self.velocity(parameters, pose + velocity * dt)


class PlainField(Field):
    """The paper's field: the network alone."""

    def encode(self, inputs: Float[AnyArray, "4"]) -> Encoding:
        """The pose itself [m, rad]."""
        pose = jnp.asarray(inputs)
        return Encoding(pose, jnp.zeros(POSE_SIZE, pose.dtype), jnp.ones(1, pose.dtype))

    def output(self, parameters: PolicyParameters, encoding: Encoding) -> Float[Array, "4"]:
        """The trained velocity [m/s, rad/s], before its limits; the network's part is not bounded."""
        output = self.network_output(parameters, encoding.features)
        return encoding.base + encoding.gain * parameters.normalization.scale * output

    def velocity(self, parameters: PolicyParameters, pose: Float[AnyArray, "4"]) -> Float[Array, "4"]:
        """The velocity [m/s, rad/s] at a pose [m, rad], within its bounds."""
        pose = in_precision_of(parameters, pose)
        return self.limited(pose, self.output(parameters, self.encode(pose)))


class ResidualField(Field):
    """The braking law towards the target, and what the network adds to it."""

    @property
    def scale(self) -> Float[np.ndarray, "4"]:
        """The velocity bounds [m/s, rad/s]."""
        return np.asarray(self.limits.velocity)

    def encode(self, inputs: Float[AnyArray, "4"]) -> Encoding:
        """Error and walls, the braking law and the network's gain at a pose [m, rad]."""
        pose = jnp.asarray(inputs)
        law = braking_law(pose_error(self.scene, pose, jnp), self.limits, self.settings.approach_rate)
        gain = network_gain(law, self.settings.blend_time)
        return Encoding(features(self.scene, pose, self.wall_length), law.velocity, gain[None])

    def velocity(self, parameters: PolicyParameters, pose: Float[AnyArray, "4"]) -> Float[Array, "4"]:
        """The velocity [m/s, rad/s] at a pose [m, rad], within limits and filter."""
        pose = in_precision_of(parameters, pose)
        result = self.limited(pose, self.output(parameters, self.encode(pose)))
        return self.filtered(pose, result) if self.settings.field_filter else result
