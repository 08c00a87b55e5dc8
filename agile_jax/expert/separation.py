"""The shortest vector between two rectangles in the plane."""

import numpy as np

from agile_jax.geometry import rotation_2d

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
