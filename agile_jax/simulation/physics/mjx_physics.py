"""The physics in MJX, compiled by JAX: pure functions of one robot; vmap them.

MJX is 32 bit here, and its contact solver stops after `ITERATIONS`: with these its steps agree with those of C at C's
own hundred (tests/simulation/test_mjx_walk.py), and in a batch all robots wait for the slowest. Its own implementation
("jax") looks at every possible contact; otherwise it computes what MuJoCo C computes. The other one ("warp") is MuJoCo
Warp, for NVIDIA GPUs.
"""

import contextlib
import copy
import io
from collections.abc import Callable
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
from jaxtyping import Float

from agile_jax.arrays import AnyArray
from agile_jax.settings import BadInput
from agile_jax.simulation.sensed import Sensed, TouchSlots, contact_flags, touch_slots

with contextlib.redirect_stdout(io.StringIO()):  # it prints how to install its optional second backend
    from mujoco import mjx


# Of one robot in MuJoCo Warp, which has a memory for them: feet and knees on the floor, trunk at a table.
MAX_CONTACTS = 32
MAX_ROWS = 192  # of constraints of one robot there: pyramids of the contacts, friction and limits of the joints

ITERATIONS = 10  # of the contact solver, and of each of its line searches
Implementation = Literal["jax", "warp"]


class MjxModel(NamedTuple):
    """A model on the device."""

    model: mjx.Model
    slots: TouchSlots
    make_data: Callable[[], mjx.Data]  # of one robot


def check_warp() -> None:
    """Refuse MuJoCo Warp (BadInput) where it is not installed or there is no NVIDIA GPU."""
    if not mjx.warp.WARP_INSTALLED:
        raise BadInput('evaluation.backend = "mjx-warp" needs MuJoCo Warp: pip install "mujoco-mjx[warp]"')
    if jax.default_backend() != "gpu":
        raise BadInput(
            f'evaluation.backend = "mjx-warp" needs an NVIDIA GPU, and JAX finds {jax.devices()[0].platform} only; '
            'use "mujoco" or "mjx"'
        )


def mjx_init(model: mujoco.MjModel, implementation: Implementation = "jax", robots: int = 1) -> MjxModel:
    """Put a model made by `robot.build_mujoco_model` on the device.

    Args:
        model: of C MuJoCo.
        implementation: of MJX.
        robots: simulated at once, for which MuJoCo Warp reserves memory.

    Raises:
        BadInput: MJX has no collision between two kinds of shape of this model.
    """

    def make_data() -> mjx.Data:
        if implementation == "warp":
            return mjx.make_data(model, impl="warp", naconmax=MAX_CONTACTS * robots, njmax=MAX_ROWS)
        return mjx.make_data(on_device, impl="jax")

    model = copy.copy(model)
    model.opt.iterations = model.opt.ls_iterations = ITERATIONS
    if implementation == "warp":  # it never resets by itself, and refuses models that ask it not to
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    try:
        with jax.enable_x64(False):
            on_device = mjx.put_model(model, impl=implementation)
    except NotImplementedError as error:
        raise BadInput(
            f'MJX cannot simulate this robot in this scene: {error}; use evaluation.backend = "mujoco"'
        ) from None
    return MjxModel(on_device, touch_slots(model), make_data)


def mjx_reset(model: MjxModel, qpos: Float[AnyArray, "19"]) -> mjx.Data:
    """Data of the robot at rest at coordinates [m, quaternion wxyz, rad]."""
    with jax.enable_x64(False):
        return model.make_data().replace(qpos=jnp.asarray(qpos, jnp.float32))


def mjx_step(model: MjxModel, data: mjx.Data, torque: Float[AnyArray, "12"]) -> tuple[mjx.Data, Sensed]:
    """Advance by one time step of the model.

    A torque or state that is not finite makes the state NaN from then on; such a state touches nothing.

    Args:
        model: of `mjx_init`.
        data: of `mjx_reset` or of the last step.
        torque: [Nm]; clamped to the limits by the model.
    """
    with jax.enable_x64(False):
        data = mjx.step(model.model, data.replace(ctrl=jnp.asarray(torque, jnp.float32)))
    flags = contact_flags(data.sensordata, model.slots)
    sound = jnp.isfinite(data.qpos).all() & jnp.isfinite(data.qvel).all()
    return data, Sensed(data.qpos, data.qvel, *(flag & sound for flag in flags))
