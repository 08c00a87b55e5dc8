"""Rotations, angles and box distances: pure functions that work on NumPy and on JAX arrays.

Functions take the array namespace `xp` (numpy or jax.numpy) where they create arrays, so that NumPy code and compiled
code share one definition. A box here is a vertical prism: a rectangle in the plane, turned by yaw, times an interval
of heights.
"""

from types import ModuleType

import numpy as np
from jaxtyping import Float

from agile_jax.arrays import AnyArray


def wrap_angle(angle: Float[AnyArray, "*shape"] | float, xp: ModuleType = np) -> Float[AnyArray, "*shape"]:
    """The same angle in [-pi, pi) [rad]."""
    return xp.mod(angle + xp.pi, 2 * xp.pi) - xp.pi


def rotation_2d(yaw: Float[AnyArray, "*shape"] | float, xp: ModuleType = np) -> Float[AnyArray, "*shape 2 2"]:
    """The matrix of the rotation by `yaw` [rad] in the plane."""
    c, s = xp.cos(yaw), xp.sin(yaw)
    return xp.stack([xp.stack([c, -s], -1), xp.stack([s, c], -1)], -2)


def inverse_3x3(matrix: Float[AnyArray, "*shape 3 3"], xp: ModuleType = np) -> Float[AnyArray, "*shape 3 3"]:
    """Inverse by cofactors: unlike a call of LAPACK for each, it runs over a whole batch at once."""
    a, b, c = matrix[..., 0], matrix[..., 1], matrix[..., 2]  # columns
    bc, ca, ab = xp.cross(b, c), xp.cross(c, a), xp.cross(a, b)
    return xp.stack([bc, ca, ab], -2) / xp.sum(a * bc, -1)[..., None, None]


def support(
    half: Float[AnyArray, "2"],
    normal: Float[AnyArray, "*#shape 2"],
    yaw: Float[AnyArray, "*#shape"] | float,
    xp: ModuleType = np,
) -> Float[AnyArray, "*shape"]:
    """How far a rectangle reaches from its centre along a direction in the plane [m].

    Args:
        half: half sizes along the rectangle's own axes [m].
        normal: the direction, a unit vector.
        yaw: orientation of the rectangle [rad].
        xp: numpy or jax.numpy.
    """
    c, s = xp.cos(yaw), xp.sin(yaw)
    along, across = c * normal[..., 0] + s * normal[..., 1], c * normal[..., 1] - s * normal[..., 0]
    return half[0] * xp.abs(along) + half[1] * xp.abs(across)


def rectangle_distance(
    center_a: Float[AnyArray, "*#shape 2"],
    half_a: Float[AnyArray, "*#shape 2"],
    yaw_a: Float[AnyArray, "*#shape"] | float,
    center_b: Float[AnyArray, "*#shape 2"],
    half_b: Float[AnyArray, "*#shape 2"],
    yaw_b: Float[AnyArray, "*#shape"] | float,
    xp: ModuleType = np,
) -> Float[AnyArray, "*shape"]:
    """Exact signed distance of two rectangles in the plane [m].

    Positive: the Euclidean distance. Negative: minus the penetration depth, the shortest translation that parts them.
    Disjoint convex polygons are nearest at a vertex of one of them; the penetration depth of convex polygons is
    reached along an edge normal of one of them (separating axis theorem).

    Args:
        center_a, center_b: centres of the rectangles [m].
        half_a, half_b: half sizes along the rectangle's own axes [m].
        yaw_a, yaw_b: orientations [rad].
        xp: numpy or jax.numpy.
    """
    apart = center_b - center_a
    turn = yaw_b - yaw_a

    def one_way(yaw: AnyArray, half: AnyArray, other_half: AnyArray, sign: float) -> tuple[AnyArray, AnyArray]:
        """Gap along the edge normals of one rectangle, and the squared distance of the other's vertices to it, in the
        frame of the one, where the other is turned by sign * turn and lies in the direction sign * apart."""
        c, s = xp.cos(yaw), xp.sin(yaw)
        x = sign * (c * apart[..., 0] + s * apart[..., 1])
        y = sign * (c * apart[..., 1] - s * apart[..., 0])
        c, s = xp.cos(turn), sign * xp.sin(turn)
        (ax, ay), (bx, by) = (half[..., 0], half[..., 1]), (other_half[..., 0], other_half[..., 1])
        gap = xp.maximum(
            xp.abs(x) - ax - bx * xp.abs(c) - by * xp.abs(s), xp.abs(y) - ay - bx * xp.abs(s) - by * xp.abs(c)
        )
        squares = []
        for i, j in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            vx, vy = x + i * bx * c - j * by * s, y + i * bx * s + j * by * c
            squares.append(xp.maximum(xp.abs(vx) - ax, 0.0) ** 2 + xp.maximum(xp.abs(vy) - ay, 0.0) ** 2)
        first, second, third, fourth = squares
        return gap, xp.minimum(xp.minimum(first, second), xp.minimum(third, fourth))

    gap_a, square_a = one_way(yaw_a, half_a, half_b, 1.0)
    gap_b, square_b = one_way(yaw_b, half_b, half_a, -1.0)
    gap = xp.maximum(gap_a, gap_b)
    square = xp.minimum(square_a, square_b)
    # The square root of a safe number keeps JAX's gradient finite where the branch is not taken.
    distance = xp.sqrt(xp.where(gap > 0, square, 1.0))
    return xp.where(gap > 0, distance, gap)


def prism_distance(
    planar: Float[AnyArray, "*#shape"], vertical: Float[AnyArray, "*#shape"], xp: ModuleType = np
) -> Float[AnyArray, "*shape"]:
    """Exact signed distance of two vertical prisms from the signed distances of bases and of heights [m]."""
    apart = xp.maximum(planar, 0.0) ** 2 + xp.maximum(vertical, 0.0) ** 2
    largest = xp.maximum(planar, vertical)
    return xp.where(largest > 0, xp.sqrt(xp.where(largest > 0, apart, 1.0)), largest)


def quaternion_to_matrix(quaternion: Float[AnyArray, "*shape 4"], xp: ModuleType = np) -> Float[AnyArray, "*shape 3 3"]:
    """The rotation matrix of a unit quaternion wxyz."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return xp.stack([xp.stack(row, -1) for row in rows], -2)


def quaternion_to_rpy(quaternion: Float[AnyArray, "*shape 4"], xp: ModuleType = np) -> Float[AnyArray, "*shape 3"]:
    """Roll, pitch and yaw of a unit quaternion wxyz, R = Rz(yaw) Ry(pitch) Rx(roll) [rad]."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    roll = xp.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = xp.arcsin(xp.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = xp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return xp.stack([roll, pitch, yaw], -1)


def quaternion_product(
    first: Float[AnyArray, "*#shape 4"], second: Float[AnyArray, "*#shape 4"], xp: ModuleType = np
) -> Float[AnyArray, "*shape 4"]:
    """The quaternion wxyz of the rotation `second` followed by `first`, about fixed axes."""
    (w, x, y, z), (a, b, c, d) = (tuple(one[..., i] for i in range(4)) for one in (first, second))
    return xp.stack(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        -1,
    )


def rotation_quaternion(turn: Float[AnyArray, "*shape 3"], xp: ModuleType = np) -> Float[AnyArray, "*shape 4"]:
    """The quaternion wxyz of a turn about a vector by its length [rad]."""
    angle = xp.sqrt(xp.sum(turn**2, -1, keepdims=True) + 1e-24)
    return xp.concatenate([xp.cos(angle / 2), xp.sin(angle / 2) / angle * turn], -1)


def yaw_to_quaternion(yaw: Float[AnyArray, "*shape"] | float, xp: ModuleType = np) -> Float[AnyArray, "*shape 4"]:
    """The quaternion wxyz of a turn by `yaw` [rad] about the vertical."""
    zero = xp.zeros_like(yaw)
    return xp.stack([xp.cos(yaw / 2), zero, zero, xp.sin(yaw / 2)], -1)


GOLDEN = (5**0.5 - 1) / 2
SECTIONS = 26  # golden sections: a segment of 1 m is searched to 4e-6 m


def segment_box_distance(
    start: Float[AnyArray, "*#shape 3"],
    end: Float[AnyArray, "*#shape 3"],
    half: Float[AnyArray, "*#shape 3"],
    xp: ModuleType = np,
) -> Float[AnyArray, "*shape"]:
    """Distance of a segment to a solid box around the origin, parallel to the axes [m]; 0 where they meet.

    The distance to a convex set is convex along a line: golden sections find its minimum.

    Args:
        start, end: ends of the segment [m].
        half: half sizes of the box [m].
        xp: numpy or jax.numpy.
    """

    def distance(share: AnyArray) -> AnyArray:
        point = start + share[..., None] * (end - start)
        return (xp.maximum(xp.abs(point) - half, 0.0) ** 2).sum(-1)

    shape = np.broadcast_shapes(start.shape, end.shape, half.shape)[:-1]
    low, high = xp.zeros(shape), xp.ones(shape)
    a, b = low + (1 - GOLDEN), low + GOLDEN
    at_a, at_b = distance(a), distance(b)
    least = xp.minimum(distance(low), distance(high))
    for _ in range(SECTIONS):
        left = at_a <= at_b
        low, high = xp.where(left, low, a), xp.where(left, b, high)
        new = xp.where(left, high - GOLDEN * (high - low), low + GOLDEN * (high - low))
        at_new = distance(new)
        a, b = xp.where(left, new, b), xp.where(left, a, new)
        at_a, at_b = xp.where(left, at_new, at_b), xp.where(left, at_a, at_new)
    return xp.sqrt(xp.minimum(least, xp.minimum(at_a, at_b)))


def segment_distance(
    first: Float[AnyArray, "*#shape 2 3"], second: Float[AnyArray, "*#shape 2 3"], xp: ModuleType = np
) -> Float[AnyArray, "*shape"]:
    """Distance of two segments, each given by its ends [m]; one without length is a point.

    The place on the first is the nearest of its line to the other's, cut to its length; then each is the nearest to
    the other's in turn, which is exact (Ericson, Real-Time Collision Detection, 5.1.9).
    """
    along, other = first[..., 1, :] - first[..., 0, :], second[..., 1, :] - second[..., 0, :]
    apart = first[..., 0, :] - second[..., 0, :]
    a, e = (xp.maximum((way * way).sum(-1), 1e-12) for way in (along, other))
    b, c, f = (along * other).sum(-1), (along * apart).sum(-1), (other * apart).sum(-1)
    s = xp.clip((b * f - c * e) / xp.maximum(a * e - b * b, 1e-12), 0.0, 1.0)
    t = xp.clip((b * s + f) / e, 0.0, 1.0)
    s = xp.clip((b * t - c) / a, 0.0, 1.0)
    gap = apart + s[..., None] * along - t[..., None] * other
    return xp.sqrt((gap * gap).sum(-1))
