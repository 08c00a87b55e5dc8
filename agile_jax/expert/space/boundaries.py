"""Where routes go over from one region to the next.

The boundary between two regions is pinned to a face: where the path last leaves the old region, or first enters the
new one. Either exists on every path along the route, so the pin costs nothing, and it takes away the freedom to switch
anywhere in the overlap, which would make the labels ambiguous.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.space.faces import CONTAINMENT, Face, Side
from agile_jax.expert.space.polygons import Polygon, clip
from agile_jax.expert.space.regions import FreeSpace, Region, clip_by_sides


class Boundary(NamedTuple):
    """Where a route goes over from one phase to the next."""

    pin: Face
    lower: tuple[float, ...]  # (4,) box around it, of the pose
    upper: tuple[float, ...]  # (4,)


def find_boundaries(space: FreeSpace, obstacle: int, a: Region, b: Region, priority: Sequence[int]) -> list[Boundary]:
    """Where a path goes over from one region to another: on the faces of the old or of the new side of the obstacle
    that pass through their intersection; empty when there are none.

    Every path last leaves the old side through one of its faces, and first enters the new one through one of its own:
    whichever side has fewer serves.

    Args:
        priority: axes, those to be pinned on first.
    """
    low, high = np.maximum(a.lower, b.lower), np.minimum(a.upper, b.upper)
    if (low > high).any():
        return []
    sides = [space.sides[obstacle][region.sides[obstacle]] for region in (a, b)]
    choices = [_only_of(side, other) for side, other in (sides, sides[::-1])]
    for pins in sorted(filter(None, choices), key=lambda pins: (len(pins), priority.index(pins[0].axis))):
        boxes = [(pin, _pinned_box(space, pin, b, a.polygon, low.copy(), high.copy())) for pin in pins]
        found = [Boundary(pin, tuple(box[0].tolist()), tuple(box[1].tolist())) for pin, box in boxes if box is not None]
        if found:
            return found
    return []


def _only_of(side: Side, other: Side) -> Sequence[Face]:
    """The faces of a side that another side of the obstacle has not; empty when paths cannot be pinned to all."""
    own: Sequence[Face] = side.faces
    if len(own) > 1:  # one face is never that of another side alone
        others = {(*face.normal, face.value) for face in other.faces}
        own = [face for face in own if (*face.normal, face.value) not in others]
    return own if all(face.normal.any() for face in own) else ()


def _pinned_box(
    space: FreeSpace, pin: Face, other: Region, polygon: Polygon, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The box around where a face, for some yaw, passes through the intersection of a region's polygon, another region
    and a box of poses."""
    axis = pin.axis
    if not space.exact or axis == 2:
        value = pin.normal[axis] * pin.value
        if not low[axis] <= value <= high[axis]:
            return None
        low[axis] = high[axis] = value
        if not space.exact:
            return low, high
    sides = [space.sides[o][side] for o, side in enumerate(other.sides)]
    polygon = clip_by_sides(polygon, sides, low, high)
    if axis != 2:
        normal = pin.normal[:2]
        polygon = clip(polygon, normal, pin.value) if polygon else polygon
        polygon = clip(polygon, -normal, -(pin.value + pin.reach)) if polygon else polygon
    if not polygon:
        return None
    low[:2], high[:2] = np.maximum(low[:2], np.min(polygon, axis=0)), np.minimum(high[:2], np.max(polygon, axis=0))
    return None if (low > high + CONTAINMENT).any() else (np.minimum(low, high), high)
