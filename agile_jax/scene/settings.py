"""Settings of the scene: the target, the obstacles, the torso's envelope and where the robot starts."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from agile_jax.settings import (
    NonNegative,
    NonNegativePose,
    Pose,
    Positive,
    PositiveVector2,
    PositiveVector3,
    Settings,
    Vector2,
    Vector3,
)


class TableSettings(Settings):
    """A slab that blocks everything above `underside`, up to `top`. The robot may pass below, between the legs.

    The four legs stand in the corners, `leg_inset` within the edges. Without a size of legs there are none, as for the
    paper's table.
    """

    kind: Literal["table"]
    """Tells tables from boxes."""
    position: Vector2
    """Centre in the plane [m]."""
    size: PositiveVector2
    """Full size along x and y [m]."""
    underside: Positive
    """Height of the slab's underside [m]."""
    top: Positive = 0.75
    """Height of the slab's top, above everything the robot reaches [m]."""
    yaw: float = 0.0
    """Turn about the vertical [rad]."""
    leg_size: PositiveVector2 | None = None
    """Full size of each leg along x and y [m]; without it the table has no legs."""
    leg_inset: NonNegative = 0.0
    """Distance from the table's edges to the legs [m]."""

    @model_validator(mode="after")
    def _legs_fit(self) -> "TableSettings":
        if self.leg_size is None:
            if self.leg_inset:
                raise ValueError(f"leg_inset = {self.leg_inset} needs a leg_size = [.., ..]: the table has no legs")
            return self
        for name, size, leg in zip(("x", "y"), self.size, self.leg_size, strict=True):
            if 2 * (self.leg_inset + leg) >= size:
                raise ValueError(
                    f"leg_size = {list(self.leg_size)} with leg_inset = {self.leg_inset} leaves nothing between the "
                    f"legs along {name}: twice their sum must be below size {size}"
                )
        return self

    @model_validator(mode="after")
    def _top_is_above(self) -> "TableSettings":
        if self.top <= self.underside:
            raise ValueError(f"top = {self.top} must be above underside = {self.underside}")
        return self


class BoxSettings(Settings):
    """A full box."""

    kind: Literal["box"]
    """Tells boxes from tables."""
    position: Vector3
    """Centre [m]."""
    size: PositiveVector3
    """Full size along x, y and z [m]."""
    yaw: float = 0.0
    """Turn about the vertical [rad]."""


ObstacleSettings = Annotated[TableSettings | BoxSettings, Field(discriminator="kind")]


class StartSettings(Settings):
    """Normal distribution of the start pose [x, y, z, yaw] [m, rad].

    The paper's N([0.5, 0.066, 0.026], [0.5, 0.66, 0.02]) is read with standard deviations, and its mean height 0.026
    as a slip for 0.26: 2.6 cm would put the torso inside the floor. The paper's starts have no spread in yaw.
    """

    mean: Pose = (0.5, 0.066, 0.26, 0.0)
    """Mean of the start pose [m, rad]."""
    std: NonNegativePose = (0.5, 0.66, 0.02, 0.0)
    """Standard deviations of the start pose [m, rad]."""


class SceneSettings(Settings):
    """The world of the plan. Defaults are the paper's scene.

    The torso's envelope covers trunk, head, hips and the roots of the thighs of the A1 (robot/a1.xml): at table
    height these are what can hit its edge. The paper gives no size of the table, no bounds and no envelope.
    """

    target: Pose = (3.0, 0.0, 0.28, 0.0)
    """Target pose [x, y, z, yaw] [m, rad]."""
    torso_half_size: PositiveVector3 = (0.28, 0.155, 0.058)
    """Half size of the torso's envelope along its own x, y and z [m]."""
    lower: Pose = (-1.5, -3.0, 0.155, -3.2)
    """Lower bounds of the planned pose [m, rad]."""
    upper: Pose = (4.5, 3.0, 0.32, 3.2)
    """Upper bounds of the planned pose [m, rad]; where the bounds of yaw span a full turn, yaw is unbounded."""
    start: StartSettings = StartSettings()
    """Where the robot starts."""
    obstacles: Annotated[tuple[ObstacleSettings, ...], Field(strict=False)] = ()
    """Tables and boxes."""

    @model_validator(mode="after")
    def _target_is_reachable(self) -> "SceneSettings":
        from agile_jax.scene.scene import clearance, make_scene

        for name, low, high, value in zip(("x", "y", "z", "yaw"), self.lower, self.upper, self.target, strict=True):
            if not low < high:
                raise ValueError(f"lower = {low} must be below upper = {high} for {name}")
            if not low <= value <= high:
                raise ValueError(f"target {name} = {value} is outside the bounds [{low}, {high}]")
        scene = make_scene(self)
        distance = float(clearance(scene, scene.target))
        if distance <= 0:
            raise ValueError(
                f"target = {list(self.target)} puts the torso inside an obstacle "
                f"(clearance {distance:.3f} m); it must be free"
            )
        return self
