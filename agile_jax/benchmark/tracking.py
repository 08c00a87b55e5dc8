"""`agile benchmark tracking`: does the controller do what it is told, and does it survive what it does not know?

Random commands on flat ground in C MuJoCo, every episode from standing at 0.28 m. Tracking: the command is met
where the robot does not fall, the velocity error in the plane is at most 0.1 m/s (root mean square over all physics
steps) and the height is never further than 1 cm from the commanded one; both from one second after the start.
Robustness: the same commands with one disturbance each, of physics, actuation or sensing, that the controller is not
told about (benchmark/workloads/disturbance.py); counted is who does not fall. Intervals are Wilson's at 95 %.
"""

from typing import NamedTuple

import numpy as np

from agile_jax.benchmark.metrics import Result, table
from agile_jax.benchmark.workloads.commands import random_commands
from agile_jax.benchmark.workloads.disturbance import Disturbance, SensorNoise
from agile_jax.benchmark.workloads.tracking import UNDISTURBED, track_commands, tracking_loop
from agile_jax.control import Counts, make_controller
from agile_jax.evaluation.statistics import wilson_interval
from agile_jax.experiment import Experiment
from agile_jax.progress import Progress, silent
from agile_jax.robot import PlantSettings, load_robot

METHOD = " ".join((__doc__ or "").partition("\n\n")[2].split())
START_HEIGHT = 0.28  # [m]
VELOCITY_TOLERANCE = 0.1  # [m/s]
HEIGHT_TOLERANCE = 0.01  # [m]
DEGREE = np.pi / 180


class CommandRanges(NamedTuple):
    """Ranges of uniform commands."""

    forward: tuple[float, float]  # [m/s]
    sideways: float  # +- [m/s]
    yaw_rate: float  # +- [rad/s]
    height: float  # [m]


NOMINAL = CommandRanges((0.0, 1.2), 0.5, 1.0, START_HEIGHT)
TRACKING = {
    "forward to 1.2, sideways +-0.5, turning +-1": NOMINAL,
    "at 0.17 m, forward to 0.5": CommandRanges((0.0, 0.5), 0.0, 0.0, 0.17),
    "at 0.17 m, forward to 0.8": CommandRanges((0.0, 0.8), 0.0, 0.0, 0.17),
}
ROBUSTNESS = {
    "push of 6 N s from the side": Disturbance(impulse=6.0),
    "push of 12 N s from the side": Disturbance(impulse=12.0),
    "foot friction 0.4": Disturbance(plant=PlantSettings(foot_friction=0.4)),
    "trunk's mass 20 % more or less": Disturbance(trunk_mass=0.2),
    "trunk's centre of mass 3 cm off": Disturbance(com_offset=0.03),
    "joint damping and friction x 0.5": Disturbance(plant=PlantSettings(joint_damping=0.5, joint_friction=0.5)),
    "joint damping and friction x 2": Disturbance(plant=PlantSettings(joint_damping=2.0, joint_friction=2.0)),
    "rotors' inertia x 0.25": Disturbance(plant=PlantSettings(armature=0.25)),
    "rotors' inertia x 2": Disturbance(plant=PlantSettings(armature=2.0)),
    # Unitree gives the A1's joints 21 rad/s at most.
    "torque falls from 10.5 rad/s to none at 21 rad/s": Disturbance(plant=PlantSettings(no_load_speed=21.0)),
    "torque noise 5 %": Disturbance(torque_noise=0.05),
    # Xsens: the MTi-30's 0.5 degrees of roll and pitch moving, 1 of yaw; the MTi-1's gyroscope, 0.007 deg/s/sqrt(Hz)
    # over 255 Hz.
    "noise of an IMU": Disturbance(noise=SensorNoise((0.5 * DEGREE, 0.5 * DEGREE, DEGREE), 0.002)),
    # MuJoCo Playground's observation noise for the Go1 is uniform: gravity 0.05, gyroscope 0.2, velocity 0.1, joints
    # 0.03 and 1.5. Here normal, with the same standard deviations, anew at every step but for the orientation.
    "noise of MuJoCo Playground": Disturbance(noise=SensorNoise((0.03, 0.03, 0.0), 0.115, 0.058, 0.0173, 0.87)),
    "control delay of 10 ms": Disturbance(plant=PlantSettings(delay=0.01)),
}


def benchmark_tracking(
    experiment: Experiment,
    episodes: int,
    duration: float,
    disturbed_duration: float,
    threads: int = 2,
    progress: Progress = silent,
) -> Result:
    """Measure, and return what goes into the JSON file.

    Args:
        experiment: control, robot and seed.
        episodes: of every row.
        duration: of a tracking episode [s].
        disturbed_duration: of an episode of the robustness rows [s].
        threads: of the physics.
        progress: is told of the rows done.
    """
    rows: dict[str, Result] = {}
    rows_in_all = len(TRACKING) + len(ROBUSTNESS)
    robot = load_robot(experiment.robot)
    undisturbed = tracking_loop(robot, experiment.control, UNDISTURBED, make_controller(robot, experiment.control))
    jobs = [(name, ranges, UNDISTURBED, duration) for name, ranges in TRACKING.items()]
    jobs += [(name, NOMINAL, disturbance, disturbed_duration) for name, disturbance in ROBUSTNESS.items()]
    for done, (name, ranges, disturbance, seconds) in enumerate(jobs):
        progress("tracking", done, rows_in_all, name)
        columns = track_commands(
            undisturbed.disturbed(disturbance),
            random_commands(episodes, experiment.seed, *ranges),
            seconds,
            experiment.robot,
            start_height=START_HEIGHT,
            seed=experiment.seed,
            threads=threads,
        )
        rows[name] = summary(columns) | {"disturbed": disturbance != UNDISTURBED, "seconds": seconds}
    return {"benchmark": "tracking", "experiment": experiment.name, "method": METHOD, "rows": rows}


def summary(columns: dict[str, np.ndarray]) -> Result:
    """One row of the table from the columns of its episodes."""
    survived = np.isinf(columns["fall_time"])
    met = survived & (columns["velocity_rms"] <= VELOCITY_TOLERANCE)
    met &= columns["height_error_max"] <= HEIGHT_TOLERANCE
    low, high = wilson_interval(int(survived.sum()), len(survived))
    return {
        "episodes": len(survived),
        "survived": int(survived.sum()),
        "survival_low": low,
        "survival_high": high,
        "met": int(met.sum()),
        "velocity_rms_median_m_s": float(np.median(columns["velocity_rms"])),
        "velocity_rms_p99_m_s": float(np.quantile(columns["velocity_rms"], 0.99)),
        "height_error_max_median_m": float(np.median(columns["height_error_max"])),
        "height_error_max_p99_m": float(np.quantile(columns["height_error_max"], 0.99)),
        "tilt_max_rad": float(columns["tilt_max"].max()),
        "cone_violation_max_n": float(columns["cone_violation"].max()),
        "torque_share_max": float(columns["torque_share"].max()),
        "joint_violation_max_rad": float(columns["joint_violation"].max()),
        **{name: int(columns[name].sum()) for name in Counts._fields},
    }


def report(result: Result) -> str:
    """The rows as a table, with the method."""
    names = ("survived", "95 % [%]", "met", "v error", "p99", "z error [mm]", "p99", "tilt [deg]", "joint past [mrad]")
    lines = []
    for name, row in result["rows"].items():
        cells = (
            f"{row['survived']} of {row['episodes']}",
            f"{100 * row['survival_low']:.1f} to {100 * row['survival_high']:.1f}",
            "" if row["disturbed"] else f"{row['met']} of {row['episodes']}",
            f"{row['velocity_rms_median_m_s']:.3f}",
            f"{row['velocity_rms_p99_m_s']:.3f}",
            f"{1e3 * row['height_error_max_median_m']:.1f}",
            f"{1e3 * row['height_error_max_p99_m']:.1f}",
            f"{row['tilt_max_rad'] / DEGREE:.1f}",
            f"{1e3 * row['joint_violation_max_rad']:.1f}",
        )
        lines.append((name, cells))
    return f"{table(names, lines)}\n\n{result['method']}"
