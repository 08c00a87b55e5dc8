"""The camera both renderers share, and which moments of an episode they show."""

from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, UInt8

from agile_jax.report.under_obstacles import underside_above
from agile_jax.scene import Scene

AZIMUTH = 90.0  # [deg] MuJoCo's convention: the camera looks along +y, x runs to the right
ELEVATION = -4.0  # [deg] so slightly from above that one sees below the near edge of the slab
FIELD_OF_VIEW = 24.0  # [deg] vertical; narrow, so that the picture is nearly orthographic
VIEW_HEIGHT = 1.25  # [m] seen at the point looked at
_ASIDE = 0.36  # [m] from the obstacle's edge to the trunk, in the first and the last snapshot
LOOK_HEIGHT = 0.25  # [m] of the point looked at
SEE_THROUGH = 0.5  # greatest opacity of what stands in the scene

Picture: TypeAlias = UInt8[np.ndarray, "height width 3"]  # RGB


class Shot(NamedTuple):
    """F pictures: the robot's configuration, where the camera looks, and the words in the corner."""

    qpos: Float[np.ndarray, "F nq"]  # [m, rad]
    look_at: Float[np.ndarray, "F 3"]  # [m]
    captions: list[str]


def join(first: Shot, second: Shot) -> Shot:
    """The pictures of both, in order."""
    return Shot(
        np.concatenate([first.qpos, second.qpos]),
        np.concatenate([first.look_at, second.look_at]),
        first.captions + second.captions,
    )


def axes_of_view() -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Right, up and forward of the camera in the world."""
    a, e = np.radians(AZIMUTH), np.radians(ELEVATION)
    forward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([np.sin(a), -np.cos(a), 0.0])
    return right, np.cross(right, forward), forward


def film(
    time: Float[np.ndarray, " K"], qpos: Float[np.ndarray, "K nq"], frames_per_second: int, longest: float
) -> Shot:
    """The whole episode in real time, the camera gliding along with the robot.

    Args:
        time: increasing [s].
        qpos: the configurations at these times [m, rad].
        frames_per_second: pictures for a second of the episode.
        longest: the end of the episode is cut after this time [s].
    """
    moments = np.arange(0.0, min(float(time[-1] - time[0]), longest) + 1e-9, 1.0 / frames_per_second)
    rows = np.abs(time[None, :] - time[0] - moments[:, None]).argmin(1)
    width = max(1, round(0.8 * frames_per_second)) // 2
    padded = np.pad(qpos[rows, :2], ((width, width), (0, 0)), mode="edge")
    smooth = np.stack([padded[i : i + len(rows)] for i in range(2 * width + 1)]).mean(0)  # (F, 2)
    look_at = np.concatenate([smooth, np.full((len(rows), 1), LOOK_HEIGHT)], 1)
    captions = [f"{moment:5.2f} s   trunk at {qpos[row, 2]:.2f} m" for moment, row in zip(moments, rows, strict=True)]
    return Shot(qpos[rows], look_at, captions)


def snapshots(scene: Scene, time: Float[np.ndarray, " K"], qpos: Float[np.ndarray, "K nq"]) -> Shot:
    """Four pictures: before the obstacle, entering, under it, after it; at equal times where nothing was passed under.

    The camera stands still beside the obstacle, so that the pictures can be compared.
    """
    underneath = np.flatnonzero(np.isfinite(underside_above(scene, qpos[:, :3])))
    if not len(underneath):
        rows = np.linspace(0, len(time) - 1, 4).astype(int)
        look_at = np.column_stack([qpos[rows, :2], np.full(4, LOOK_HEIGHT)])
        names = ["", "", "", ""]
    else:
        first, last = int(underneath[0]), int(underneath[-1])
        middle = (qpos[first, :2] + qpos[last, :2]) / 2
        distance = np.linalg.norm(qpos[:, :2] - middle, axis=1)
        half = np.linalg.norm(qpos[first, :2] - qpos[last, :2]) / 2
        before = int(np.abs(distance[: first + 1] - half - _ASIDE).argmin())
        after = last + int(np.abs(distance[last:] - half - _ASIDE).argmin())
        under = first + int(distance[first : last + 1].argmin())
        rows = np.array([before, first, under, after])
        look_at = np.tile([*middle, LOOK_HEIGHT], (4, 1))
        names = ["before  ", "entering  ", "under  ", "after  "]
    captions = [
        f"{name}{time[row] - time[0]:.2f} s   trunk at {qpos[row, 2]:.2f} m"
        for name, row in zip(names, rows, strict=True)
    ]
    return Shot(qpos[rows], look_at, captions)
