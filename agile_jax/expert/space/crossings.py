"""Where routes go over from one region to the next.

A route crosses from one region to the next at a face: where the path last leaves the old region, or first enters the
new one. Either exists on every path along the route, so the face costs nothing, and it takes away the freedom to switch
anywhere in the overlap, which would make the labels ambiguous.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.space.cells import CONTAINMENT, Cell, Face
from agile_jax.expert.space.polygons import Polygon, clip
from agile_jax.expert.space.regions import FreeSpace, Region, clip_by_cells


class Crossing(NamedTuple):
    """Where a route goes over from one phase to the next."""

    face: Face
    lower: tuple[float, ...]  # (4,) box of poses around it
    upper: tuple[float, ...]  # (4,)


def find_crossings(space: FreeSpace, obstacle: int, a: Region, b: Region, priority: Sequence[int]) -> list[Crossing]:
    """Where a path goes over from one region to another: on the faces of the old or of the new cell of the obstacle
    that pass through their intersection; empty when there are none.

    Every path last leaves the old cell through one of its faces, and first enters the new one through one of its own:
    whichever cell has fewer serves.

    Args:
        priority: axes, those to cross on first.
    """
    low, high = np.maximum(a.lower, b.lower), np.minimum(a.upper, b.upper)
    if (low > high).any():
        return []
    cells = [space.cells[obstacle][region.cells[obstacle]] for region in (a, b)]
    choices = [_only_of(cell, other) for cell, other in (cells, cells[::-1])]
    for faces in sorted(filter(None, choices), key=lambda faces: (len(faces), priority.index(faces[0].axis))):
        boxes = [(face, _crossing_box(space, face, b, a.polygon, low.copy(), high.copy())) for face in faces]
        found = [
            Crossing(face, tuple(box[0].tolist()), tuple(box[1].tolist())) for face, box in boxes if box is not None
        ]
        if found:
            return found
    return []


def _only_of(cell: Cell, other: Cell) -> Sequence[Face]:
    """The faces of a cell that another cell of the obstacle has not; empty when routes may not cross at all of them."""
    own: Sequence[Face] = cell.faces
    if len(own) > 1:  # one face is never that of another cell alone
        others = {(*face.normal, face.value) for face in other.faces if face.crossable}
        own = [face for face in own if (*face.normal, face.value) not in others]
    return own if all(face.crossable for face in own) else ()


def _crossing_box(
    space: FreeSpace, face: Face, other: Region, polygon: Polygon, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The box around where a face, for some yaw, passes through the intersection of a region's polygon, another region
    and a box of poses."""
    axis = face.axis
    if not space.exact or axis == 2:
        value = face.normal[axis] * face.value
        if not low[axis] <= value <= high[axis]:
            return None
        low[axis] = high[axis] = value
        if not space.exact:
            return low, high
    cells = [space.cells[o][cell] for o, cell in enumerate(other.cells)]
    polygon = clip_by_cells(polygon, cells, low, high)
    if axis != 2:
        normal = face.normal[:2]
        polygon = clip(polygon, normal, face.value) if polygon else polygon
        polygon = clip(polygon, -normal, -(face.value + face.reach)) if polygon else polygon
    if not polygon:
        return None
    low[:2], high[:2] = np.maximum(low[:2], np.min(polygon, axis=0)), np.minimum(high[:2], np.max(polygon, axis=0))
    return None if (low > high + CONTAINMENT).any() else (np.minimum(low, high), high)
