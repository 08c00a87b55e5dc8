"""Closed-loop episodes: the loop of one robot, its outcome, and the two physics backends that drive many at once."""

from agile_jax.simulation.mjx_physics import Implementation, check_warp, mjx_init
from agile_jax.simulation.mjx_slots import MjxSlots, mjx_loop
from agile_jax.simulation.mujoco_physics import MujocoPhysics
from agile_jax.simulation.mujoco_slots import MujocoSlots, batch_loop
from agile_jax.simulation.outcome import OUTCOME_NAMES, SUCCESS, UNSTABLE, Outcome
from agile_jax.simulation.paths import Path, PathPlanner, path_command
from agile_jax.simulation.reference import Command, policy_command
from agile_jax.simulation.rollout import ClosedLoop, Episode, make_closed_loop
from agile_jax.simulation.sensed import Sensed
from agile_jax.simulation.slots import Rollout, Slots, gather, stream
from agile_jax.simulation.traces import LastStates, Recorder, Trace

__all__ = [
    "OUTCOME_NAMES",
    "SUCCESS",
    "UNSTABLE",
    "ClosedLoop",
    "Command",
    "Episode",
    "Implementation",
    "LastStates",
    "MjxSlots",
    "MujocoPhysics",
    "MujocoSlots",
    "Outcome",
    "Path",
    "PathPlanner",
    "Recorder",
    "Rollout",
    "Sensed",
    "Slots",
    "Trace",
    "batch_loop",
    "check_warp",
    "gather",
    "make_closed_loop",
    "mjx_init",
    "mjx_loop",
    "path_command",
    "policy_command",
    "stream",
]
