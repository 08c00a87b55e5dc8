"""A trained policy for use elsewhere, in two forms (docs/export.md):

policy.jaxexport   a serialised `jax.export` module for CPUs and CUDA: what a robot follows, limits and filter included
policy.npz         weights, normalisation and constants of a field: what was trained, before the limits

The module maps poses (b, 4) of any b to velocities (b, 4); that of a feedback law maps poses, velocities (b, 4) and the
tick () to the velocities a tick later.
"""

import io
import pathlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import export as jax_export

from agile_jax.files import write_atomic
from agile_jax.policy.field import Policy
from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.settings import PolicySettings
from agile_jax.scene import POSE_SIZE, Scene

PLATFORMS = ("cpu", "cuda")
MODULE, WEIGHTS = "policy.jaxexport", "policy.npz"


def export_policy(
    policy: Policy,
    parameters: PolicyParameters,
    settings: PolicySettings,
    scene: Scene,
    velocity_limit: np.ndarray,
    acceleration_limit: np.ndarray,
    directory: pathlib.Path,
) -> list[pathlib.Path]:
    """Write both forms into `directory`; a feedback law has the module alone.

    Args:
        policy, parameters: what was trained.
        settings: it was made with.
        scene: of it.
        velocity_limit, acceleration_limit: of its labels, shape (4,).
        directory: made if missing.

    Returns:
        The files.
    """
    paths = [directory / MODULE]
    write_atomic(paths[0], exported_module(policy, parameters))
    if policy.learns == "velocity":
        paths.append(directory / WEIGHTS)
        buffer = io.BytesIO()
        arrays = field_arrays(parameters, settings, scene, velocity_limit, acceleration_limit)
        np.savez(buffer, allow_pickle=False, **arrays)
        write_atomic(paths[1], buffer.getvalue())
    return paths


def exported_module(policy: Policy, parameters: PolicyParameters) -> bytes:
    """The serialised module, the parameters inside."""
    (count,) = jax_export.symbolic_shape("b")
    poses = jax.ShapeDtypeStruct((count, POSE_SIZE), jnp.float32)
    function: Callable[..., jax.Array]
    arguments: tuple[Any, ...]
    if policy.learns == "velocity":
        function, arguments = jax.vmap(lambda pose: policy.velocity(parameters, pose)), (poses,)
    else:
        function = jax.vmap(lambda pose, velocity, dt: policy.command(parameters, pose, velocity, dt), (0, 0, None))
        arguments = (poses, poses, jax.ShapeDtypeStruct((), jnp.float32))
    return bytes(jax_export.export(jax.jit(function), platforms=PLATFORMS)(*arguments).serialize())


def field_arrays(
    parameters: PolicyParameters,
    settings: PolicySettings,
    scene: Scene,
    velocity_limit: np.ndarray,
    acceleration_limit: np.ndarray,
) -> dict[str, np.ndarray]:
    """All that a field is computed from, by name: layers in order, then normalisation, then constants."""
    layers = parameters.network["params"]
    arrays: dict[str, Any] = {}
    for i in range(len(layers)):
        arrays |= {f"kernel_{i}": layers[f"Dense_{i}"]["kernel"], f"bias_{i}": layers[f"Dense_{i}"]["bias"]}
    mean, std, scale = parameters.normalization
    arrays |= {"input_mean": mean, "input_std": std, "output_scale": scale}
    arrays |= {"kind": settings.kind, "activation": settings.activation, "wall_features": settings.wall_features}
    arrays |= {
        "wall_length": settings.wall_length,
        "blend_time": settings.blend_time,
        "approach_rate": settings.approach_rate,
    }
    arrays |= {"velocity_limit": velocity_limit, "acceleration_limit": acceleration_limit}
    arrays |= {name: getattr(scene, name) for name in ("target", "torso_half_size", "obstacle_centers")}
    arrays |= {name: getattr(scene, name) for name in ("obstacle_half_sizes", "obstacle_yaws")}
    return {name: np.asarray(array) for name, array in arrays.items()}
