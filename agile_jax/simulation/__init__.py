"""Closed-loop episodes: the loop of one robot, its outcome, and the two physics that drive many robots at once.

`closed_loop.py` composes what is followed, reference, controller and outcome; `plan_cycle.py` is the loop over time;
`mujoco_*.py` and `mjx_*.py` are the two physics; `streaming.py` runs any number of episodes through them.
"""

from agile_jax.simulation.closed_loop import ClosedLoop, Episode
from agile_jax.simulation.mjx_physics import Implementation, check_warp, mjx_init
from agile_jax.simulation.mjx_slots import MjxSlots, mjx_loop
from agile_jax.simulation.mujoco_physics import MujocoPhysics
from agile_jax.simulation.mujoco_slots import MujocoSlots, batch_loop
from agile_jax.simulation.outcome import OUTCOME_NAMES, SUCCESS, UNSTABLE, Outcome
from agile_jax.simulation.paths import PathPlanner, TimedPath, path_guidance
from agile_jax.simulation.reference import Guidance, policy_guidance
from agile_jax.simulation.sensed import Sensed
from agile_jax.simulation.streaming import Rollout, Slots, gather, stream
from agile_jax.simulation.traces import LastStates, Recorder, Trace

__all__ = [
    "OUTCOME_NAMES",
    "SUCCESS",
    "UNSTABLE",
    "ClosedLoop",
    "Episode",
    "Guidance",
    "Implementation",
    "LastStates",
    "MjxSlots",
    "MujocoPhysics",
    "MujocoSlots",
    "Outcome",
    "PathPlanner",
    "Recorder",
    "Rollout",
    "Sensed",
    "Slots",
    "TimedPath",
    "Trace",
    "batch_loop",
    "check_warp",
    "gather",
    "mjx_init",
    "mjx_loop",
    "path_guidance",
    "policy_guidance",
    "stream",
]
