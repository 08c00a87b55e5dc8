"""Convex polygons in the plane: the shortest vector between two rectangles, and what half-planes leave of a polygon."""

from collections.abc import Sequence

import numpy as np

from agile_jax.geometry import rotation_2d

TOUCHING = 1e-9  # [m] a polygon may be as thin as a line
SIGNS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])


def planar_separation(
    center_a: np.ndarray, half_a: np.ndarray, yaw_a: float, center_b: np.ndarray, half_b: np.ndarray, yaw_b: float
) -> np.ndarray:
    """The shortest vector from rectangle b to rectangle a, shape (2,) [m]; its length is their distance.

    Disjoint rectangles are nearest at a vertex of one of them. Meaningless when they overlap.
    """
    to_a = _from_vertices(center_a, half_a, yaw_a, center_b, half_b, yaw_b)
    to_b = -_from_vertices(center_b, half_b, yaw_b, center_a, half_a, yaw_a)
    return min(to_a, to_b, key=lambda vector: float(vector @ vector))


def _from_vertices(
    center_a: np.ndarray, half_a: np.ndarray, yaw_a: float, center_b: np.ndarray, half_b: np.ndarray, yaw_b: float
) -> np.ndarray:
    """The shortest vector from rectangle b to a vertex of a."""
    rotation = rotation_2d(yaw_b)
    vertices = center_a + (SIGNS * half_a) @ rotation_2d(yaw_a).T
    local = (vertices - center_b) @ rotation
    vectors = local - np.clip(local, -half_b, half_b)
    return np.asarray(rotation @ vectors[int(np.argmin((vectors**2).sum(1)))])


Polygon = Sequence[tuple[float, float]]  # its vertices in order; empty when nothing is left


def clip(polygon: Polygon, normal: Sequence[float] | np.ndarray, value: float) -> Polygon:
    """The part of a convex polygon where normal . p >= value (Sutherland and Hodgman 1974)."""
    heights = [normal[0] * x + normal[1] * y - value for x, y in polygon]
    if all(height >= -TOUCHING for height in heights):
        return polygon
    kept: list[tuple[float, float]] = []
    for i, (point, height) in enumerate(zip(polygon, heights, strict=True)):
        before, below = polygon[i - 1], heights[i - 1]
        if (height >= -TOUCHING) != (below >= -TOUCHING):
            share = below / (below - height)
            kept.append(tuple(b + share * (p - b) for b, p in zip(before, point, strict=True)))  # type: ignore[arg-type]
        if height >= -TOUCHING:
            kept.append(point)
    return kept
