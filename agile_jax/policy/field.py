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

Both are then limited to the velocity bounds (direction kept); the residual field also, with `field_filter`, to speeds
that can be braked before an obstacle.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.policy.braking import braking_law
from agile_jax.policy.features import features, natural_range
from agile_jax.policy.network import MLP, Normalization, PolicyParameters, fit_normalization
from agile_jax.policy.settings import PolicySettings
from agile_jax.policy.speed_filter import brake_before_bounds, brake_before_obstacles, within_limits
from agile_jax.scene import POSE_SIZE, Scene, pose_error


class Encoding(NamedTuple):
    """All of a pose that the field depends on; free of parameters, so that training computes it once."""

    features: jax.Array  # (f,)
    base: jax.Array  # (4,) [m/s, rad/s]
    gain: jax.Array  # (1,)


class Policy(NamedTuple):
    """What drives a robot: a velocity field s -> s', or a feedback law (s, s') -> s''.

    One pose a call; vmap at the caller. All functions are pure. Trackers use `command` alone.
    """

    init: Callable[..., PolicyParameters]  # (key, initialisation="lecun_normal"), normalisation identity
    velocity: Callable[[PolicyParameters, jax.Array], jax.Array]  # pose (4,) -> limited velocity (4,)
    command: Callable[..., jax.Array]  # (parameters, pose, velocity, dt) -> wanted velocity a tick later (4,)
    learns: Literal["velocity", "acceleration"]  # of a pose (4,); or of a state (8,), the pose and its velocity
    encode: Callable[[jax.Array], Encoding]  # what it learns from, (4,) or (8,)
    field: Callable[[PolicyParameters, Encoding], jax.Array]  # -> (4,) before any limit: what is trained
    fit: Callable[[PolicyParameters, np.ndarray], PolicyParameters]  # sets the normalisation from features (m, f)


class Network(NamedTuple):
    """The functions of a policy that do not depend on its kind."""

    init: Callable[..., PolicyParameters]
    fit: Callable[[PolicyParameters, np.ndarray], PolicyParameters]
    output: Callable[[PolicyParameters, jax.Array], jax.Array]  # features (f,) -> (4,), not scaled


def make_network(settings: PolicySettings, spans: np.ndarray, scale: np.ndarray) -> Network:
    """The network of a policy.

    Args:
        settings: its layers.
        spans: half of what each input can span, shape (f,).
        scale: of the outputs, shape (4,).
    """
    layers = (*settings.hidden_layers, POSE_SIZE)
    network = MLP(layers, settings.activation)

    def init(key: jax.Array, initialisation: str = "lecun_normal") -> PolicyParameters:
        module = MLP(layers, settings.activation, initialisation)
        count = len(spans)
        normalization = Normalization(jnp.zeros(count), jnp.ones(count), jnp.asarray(scale, jnp.float32))
        return PolicyParameters(jax.jit(module.init)(key, jnp.zeros(count)), normalization)

    def fit(parameters: PolicyParameters, inputs: np.ndarray) -> PolicyParameters:
        if not settings.normalize_inputs:
            return parameters
        return parameters._replace(normalization=fit_normalization(inputs, spans, scale))

    def output(parameters: PolicyParameters, inputs: jax.Array) -> jax.Array:
        mean, std, _ = parameters.normalization
        return network.apply(parameters.network, (inputs - mean) / std)

    return Network(init, fit, output)


def make_field(
    scene: Scene, velocity_limit: np.ndarray, acceleration_limit: np.ndarray, settings: PolicySettings
) -> Policy:
    """The plain or the residual field.

    Args:
        scene: target and obstacles.
        velocity_limit, acceleration_limit: bounds of the labels, shape (4,) [m/s, rad/s], [m/s^2, rad/s^2].
        settings: kind, network and features.
    """
    limit = jnp.asarray(velocity_limit, jnp.float32)
    acceleration = jnp.asarray(acceleration_limit, jnp.float32)
    scene = Scene(*(np.asarray(array, np.float32) for array in scene))
    residual = settings.kind == "residual"
    scale = np.asarray(velocity_limit) if residual else np.ones(POSE_SIZE)
    wall_length = settings.wall_length if settings.wall_features else None

    def encode(pose: jax.Array) -> Encoding:
        pose = jnp.asarray(pose)
        if not residual:
            return Encoding(pose, jnp.zeros(POSE_SIZE), jnp.ones(1))
        law = braking_law(pose_error(scene, pose, jnp), limit, acceleration, settings.approach_rate)
        gain = law.fraction * -jnp.expm1(-((law.time_to_go / settings.blend_time) ** 2))
        return Encoding(features(scene, pose, wall_length), law.velocity, gain[None])

    inputs = jax.eval_shape(encode, jax.ShapeDtypeStruct((POSE_SIZE,), jnp.float32)).features.shape[-1]
    network = make_network(settings, natural_range(scene, inputs), scale)

    def field(parameters: PolicyParameters, encoding: Encoding) -> jax.Array:
        output = network.output(parameters, encoding.features)
        if residual:
            output = 2.0 * jnp.tanh(output / 2.0)
        return encoding.base + encoding.gain * parameters.normalization.scale * output

    def velocity(parameters: PolicyParameters, pose: jax.Array) -> jax.Array:
        pose = jnp.asarray(pose)
        result = within_limits(field(parameters, encode(pose)), limit)
        if residual and settings.field_filter:
            result = brake_before_obstacles(scene, pose, result, acceleration, settings.filter_margin)
            result = brake_before_bounds(scene, pose, within_limits(result, limit), acceleration)
        return result

    def command(parameters: PolicyParameters, pose: jax.Array, speed: jax.Array, dt: float) -> jax.Array:
        return velocity(parameters, pose + speed * dt)  # a tick ahead: the velocity cannot change before

    return Policy(network.init, velocity, command, "velocity", encode, field, network.fit)
