"""Settings for another robot from those of the A1, by dynamic similarity.

The settings are written for the A1: mass m, leg length l. On a robot of mass a m and legs b l the same motion is
lengths times b, times times sqrt(b), forces times a, torques times a b; a joint's stiffness then scales with a b, its
damping with a b^(3/2), and the weight of forces in the MPC with 1 / a^2, so that they count as much beside the motion.
"""

import math

from agile_jax.control.settings import ControlSettings
from agile_jax.robot import RobotModel, RobotSettings, load_robot


def scaled_to(robot: RobotModel, settings: ControlSettings) -> ControlSettings:
    """The settings as this robot needs them; for the A1, or with scale_to_robot off, as they are."""
    a1 = load_robot(RobotSettings())
    mass = float(robot.link_masses.sum() / a1.link_masses.sum())
    length = (robot.thigh_length + robot.calf_length) / (a1.thigh_length + a1.calf_length)
    if not settings.scale_to_robot or (math.isclose(mass, 1.0, rel_tol=1e-6) and math.isclose(length, 1.0)):
        return settings
    time = math.sqrt(length)
    gait, mpc = settings.gait, settings.mpc
    return settings.model_copy(
        update={
            "gait": gait.model_copy(
                update={
                    "period": gait.period * time,
                    "slow_period": gait.slow_period * time,
                    "shortest_period": gait.shortest_period * time,
                    "walk_period": gait.walk_period * time,
                    "step_height": gait.step_height * length,
                    "slow_step_height": gait.slow_step_height * length,
                }
            ),
            "mpc": mpc.model_copy(
                update={
                    "weight_force": mpc.weight_force / mass**2,
                    "force_max": mpc.force_max * mass,
                    "tolerance": mpc.tolerance * mass,
                }
            ),
            "raibert_gain": settings.raibert_gain * time,
            "swing_stiffness": settings.swing_stiffness * mass * length,
            "swing_damping": settings.swing_damping * mass * length * time,
            "integral_limit": (settings.integral_limit[0] * length, *settings.integral_limit[1:]),
        }
    )
