"""Whole-body control: gait, footholds, swing, convex MPC over friction cones, torques. Knows no scene, no policy."""

from typing import TYPE_CHECKING

from agile_jax.control.settings import ControlSettings, GaitSettings, MpcSettings
from agile_jax.lazy import lazy_names

if TYPE_CHECKING:
    from agile_jax.control.body import Reference
    from agile_jax.control.controller import Controller, ControllerState, make_controller
    from agile_jax.control.diagnostics import Counts, Diagnostics, keep_counts

__all__ = [
    "ControlSettings",
    "Controller",
    "ControllerState",
    "Counts",
    "Diagnostics",
    "GaitSettings",
    "MpcSettings",
    "Reference",
    "keep_counts",
    "make_controller",
]

__getattr__ = lazy_names(
    __name__,
    {
        "body": "Reference",
        "controller": "Controller ControllerState make_controller",
        "diagnostics": "Counts Diagnostics keep_counts",
    },
)
