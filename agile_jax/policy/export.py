"""A trained policy for use elsewhere (docs/export.md):

policy.jaxexport   a serialised `jax.export` module for CPUs and CUDA: what a robot follows, limits and filter included
policy.npz         weights, normalisation and constants of a field: what was trained, before the limits
policy.json        its kind, inputs and outputs, and which of the two there are, and why not both

The module maps poses (b, 4) of any b to velocities (b, 4); that of a feedback law maps poses, velocities (b, 4) and the
tick () to the velocities a tick later.
"""

import pathlib
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import export as jax_export
from jaxtyping import Shaped

from agile_jax.files import write_atomic, write_json
from agile_jax.policy.field import PlainField, ResidualField
from agile_jax.policy.policy import Policy, TrainedPolicy
from agile_jax.scene import POSE_NAMES, POSE_SIZE, turns_freely
from agile_jax.single_precision import in_single_precision
from agile_jax.store.npz import write_npz

PLATFORMS = ("cpu", "cuda")
MODULE, WEIGHTS, METADATA = "policy.jaxexport", "policy.npz", "policy.json"


class Exported(NamedTuple):
    """What an export wrote."""

    paths: list[pathlib.Path]
    note: str | None  # why there are no weights, where there are none


def export_policy(trained: TrainedPolicy, directory: pathlib.Path) -> Exported:
    """Write the module, the weights where the reader of docs/export.md can compute from them, and the metadata.

    Args:
        trained: the policy and its parameters.
        directory: made if missing.
    """
    reason = unreadable(trained.policy)
    paths = [directory / MODULE]
    write_atomic(paths[0], exported_module(trained))
    weights = directory / WEIGHTS
    if reason is None:
        write_npz(weights, field_arrays(trained))
        paths.append(weights)
    else:
        weights.unlink(missing_ok=True)  # of an earlier export
    paths.append(directory / METADATA)
    write_json(paths[-1], metadata(trained.policy, reason))
    note = None if reason is None else f"{weights} is not written: {reason}; {paths[0]} holds the whole policy"
    return Exported(paths, note)


def unreadable(policy: Policy) -> str | None:
    """Why the reader of docs/export.md cannot compute the policy from its weights; None where it can."""
    if type(policy) not in (PlainField, ResidualField):
        return f'the documented reader computes velocity fields, not a policy of kind "{policy.settings.kind}"'
    if isinstance(policy, ResidualField) and not turns_freely(policy.scene):
        return "the documented reader takes yaw for unbounded, and the scene bounds it to less than a full turn"
    return None


def metadata(policy: Policy, reason: str | None) -> dict[str, object]:
    """What policy.json says. `reason`: why there are no weights."""
    pose = f"pose {list(POSE_NAMES)} [m, rad]"
    field = policy.learns == "velocity"
    return {
        "kind": policy.settings.kind,
        "inputs": [f"{pose}, (b, 4)"]
        if field
        else [f"{pose}, (b, 4)", "velocity [m/s, rad/s], (b, 4)", "tick [s], ()"],
        "output": "velocity [m/s, rad/s], (b, 4)" if field else "velocity a tick later [m/s, rad/s], (b, 4)",
        "module": MODULE,
        "platforms": list(PLATFORMS),
        "weights": WEIGHTS if reason is None else None,
        "no_weights_because": reason,
    }


@in_single_precision
def exported_module(trained: TrainedPolicy) -> bytes:
    """The serialised module, the parameters inside."""
    policy, parameters = trained.policy, trained.parameters
    (count,) = jax_export.symbolic_shape("b")
    poses = jax.ShapeDtypeStruct((count, POSE_SIZE), jnp.float32)
    if policy.learns == "velocity":
        field = jax.jit(jax.vmap(lambda pose: policy.velocity_from_rest(parameters, pose)))
        return bytes(jax_export.export(field, platforms=PLATFORMS)(poses).serialize())
    law = jax.vmap(lambda pose, velocity, dt: policy.command(parameters, pose, velocity, dt), (0, 0, None))
    arguments = poses, poses, jax.ShapeDtypeStruct((), jnp.float32)
    return bytes(jax_export.export(jax.jit(law), platforms=PLATFORMS)(*arguments).serialize())


def field_arrays(trained: TrainedPolicy) -> dict[str, Shaped[np.ndarray, "..."]]:
    """All that a field is computed from, by name: layers in order, then normalisation, then constants."""
    policy, parameters = trained.policy, trained.parameters
    layers = parameters.network["params"]
    arrays: dict[str, object] = {}
    for i in range(len(layers)):
        arrays |= {f"kernel_{i}": layers[f"Dense_{i}"]["kernel"], f"bias_{i}": layers[f"Dense_{i}"]["bias"]}
    mean, std, scale = parameters.normalization
    arrays |= {"input_mean": mean, "input_std": std, "output_scale": scale}
    settings = ("kind", "activation", "wall_features", "wall_length", "blend_time", "approach_rate")
    arrays |= {name: getattr(policy.settings, name) for name in settings}
    arrays |= {"velocity_limit": policy.limits.velocity, "acceleration_limit": policy.limits.acceleration}
    places = ("target", "torso_half_size", "obstacle_centers", "obstacle_half_sizes", "obstacle_yaws")
    arrays |= {name: getattr(policy.scene, name) for name in places}
    return {name: np.asarray(array) for name, array in arrays.items()}
