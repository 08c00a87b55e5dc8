"""Figures of the learned field: error by epoch, and streamlines seen from above and from the side."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from agile_jax.report.figures.scene_drawing import draw_obstacles, draw_target
from agile_jax.report.figures.style import BLUE, GREY, ORANGE, color_bar, dress, legend, new_figure
from agile_jax.scene import POSE_SIZE, Scene, clearance

SURROUNDINGS = 1.8  # [m] around target and obstacles, in which the field is drawn
SPEED, ACCELERATION = "speed in this view [m/s]", "acceleration in this view [m/s²]"
Field: TypeAlias = Callable[[np.ndarray], np.ndarray]  # poses (n, 4) -> velocities (n, 4) [m/s, rad/s]


class _Section(NamedTuple):
    """The field on a plane through space; NaN where the torso would touch an obstacle."""

    across: Float[np.ndarray, " w"]  # [m]
    up: Float[np.ndarray, " h"]  # [m]
    velocity: Float[np.ndarray, "h w 2"]  # along the plane [m/s]

    @property
    def fastest(self) -> float:
        """The greatest speed [m/s]."""
        return max(float(np.nanmax(np.linalg.norm(self.velocity, axis=-1))), 1e-6)


def draw_learning_curve(
    ax: Axes,
    rows: Sequence[Mapping[str, object]],
    noise_floor: float | None = None,
    unit: str = "(m/s)², yaw: (rad/s)²",
) -> Axes:
    """Train and validation error by epoch on a logarithmic scale, with the labels' noise floor.

    Args:
        ax: is drawn on.
        rows: one object per epoch with `epoch`, `train_mse` and `validation_mse`, means over the four outputs.
        noise_floor: of the labels, or None.
        unit: of the errors and the floor.

    Returns:
        `ax`.
    """
    dress(ax, "epoch", f"mean squared error\n[{unit}]")
    for key, label, color, dash in (("train_mse", "train", BLUE, "-"), ("validation_mse", "validation", ORANGE, "--")):
        pairs = [(row.get("epoch"), row.get(key)) for row in rows]
        points = [(x, y) for x, y in pairs if isinstance(x, int | float) and isinstance(y, int | float)]
        points = [point for point in points if np.isfinite(point).all()]
        if points:
            epochs, errors = np.array(points, float).T
            marker = "o" if len(points) < 30 else None
            ax.plot(epochs, errors, dash, color=color, linewidth=1.6, marker=marker, markersize=3, label=label)
    if noise_floor is not None and noise_floor > 0:
        ax.axhline(noise_floor, color=GREY, linewidth=1.2, linestyle=":", label="noise floor of the labels")
    ax.set_yscale("log")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    if ax.get_legend_handles_labels()[0]:
        legend(ax)
    return ax


def velocity_field_figure(scene: Scene, velocity: Field, heights: Mapping[str, float], amount: str = SPEED) -> Figure:
    """Streamlines of the field in planes at several heights [m], by their title, at the target's yaw.

    One plane is below the other, with the same colours for the amount. Nothing is drawn where the torso would touch an
    obstacle.
    """
    figure = new_figure(7.4, 3.9 * len(heights) + 0.4)
    panels = np.atleast_1d(figure.subplots(len(heights), 1, sharex=True))
    sections = [_section_above(scene, velocity, height) for height in heights.values()]
    fastest = max(section.fastest for section in sections)
    for ax, title, section in zip(panels, heights, sections, strict=True):
        _draw_above(ax, scene, section, fastest)
        ax.set_title(title, fontsize=10, loc="left")
        ax.set_xlabel("")
    panels[-1].set_xlabel("x [m]", fontsize=9)
    _amount_bar(list(panels), fastest, amount)
    return figure


def draw_velocity_field_side(ax: Axes, scene: Scene, velocity: Field, amount: str = SPEED) -> Axes:
    """Streamlines of the field in the vertical plane along x through the target, at its yaw. Returns `ax`."""
    low, high = _extent(scene)
    x, z = np.linspace(low[0], high[0], 121), np.linspace(scene.lower[2], scene.upper[2], 41)
    section = _section(scene, velocity, x, z, (0, 2), scene.target)
    dress(ax, "x [m]", "height of the torso's centre [m]")
    _stream(ax, section, section.fastest, density=(1.6, 0.8))
    draw_target(ax, scene, "side")
    ax.set_ylim(z[0], z[-1])
    _amount_bar(ax, section.fastest, amount)
    return ax


def _extent(scene: Scene) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Least and greatest x, y [m] of the part of the plane in which the field is drawn."""
    places = np.vstack([scene.target[:2], scene.obstacle_centers[:, :2]])
    low = np.maximum(places.min(0) - SURROUNDINGS, scene.lower[:2])
    return low, np.minimum(places.max(0) + SURROUNDINGS, scene.upper[:2])


def _section_above(scene: Scene, velocity: Field, height: float) -> _Section:
    low, high = _extent(scene)
    pose = np.array([*scene.target[:2], height, scene.target[3]])
    return _section(scene, velocity, np.linspace(low[0], high[0], 61), np.linspace(low[1], high[1], 43), (0, 1), pose)


def _section(
    scene: Scene, velocity: Field, across: np.ndarray, up: np.ndarray, axes: tuple[int, int], pose: np.ndarray
) -> _Section:
    """The field where two coordinates of `pose`, those named by `axes`, run over a grid."""
    poses = np.tile(pose, (len(up), len(across), 1))
    poses[..., axes[0]], poses[..., axes[1]] = np.meshgrid(across, up)
    field = np.asarray(velocity(poses.reshape(-1, POSE_SIZE)), float).reshape(poses.shape)[..., axes]
    return _Section(across, up, np.where((clearance(scene, poses) < 0)[..., None], np.nan, field))


def _draw_above(ax: Axes, scene: Scene, section: _Section, fastest: float) -> None:
    dress(ax, "x [m]", "y [m]")
    draw_obstacles(ax, scene, "above", alpha=0.35)
    _stream(ax, section, fastest, density=1.3)
    draw_target(ax, scene, "above")
    ax.set_aspect("equal")
    ax.set_ylim(section.up[0], section.up[-1])


def _stream(ax: Axes, section: _Section, fastest: float, density: float | tuple[float, float]) -> None:
    ax.streamplot(
        section.across,
        section.up,
        section.velocity[..., 0],
        section.velocity[..., 1],
        color=np.linalg.norm(section.velocity, axis=-1),
        cmap="viridis",
        norm=Normalize(0.0, fastest),
        density=density,
        linewidth=0.9,
        arrowsize=0.8,
    )
    ax.set_xlim(section.across[0], section.across[-1])


def _amount_bar(axes: Axes | list[Axes], greatest: float, amount: str) -> None:
    color_bar(ScalarMappable(Normalize(0.0, greatest), "viridis"), axes, amount)
