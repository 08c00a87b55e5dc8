"""Whole-body control: gait clock, footholds, swing, convex MPC over friction cones, torques. Knows the robot, not the scene."""

from agile_jax.control.controller import Controller, ControllerState, Reference, make_controller
from agile_jax.control.settings import ControlSettings, GaitSettings, MpcSettings

__all__ = [
    "ControlSettings",
    "Controller",
    "ControllerState",
    "GaitSettings",
    "MpcSettings",
    "Reference",
    "make_controller",
]
