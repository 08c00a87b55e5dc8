"""One recorded episode of the robot: how it ended, its motion, its picture and its film."""

import dataclasses
import pathlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from agile_jax import evaluation, report
from agile_jax.experiment import Experiment
from agile_jax.robot import trunk_pose
from agile_jax.scene import make_scene
from agile_jax.settings import BadInput

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from agile_jax.simulation import Trace


@dataclasses.dataclass(frozen=True, repr=False)
class RecordedEpisode:
    """An episode of K moments, one for each plan of the controller.

    Attributes:
        experiment: its scene and robot.
        trace: the motion: time, coordinates, velocities, torques, reference, clearance.
        summary: outcome, times and quality, with units in the names.
    """

    experiment: Experiment
    trace: "Trace"
    summary: Mapping[str, object]

    @property
    def outcome(self) -> str:
        """How it ended: success, collision, fall, timeout or unstable; "" of a recording that does not say."""
        return str(self.summary.get("outcome", ""))

    @property
    def poses(self) -> Float[np.ndarray, "k 4"]:
        """[x, y, z, yaw] of the trunk [m, rad]."""
        return trunk_pose(self.trace.qpos)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the trunk's path and the scene from above; without `ax` on a new figure, `ax.figure`."""
        scene, label = make_scene(self.experiment.scene), f"robot: {self.outcome or 'recorded'}"
        return report.draw_plan(report.new_axes() if ax is None else ax, scene, {label: self.trace})

    def video(self, file: pathlib.Path | str) -> str | None:
        """Film it to an mp4 in real time.

        Returns:
            None, or one line: why the pictures are drawings, and what to install for rendered ones.

        Raises:
            BadInput: no moment of it is finite.
        """
        if not len(self.trace.time):
            raise BadInput("no sample is finite, so there is nothing to film")
        file = pathlib.Path(file)
        file.parent.mkdir(parents=True, exist_ok=True)
        return report.render_video(
            self.experiment.scene, self.experiment.robot, self.trace, file, self.experiment.report
        )

    def __repr__(self) -> str:
        return f"RecordedEpisode({self.outcome or 'recorded'}, {len(self.trace.time)} moments)"


def load_recording(experiment: Experiment, file: pathlib.Path) -> RecordedEpisode:
    """A recorded episode: `evaluation/<backend>-unstable/episode-N.npz`, or the first of `-traces.npz`.

    Its trace ends before the first sample that is not finite, its summary says where that is.

    Raises:
        BadInput: no such recording.
    """
    trace = evaluation.load_traces(file)[0]
    finite = np.isfinite(trace.qpos).all(-1) & np.isfinite(trace.qvel).all(-1)
    sound = len(finite) if finite.all() else int(np.argmin(finite))
    shown = type(trace)(*(values[:sound] for values in trace))
    summary: dict[str, object] = {"from_s": float(trace.time[0]), "to_s": float(trace.time[-1])}
    summary["first_bad_sample_s"] = None if finite.all() else float(trace.time[sound])
    if sound:
        summary |= {
            "last_good_height_m": float(shown.qpos[-1, 2]),
            "largest_speed_m_s": float(np.linalg.norm(shown.qvel[:, :3], axis=-1).max()),
            "largest_joint_speed_rad_s": float(np.abs(shown.qvel[:, 6:]).max()),
            "largest_torque_nm": float(np.nanmax(np.abs(shown.torque))),
            "reference_is_finite": bool(np.isfinite(trace.reference).all()),
        }
    return RecordedEpisode(experiment, shown, summary)
