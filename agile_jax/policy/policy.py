"""What every policy has in common: bounds, a network with its normalisation, and the limits of what it asks for; and
a trained one, for callers that hold NumPy arrays and know no JAX.
"""

import abc
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from agile_jax.arrays import AnyArray
from agile_jax.expert import MotionLimits
from agile_jax.policy.features import natural_range
from agile_jax.policy.network import MLP, Initialisation, Normalization, PolicyParameters, fit_normalization
from agile_jax.policy.settings import PolicySettings
from agile_jax.policy.speed_filter import brake_before_bounds, brake_before_obstacles, within_limits
from agile_jax.scene import POSE_SIZE, Scene, within_top_speed
from agile_jax.single_precision import in_single_precision

Learns = Literal["velocity", "acceleration"]
Seconds = float | Float[AnyArray, ""]


class Encoding(NamedTuple):
    """All that a policy's output depends on besides parameters; training computes it once for each sample.

    The output is base + gain * scale * bound(network(features)).
    """

    features: Float[Array, "*samples f"]  # inputs of the network [m, rad or none]
    base: Float[Array, "*samples 4"]  # what is designed, in the output's units
    gain: Float[Array, "*samples 1"]  # of the network [-]


@dataclass(frozen=True, eq=False)
class Policy(abc.ABC):
    """What drives a robot: a velocity field s -> s', or a feedback law (s, s') -> s''. See `make_policy`.

    Its methods are pure functions of one pose; the caller vmaps them. They compute in the precision of the parameters,
    float32. Trackers use `command` alone.

    Attributes:
        scene: target, obstacles and bounds of the pose, float32.
        limits: of velocity and acceleration, float32.
        settings: its kind, network and features.
    """

    scene: Scene
    limits: MotionLimits
    settings: PolicySettings

    learns: ClassVar[Learns] = "velocity"
    """What its outputs are: velocities [m/s, rad/s] of poses (4,), or accelerations [m/s^2, rad/s^2] of states (8,), a
    pose and its velocity."""

    @abc.abstractmethod
    def encode(self, inputs: Float[AnyArray, " n"]) -> Encoding:
        """The encoding of a pose, shape (4,) [m, rad], or of a state, shape (8,) [m, rad, m/s, rad/s]."""

    def output(self, parameters: PolicyParameters, encoding: Encoding) -> Float[Array, "4"]:
        """What is trained, before any limit: see `learns`. The network's part is within two units of its scale."""
        output = 2.0 * jnp.tanh(self.network_output(parameters, encoding.features) / 2.0)
        return encoding.base + encoding.gain * parameters.normalization.scale * output

    @abc.abstractmethod
    def command(
        self, parameters: PolicyParameters, pose: Float[AnyArray, "4"], velocity: Float[AnyArray, "4"], dt: Seconds
    ) -> Float[Array, "4"]:
        """The velocity [m/s, rad/s] that a robot at `pose` [m, rad] with `velocity` shall have after `dt` [s]."""

    @abc.abstractmethod
    def velocity_from_rest(self, parameters: PolicyParameters, pose: Float[AnyArray, "4"]) -> Float[Array, "4"]:
        """The velocity [m/s, rad/s] that it drives a resting robot to: a field's own at the pose [m, rad]; of a
        feedback law, that after a second of its acceleration from rest. Within limits and filter."""

    def init(self, key: PRNGKeyArray, initialisation: Initialisation = "lecun_normal") -> PolicyParameters:
        """Random parameters; inputs are not normalised."""
        count = len(self.spans)
        mean, std = jnp.zeros(count, jnp.float32), jnp.ones(count, jnp.float32)
        normalization = Normalization(mean, std, jnp.asarray(self.scale, jnp.float32))
        module = self.network.clone(initialisation=initialisation)
        return PolicyParameters(jax.jit(module.init)(key, jnp.zeros(count, jnp.float32)), normalization)

    def normalise(self, parameters: PolicyParameters, features: Float[np.ndarray, "m f"]) -> PolicyParameters:
        """The parameters with the normalisation that fits the features of m samples."""
        if not self.settings.normalize_inputs:
            return parameters
        return parameters._replace(normalization=fit_normalization(features, self.spans, self.scale))

    @cached_property
    def network(self) -> MLP:
        """The network, features to 4 outputs."""
        return MLP((*self.settings.hidden_layers, POSE_SIZE), self.settings.activation)

    @cached_property
    def spans(self) -> Float[np.ndarray, " f"]:
        """Half of what each feature can span, in its unit."""
        size = POSE_SIZE if self.learns == "velocity" else 2 * POSE_SIZE
        inputs = jax.eval_shape(self.encode, jax.ShapeDtypeStruct((size,), jnp.float32))
        return natural_range(self.scene, inputs.features.shape[-1])

    @property
    def scale(self) -> Float[np.ndarray, "4"]:
        """Unit of the network's outputs before training chooses another, in the unit of `output`."""
        return np.ones(POSE_SIZE, np.float32)

    @property
    def wall_length(self) -> float | None:
        """Distance [m] over which the wall features saturate; None without them."""
        return self.settings.wall_length if self.settings.wall_features else None

    def network_output(self, parameters: PolicyParameters, features: Float[Array, " f"]) -> Float[Array, "4"]:
        """The network's output on features, neither bounded nor scaled [-]."""
        mean, std, _ = parameters.normalization
        return self.network.apply(parameters.network, (features - mean) / std)

    def limited(self, pose: Float[Array, "4"], velocity: Float[Array, "4"]) -> Float[Array, "4"]:
        """The velocity [m/s, rad/s] within its bounds at a pose [m, rad]."""
        return within_top_speed(self.scene, pose[2], within_limits(velocity, self.limits.velocity), jnp)

    def filtered(self, pose: Float[Array, "4"], velocity: Float[Array, "4"]) -> Float[Array, "4"]:
        """The velocity [m/s, rad/s], cut to what can be braked before obstacles and bounds from `pose` [m, rad]."""
        scene, acceleration = self.scene, self.limits.acceleration
        result = brake_before_obstacles(scene, pose, velocity, acceleration, self.settings.filter_margin)
        return brake_before_bounds(scene, pose, self.limited(pose, result), acceleration)


def in_precision_of(parameters: PolicyParameters, array: Float[AnyArray, "*shape"]) -> Float[Array, "*shape"]:
    """The array in the parameters' precision."""
    return jnp.asarray(array, parameters.normalization.mean.dtype)


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
