"""The physics in MJX, compiled by JAX: pure functions of one robot; vmap them.

MJX is 32 bit here and looks at every possible contact; otherwise it computes what MuJoCo C computes.
"""

import contextlib
import io
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco

from agile_jax.settings import BadInput
from agile_jax.simulation.sensed import Sensed, TouchSlots, contact_flags, touch_slots

with contextlib.redirect_stdout(io.StringIO()):  # it prints how to install its optional second backend
    from mujoco import mjx


class MjxModel(NamedTuple):
    """A model on the device."""

    model: Any  # mjx.Model
    slots: TouchSlots


def mjx_init(model: mujoco.MjModel) -> MjxModel:
    """Put a model made by `robot.build_mujoco_model` on the device.

    Raises:
        BadInput: MJX has no collision between two kinds of shape of this model.
    """
    try:
        return MjxModel(mjx.put_model(model, impl="jax"), touch_slots(model))
    except NotImplementedError as error:
        raise BadInput(
            f'MJX cannot simulate this robot in this scene: {error}; use evaluation.backend = "mujoco"'
        ) from None


def mjx_reset(model: MjxModel, qpos: jax.Array) -> Any:
    """Data of the robot at rest at coordinates (19,)."""
    return mjx.make_data(model.model, impl="jax").replace(qpos=jnp.asarray(qpos))


def mjx_step(model: MjxModel, data: Any, torque: jax.Array) -> tuple[Any, Sensed]:
    """Advance by one time step of the model.

    A torque or state that is not finite makes the state NaN from then on; such a state touches nothing.

    Args:
        model: of `mjx_init`.
        data: of `mjx_reset` or of the last step.
        torque: shape (12,) [Nm]; clamped to the limits by the model.
    """
    data = mjx.step(model.model, data.replace(ctrl=torque))
    flags = contact_flags(data.sensordata, model.slots)
    sound = jnp.isfinite(data.qpos).all() & jnp.isfinite(data.qvel).all()
    return data, Sensed(data.qpos, data.qvel, *(flag & sound for flag in flags))
