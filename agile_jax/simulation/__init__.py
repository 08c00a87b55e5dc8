"""Closed-loop episodes: the loop of one robot, its outcome, and the two physics backends that drive many at once."""

from agile_jax.simulation.episodes import Rollout, batch_loop, mjx_runner, run_mujoco
from agile_jax.simulation.mjx_physics import mjx_init
from agile_jax.simulation.mujoco_physics import MujocoPhysics
from agile_jax.simulation.outcome import OUTCOME_NAMES, SUCCESS, Outcome
from agile_jax.simulation.rollout import ClosedLoop, Episode, Trace, make_closed_loop
from agile_jax.simulation.sensed import Sensed

__all__ = [
    "OUTCOME_NAMES",
    "SUCCESS",
    "ClosedLoop",
    "Episode",
    "MujocoPhysics",
    "Outcome",
    "Rollout",
    "Sensed",
    "Trace",
    "batch_loop",
    "make_closed_loop",
    "mjx_init",
    "mjx_runner",
    "run_mujoco",
]
