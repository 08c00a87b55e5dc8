"""Both exported forms agree with the policy; the reader is the one of docs/export.md."""

import json
import pathlib
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from synthetic import LIMITS, VELOCITY, table_scene

from agile_jax.policy import PolicySettings, TrainedPolicy, export_policy, make_policy
from agile_jax.scene import BoxSettings, SceneSettings, TableSettings, make_scene

DOCS = pathlib.Path(__file__).parents[2] / "docs" / "export.md"


def reader():
    """The names that the docs' program defines."""
    (program,) = re.findall(r"```python\n(.*?)```", DOCS.read_text(), re.DOTALL)
    names = {}
    exec(program, names)
    return names


def poses(scene, count=300):
    generator = np.random.default_rng(0)
    anywhere = generator.uniform(scene.lower, scene.upper, (count, 4))
    near = scene.target + 1e-2 * generator.standard_normal((count // 3, 4))
    return np.concatenate([anywhere, near, [scene.target]]).astype(np.float32)


def exported(tmp_path, scene, settings, seed=0):
    policy = make_policy(scene, LIMITS, settings)
    parameters = policy.init(jax.random.key(seed))
    inputs = jax.vmap(policy.encode)(jnp.asarray(poses(scene)) if policy.learns == "velocity" else states(scene))
    parameters = policy.normalise(parameters, np.asarray(inputs.features))
    return policy, parameters, export_policy(TrainedPolicy(policy, parameters), tmp_path / "out")


def states(scene):
    velocities = np.random.default_rng(1).uniform(-1, 1, poses(scene).shape) * VELOCITY
    return np.concatenate([poses(scene), velocities], -1).astype(np.float32)


@pytest.mark.parametrize("kind", ["residual", "plain"])
def test_module_gives_what_the_robot_follows_for_any_number_of_poses(tmp_path, kind):
    scene = table_scene()
    policy, parameters, ((path, _, _), _) = exported(tmp_path, scene, PolicySettings(kind=kind, hidden_layers=(32, 32)))
    module = jax.export.deserialize(bytearray(path.read_bytes()))
    assert module.platforms == ("cpu", "cuda")
    expected = jax.jit(jax.vmap(policy.velocity, (None, 0)))
    for count in (1, 7, 300):
        given = poses(scene)[:count]
        np.testing.assert_allclose(module.call(given), expected(parameters, given), rtol=0, atol=1e-6)


def test_module_of_a_feedback_law_takes_the_velocity_and_the_tick(tmp_path):
    scene = table_scene()
    policy, parameters, (paths, note) = exported(
        tmp_path, scene, PolicySettings(kind="feedback", hidden_layers=(32, 32))
    )
    assert [path.name for path in paths] == ["policy.jaxexport", "policy.json"]
    assert 'not a policy of kind "feedback"' in note
    assert 'not a policy of kind "feedback"' in json.loads(paths[1].read_text())["no_weights_because"]
    call = jax.export.deserialize(bytearray(paths[0].read_bytes())).call
    given = states(scene)
    command = jax.jit(jax.vmap(policy.command, (None, 0, 0, None)))
    for dt in (0.01, 0.03):
        found = call(given[:, :4], given[:, 4:], np.float32(dt))
        np.testing.assert_allclose(found, command(parameters, given[:, :4], given[:, 4:], dt), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    "settings",
    [
        PolicySettings(hidden_layers=(32, 32)),
        PolicySettings(hidden_layers=(16,), activation="gelu", wall_features=False),
        PolicySettings(
            hidden_layers=(16, 16), activation="softplus", wall_length=0.3, blend_time=0.2, approach_rate=6.0
        ),
        PolicySettings(kind="plain", hidden_layers=(32, 16), activation="relu"),
    ],
)
def test_the_reader_of_the_docs_computes_the_field(tmp_path, settings):
    table = TableSettings(kind="table", position=(1.5, 0.0), size=(0.5, 1.0), underside=0.25, yaw=0.2)
    box = BoxSettings(kind="box", position=(0.4, 1.2, 0.15), size=(0.6, 0.2, 0.3), yaw=-0.8)
    scene = make_scene(SceneSettings(obstacles=(table, box)))
    policy, parameters, ((_, weights, about), note) = exported(tmp_path, scene, settings)
    assert note is None
    assert json.loads(about.read_text())["weights"] == weights.name
    with np.load(weights) as file:
        read = {name: file[name] for name in file.files}
    field = reader()["field"]
    found = np.array([field(read, pose.astype(np.float64)) for pose in poses(scene)])
    with jax.enable_x64(True):  # in float32 JAX's own rounding is as large as the tolerance
        exact = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf), jnp.float64), parameters)
        trained = jax.jit(jax.vmap(lambda pose: policy.output(exact, policy.encode(pose))))
        trained = np.asarray(trained(poses(scene).astype(np.float64)))
    single = jax.jit(jax.vmap(lambda pose: policy.output(parameters, policy.encode(pose))))(poses(scene))
    np.testing.assert_allclose(found, single, rtol=0, atol=5e-6)
    np.testing.assert_allclose(found, trained, rtol=0, atol=1e-6)


def test_a_field_whose_yaw_is_bounded_has_no_weights_since_the_docs_reader_would_turn_the_other_way(tmp_path):
    scene = make_scene(SceneSettings(lower=(-1.5, -3.0, 0.155, -1.0), upper=(4.5, 3.0, 0.32, 1.0)))
    _, _, (paths, note) = exported(tmp_path, scene, PolicySettings(hidden_layers=(16,)))
    assert [path.name for path in paths] == ["policy.jaxexport", "policy.json"]
    assert "yaw for unbounded" in note
