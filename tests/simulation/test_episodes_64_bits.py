"""JAX_ENABLE_X64 changes nothing: the same program, fed by the same physics, gives the same bits."""

import os
import pathlib
import subprocess
import sys

SCRIPT = """
import hashlib
import jax, jax.numpy as jnp, numpy as np
from agile_jax.control import ControlSettings, make_controller
from agile_jax.robot import RobotSettings, build_mujoco_model, collision_shapes, load_robot
from agile_jax.scene import SceneSettings, make_scene
from agile_jax.simulation import ClosedLoop, MujocoPhysics, MujocoSlots, batch_loop, policy_guidance

scene, robot, control = make_scene(SceneSettings()), load_robot(RobotSettings()), ControlSettings()
model = build_mujoco_model(scene, RobotSettings(), control.control_dt)
guidance = policy_guidance(lambda parameters, pose, velocity, dt: jnp.array([0.5, 0.1, 0.0, 0.2]))
loop = ClosedLoop(
    scene, robot, collision_shapes(model), control, guidance, np.full(4, 1.5), make_controller(robot, control)
)
with MujocoPhysics(model, 2, 1) as physics:
    slots = MujocoSlots(batch_loop(loop), physics, ())
    slots.begin(np.arange(2), np.tile(model.key("home").qpos, (2, 1)), np.array([5.0, 0.04]))
    for _ in range(2):
        slots.advance()
    values = [np.asarray(leaf) for leaf in jax.tree.leaves((slots._episodes, slots._sensed))]
assert not any(value.dtype == np.float64 for value in values[:-5]), "the loop computes in float32"
print(jax.config.jax_enable_x64, hashlib.sha256(b"".join(value.tobytes() for value in values)).hexdigest())
"""


def test_episodes_are_the_same_with_64_bits(pytestconfig):
    cache = pathlib.Path(pytestconfig.rootpath) / ".pytest_cache" / "jax"
    said = []
    for flag in ("0", "1"):
        env = os.environ | {"JAX_ENABLE_X64": flag, "JAX_COMPILATION_CACHE_DIR": str(cache)}
        ran = subprocess.run([sys.executable, "-c", SCRIPT], env=env, capture_output=True, text=True)
        assert ran.returncode == 0, ran.stderr[-2000:]
        said.append(ran.stdout.split())
    assert [flag for flag, _ in said] == ["False", "True"]
    assert said[0][1] == said[1][1]
