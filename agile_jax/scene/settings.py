"""Settings of the scene: the target, the obstacles, the torso's envelope and where the robot starts."""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field, SerializeAsAny, WrapValidator, model_validator

from agile_jax.plugins import by_kind
from agile_jax.settings import (
    NonNegative,
    NonNegativePose,
    Pose,
    PoseBound,
    Positive,
    PositiveVector2,
    PositiveVector3,
    Settings,
    Vector2,
    Vector3,
    Yaw,
)

OBSTACLES = ("table", "box")
CONVEX = 1e-6  # [1/s] up to which slopes of the top speed may fall: rounding
Numbers = Annotated[tuple[Positive, ...], Field(strict=False)]
POSE_NAMES = ("x", "y", "z", "yaw")  # the planned pose s [m, m, m, rad]


class Box(NamedTuple):
    """A part of an obstacle, turned by the obstacle's yaw about its own centre."""

    center: tuple[float, float, float]
    """In the world [m]."""
    half_size: tuple[float, float, float]
    """Along its own axes [m]."""


class ObstacleSettings(Settings):
    """Base of all kinds of obstacles: what an obstacle is made of."""

    kind: str
    """Which kind of obstacle: "table", "box", or one of a plugin (docs/extending.md)."""
    yaw: Yaw = 0.0
    """Turn about the vertical [rad]."""

    def boxes(self) -> list[Box]:
        """The boxes that the obstacle is made of, all turned by `yaw`.

        The first one's outline, seen from above, holds the others: a table's slab, then its legs.
        """
        raise NotImplementedError


class TableSettings(ObstacleSettings):
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
    leg_size: PositiveVector2 | None = None
    """Full size of each leg along x and y [m]; without it the table has no legs."""
    leg_inset: NonNegative = 0.0
    """Distance from the table's edges to the legs [m]."""

    def boxes(self) -> list[Box]:
        """The slab, then its legs."""
        (x, y), (length, width) = self.position, self.size
        low, high = self.underside, self.top
        found = [Box((x, y, (low + high) / 2), (length / 2, width / 2, (high - low) / 2))]
        if self.leg_size is not None:
            half = (self.leg_size[0] / 2, self.leg_size[1] / 2, low / 2)
            reach = (length / 2 - self.leg_inset - half[0], width / 2 - self.leg_inset - half[1])
            cos, sin = np.cos(self.yaw), np.sin(self.yaw)
            for along, across in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                dx, dy = along * reach[0], across * reach[1]
                found.append(Box((x + cos * dx - sin * dy, y + sin * dx + cos * dy, low / 2), half))
        return found

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


class BoxSettings(ObstacleSettings):
    """A full box."""

    kind: Literal["box"]
    """Tells boxes from tables."""
    position: Vector3
    """Centre [m]."""
    size: PositiveVector3
    """Full size along x, y and z [m]."""

    def boxes(self) -> list[Box]:
        """The box itself."""
        x, y, z = (size / 2 for size in self.size)
        return [Box(self.position, (x, y, z))]


AnyObstacle = Annotated[
    SerializeAsAny[Annotated[TableSettings | BoxSettings, Field(discriminator="kind")]],
    WrapValidator(by_kind("obstacle", *OBSTACLES)),
]


class StartSettings(Settings):
    """Normal distribution of the start pose [x, y, z, yaw] [m, rad].

    The paper's N([0.5, 0.066, 0.026], [0.5, 0.66, 0.02]) is read with standard deviations, and its mean height 0.026
    as a slip for 0.26: 2.6 cm would put the torso inside the floor. The paper's starts have no spread in yaw.
    """

    mean: Pose = (0.5, 0.066, 0.26, 0.0)
    """Mean of the start pose [m, rad]."""
    std: NonNegativePose = (0.5, 0.66, 0.02, 0.0)
    """Standard deviations of the start pose [m, rad]."""


class CrouchSettings(Settings):
    """How low the robot can walk, and how fast at each height: what its legs allow (crouch.py).

    The defaults stand for an A1 that never crouches so low that its speed is limited.
    """

    by: Literal["legs", "hand"] = "legs"
    """legs: an experiment works out the numbers below from robot and gait, whatever they say. hand: they are given."""
    lowest: Positive = 0.155
    """Lowest height of the torso at which the robot can walk [m]."""
    heights: Numbers = ()
    """Heights at which the top speed is given, increasing [m]; in between, and beyond, it is linear."""
    speeds: Numbers = ()
    """Top speed along x and along y at each of the heights, increasing and convex [m/s]."""

    @model_validator(mode="after")
    def _speeds_are_convex(self) -> "CrouchSettings":
        heights, speeds = np.array(self.heights), np.array(self.speeds)
        if len(heights) != len(speeds) or len(heights) == 1:
            raise ValueError(
                f"heights and speeds must be equally many, none or at least two, not {len(heights)} and {len(speeds)}"
            )
        if (np.diff(heights) <= 0).any():
            raise ValueError(f"heights = {list(self.heights)} must increase")
        slopes = np.diff(speeds) / np.diff(heights)
        if (slopes <= 0).any() or (np.diff(slopes) < -CONVEX).any():
            raise ValueError(f"speeds = {list(self.speeds)} must increase with the heights, and ever faster (convex)")
        return self


class SceneSettings(Settings):
    """The world of the plan. Defaults are the paper's scene.

    The torso's envelope covers trunk, head, hips and the roots of the thighs of the A1 (robot/a1.xml): at table
    height these are what can hit its edge. The paper gives no size of the table, no bounds and no envelope.
    """

    target: Pose = (3.0, 0.0, 0.28, 0.0)
    """Target pose [x, y, z, yaw] [m, rad]."""
    torso_half_size: PositiveVector3 = (0.28, 0.155, 0.058)
    """Half size of the torso's envelope along its own x, y and z [m]."""
    lower: PoseBound = (-1.5, -3.0, 0.0, -3.2)
    """Lower bounds of the planned pose [m, rad]; a z of 0 stands for the lowest at which the robot can walk."""
    upper: PoseBound = (4.5, 3.0, 0.32, 3.2)
    """Upper bounds of the planned pose [m, rad]; where the bounds of yaw span a full turn, yaw is unbounded."""
    crouch: CrouchSettings = CrouchSettings()
    """How low the robot can walk, and how fast there."""
    start: StartSettings = StartSettings()
    """Where the robot starts."""
    obstacles: Annotated[tuple[AnyObstacle, ...], Field(strict=False)] = ()
    """Tables and boxes."""

    @model_validator(mode="after")
    def _bounds_hold_something(self) -> "SceneSettings":
        x, y, z, yaw = self.lower
        for name, low, high in zip(POSE_NAMES, (x, y, z or self.crouch.lowest, yaw), self.upper, strict=True):
            if not low < high:
                raise ValueError(f"lower = {low} must be below upper = {high} for {name}")
        return self
