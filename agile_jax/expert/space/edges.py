"""The rounded edge between two faces of an obstacle.

The poses that keep a margin m from a box end, around its edge, on a cylinder of radius m, while beyond-one-face-or-the-
other is a square corner that keeps up to sqrt(2) m. Where a route goes over between two faces, with normals n_1, n_2,
it gets a phase of its own, in which the torso keeps m from a plane through the edge,

    (cos t n_1 + sin t n_2) . (p + corner - edge) >= m,    0 <= t <= 90 degrees,

whose angle t is free in every interval and the same at both of its ends. Two convex bodies are m apart exactly when
such a plane exists, so this is the exact clearance, up to the number of intervals.

The phase lies between two planes: the crossed face as enlarged by the margin, and as it is. A path along the route
leaves the one for the last time before it reaches the other, so these crossings cost nothing, as the route's own.
"""

from typing import NamedTuple

import numpy as np

from agile_jax.expert.space.cells import PARALLEL, EndPoses, Face, half_space_box
from agile_jax.expert.space.crossings import Crossing
from agile_jax.expert.space.polygons import clip
from agile_jax.expert.space.regions import FreeSpace, Region, holds, rectangle

Box = tuple[np.ndarray, np.ndarray]  # (lower, upper) of the pose, each (4,)


class Passage(NamedTuple):
    """How a route gets from one region to the next: across one crossing, or across two with a phase in between."""

    crossings: tuple[Crossing, ...]
    between: Region | None = None


def round_edge(
    space: FreeSpace, obstacle: int, before: Region, after: Region, crossed: Face, end_poses: EndPoses
) -> Passage | None:
    """The passage around the edge between two regions that differ in the cell of one obstacle.

    None where the corner stays square: one of the cells has several faces (below a table with legs), there is no edge
    between the two, start or target (`end_poses`) lies between the two planes, or another obstacle leaves no room for
    one of them.

    Args:
        crossed: the face, out of the two cells', that the crossing is on.
    """
    cells = [space.cells[obstacle][region.cells[obstacle]] for region in (before, after)]
    if any(len(cell.faces) != 1 for cell in cells):
        return None
    first, second = (cell.faces[0] for cell in cells)
    leaving = crossed is first
    other, beyond = (second, after) if leaving else (first, before)
    if not other.crossable or abs(crossed.normal @ other.normal) > PARALLEL:
        return None
    margin = space.margin
    bare, bare_other = _without(crossed, margin), _without(other, margin)
    for pose in end_poses:
        if bare.value < crossed.normal @ pose[:3] < crossed.value + crossed.reach and holds(space, beyond, pose):
            return None

    chosen = zip(before.cells, space.cells, strict=True)
    rest = [around[i] for o, (i, around) in enumerate(chosen) if o != obstacle]
    low = np.max([space.lower, *(cell.lower for cell in rest)], axis=0)
    high = np.min([space.upper, *(cell.upper for cell in rest)], axis=0)
    crossings = []
    for plane, least in ((crossed, bare_other), (bare, other)):
        box = _cut(
            space.exact,
            (low, high),
            [
                *(
                    (face.normal, face.value)
                    for cell in rest
                    for face in cell.faces
                    if face.row is not None and face.crossable
                ),
                (plane.normal, plane.value),
                (-plane.normal, -(plane.value + plane.reach)),
                (least.normal, least.value),
            ],
        )
        if box is None:
            return None
        crossings.append(Crossing(plane, tuple(box[0].tolist()), tuple(box[1].tolist())))
    rows = np.array([row for cell in rest for row in cell.rows]).reshape(-1, 4)
    planes = np.array([[*face.normal, face.value - face.least] for face in (bare, bare_other)])
    region = Region(after.cells, low, high, rows, (), planes)
    return Passage(tuple(crossings if leaving else reversed(crossings)), region)


def _without(face: Face, margin: float) -> Face:
    """A face that is not enlarged by the margin."""
    row = None if face.row is None else face.row - [0.0, 0.0, 0.0, margin]
    return face._replace(value=face.value - margin, row=row)


def _cut(exact: bool, box: Box, planes: list[tuple[np.ndarray, float]]) -> Box | None:
    """The box around what half-spaces, normal . position >= value, leave of a box of poses; None when it is empty."""
    low, high = box
    for normal, value in planes:
        low, high = half_space_box(normal, value, low, high)
    if (low > high).any():
        return None
    if exact:
        polygon = rectangle(low, high)
        for normal, value in planes:
            if normal[:2].any():
                polygon = clip(polygon, normal[:2], value - max(normal[2] * low[2], normal[2] * high[2]))
            if not polygon:
                return None
        low[:2], high[:2] = np.min(polygon, axis=0), np.max(polygon, axis=0)
    return low, high
