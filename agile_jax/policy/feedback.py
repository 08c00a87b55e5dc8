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

import jax
import jax.numpy as jnp
import numpy as np

from agile_jax.policy.braking import braking_law
from agile_jax.policy.features import features, natural_range
from agile_jax.policy.field import Encoding, Policy, make_network
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.settings import PolicySettings
from agile_jax.policy.speed_filter import brake_before_bounds, brake_before_obstacles, within_limits
from agile_jax.scene import POSE_SIZE, Scene, pose_error


def make_feedback(
    scene: Scene, velocity_limit: np.ndarray, acceleration_limit: np.ndarray, settings: PolicySettings
) -> Policy:
    """The feedback law; see `make_policy`.

    Its `velocity` is the one after a second of the acceleration from rest, within the bounds: where it sets off to.
    """
    limit = jnp.asarray(velocity_limit, jnp.float32)
    acceleration = jnp.asarray(acceleration_limit, jnp.float32)
    scene = Scene(*(np.asarray(array, np.float32) for array in scene))
    wall_length = settings.wall_length if settings.wall_features else None

    def encode(state: jax.Array) -> Encoding:
        state = jnp.asarray(state)
        pose, velocity = state[:POSE_SIZE], state[POSE_SIZE:]
        law = braking_law(pose_error(scene, pose, jnp), limit, acceleration, settings.approach_rate)
        base = jnp.clip((law.velocity - velocity) / settings.blend_time, -acceleration, acceleration)
        gain = law.fraction * -jnp.expm1(-((law.time_to_go / settings.blend_time) ** 2))
        inputs = jnp.concatenate([features(scene, pose, wall_length), velocity / limit])
        return Encoding(inputs, base, gain[None])

    inputs = jax.eval_shape(encode, jax.ShapeDtypeStruct((2 * POSE_SIZE,), jnp.float32)).features.shape[-1]
    network = make_network(settings, natural_range(scene, inputs), np.asarray(acceleration_limit))

    def law(parameters: PolicyParameters, encoding: Encoding) -> jax.Array:
        output = 2.0 * jnp.tanh(network.output(parameters, encoding.features) / 2.0)
        return encoding.base + encoding.gain * parameters.normalization.scale * output

    def command(parameters: PolicyParameters, pose: jax.Array, velocity: jax.Array, dt: float) -> jax.Array:
        wanted = law(parameters, encode(jnp.concatenate([pose, velocity])))
        result = within_limits(velocity + jnp.clip(wanted, -acceleration, acceleration) * dt, limit)
        if settings.field_filter:
            ahead = pose + velocity * dt
            result = brake_before_obstacles(scene, ahead, result, acceleration, settings.filter_margin)
            result = brake_before_bounds(scene, ahead, within_limits(result, limit), acceleration)
        return result

    def velocity(parameters: PolicyParameters, pose: jax.Array) -> jax.Array:
        pose = jnp.asarray(pose)
        return command(parameters, pose, jnp.zeros(POSE_SIZE), 1.0)

    return Policy(network.init, velocity, command, "acceleration", encode, law, network.fit)
