"""The largest boxes that hold none of the inside of given boxes, all parallel to the axes.

Around one box they are its six half-spaces. Around the slab and the legs of a table: the half-spaces beside and over
it, and below the slab one corridor between each pair of rows of legs. Together they cover all that is free.

A plane that bounds such a box is kept as (axis, sign, number of the given box), not as a number: how far off the plane
is depends on the footprint of the torso, hence on its yaw. If all given boxes grow by h, and what bounds an empty box
moves along, it stays empty, and an empty box of the grown boxes stays empty when they shrink again. So the largest
ones for the least footprint serve every yaw.
"""

import math
from typing import NamedTuple

import numpy as np

from agile_jax.scene import BOX_FACES

SAME = 1e-9  # [m] nearer planes are one: legs are flush with their table up to rounding


class Plane(NamedTuple):
    """That of a given box's face, which an empty box lies beyond."""

    axis: int
    sign: int  # of the face's normal along the axis
    box: int  # its number


class EmptyBox(NamedTuple):
    """A box without any of the given ones inside; infinite where nothing bounds it."""

    lower: tuple[float, ...]  # (3,)
    upper: tuple[float, ...]  # (3,)
    planes: tuple[Plane, ...]  # what bounds it

    def holds(self, other: "EmptyBox") -> bool:
        """Whether another box lies within this one."""
        lower = all(a <= b + SAME for a, b in zip(self.lower, other.lower, strict=True))
        return lower and all(a >= b - SAME for a, b in zip(self.upper, other.upper, strict=True))

    def overlaps(self, lower: np.ndarray, upper: np.ndarray) -> bool:
        """Whether it holds some of the inside of a given box."""
        sides = zip(self.lower, self.upper, lower, upper, strict=True)
        return all(low < far - SAME and high > near + SAME for low, high, near, far in sides)

    def beyond(self, number: int, axis: int, sign: int, value: float) -> "EmptyBox | None":
        """What of it lies beyond a plane; None when that is nothing."""
        planes = tuple(plane for plane in self.planes if plane[:2] != (axis, sign))
        plane = Plane(axis, sign, number)
        if sign > 0:
            lower = (*self.lower[:axis], value, *self.lower[axis + 1 :])
            return EmptyBox(lower, self.upper, (*planes, plane)) if value < self.upper[axis] - SAME else None
        upper = (*self.upper[:axis], value, *self.upper[axis + 1 :])
        return EmptyBox(self.lower, upper, (*planes, plane)) if value > self.lower[axis] + SAME else None


def largest_empty_boxes(lower: np.ndarray, upper: np.ndarray) -> list[EmptyBox]:
    """All empty boxes that are part of no larger one, in a fixed order.

    Args:
        lower, upper: corners of the K given boxes, shape (K, 3).
    """
    found = [EmptyBox((-math.inf,) * 3, (math.inf,) * 3, ())]
    for number in range(len(lower)):
        pieces: list[EmptyBox] = []
        for box in found:
            if not box.overlaps(lower[number], upper[number]):
                pieces.append(box)
                continue
            for _, axis, sign in BOX_FACES:
                value = float((upper if sign > 0 else lower)[number, axis])
                piece = box.beyond(number, axis, sign, value)
                if piece is not None:
                    pieces.append(piece)
        found = _without_parts(pieces) if number else pieces
    return found


def _without_parts(boxes: list[EmptyBox]) -> list[EmptyBox]:
    """The boxes that lie within no other; the first of equal ones."""
    return [
        box
        for i, box in enumerate(boxes)
        if not any(other.holds(box) and (j < i or not box.holds(other)) for j, other in enumerate(boxes) if j != i)
    ]
