"""Whole-body control: gait, footholds, swing, convex MPC, torques. Knows no scene, no policy.

`controller.py` composes them. The MPC is in `mpc/`: `mpc/problem.py` builds its quadratic program, friction cones and
limits included, and `mpc/solver/` solves it. `interface.py` says what another controller must have.
"""

from typing import TYPE_CHECKING

from agile_jax.control.settings import ControlSettings, GaitSettings, MpcSettings
from agile_jax.lazy import lazy_names

if TYPE_CHECKING:
    from agile_jax.control.body import Reference
    from agile_jax.control.controller import ControllerState, MpcController, make_controller, make_mpc_controller
    from agile_jax.control.diagnostics import Counts, Diagnostics, no_diagnostics
    from agile_jax.control.interface import Controller
    from agile_jax.control.precision import as_float32, in_float32

__all__ = [
    "ControlSettings",
    "Controller",
    "ControllerState",
    "Counts",
    "Diagnostics",
    "GaitSettings",
    "MpcController",
    "MpcSettings",
    "Reference",
    "as_float32",
    "in_float32",
    "make_controller",
    "make_mpc_controller",
    "no_diagnostics",
]

__getattr__ = lazy_names(
    __name__,
    {
        "body": "Reference",
        "controller": "ControllerState MpcController make_controller make_mpc_controller",
        "diagnostics": "Counts Diagnostics no_diagnostics",
        "interface": "Controller",
        "precision": "as_float32 in_float32",
    },
)
