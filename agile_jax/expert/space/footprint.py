"""How much room a turned rectangle takes up in a direction."""

import numpy as np

from agile_jax.geometry import support

ALONG_X = np.array([1.0, 0.0])


def footprint(half_size: np.ndarray, yaws: tuple[float, float]) -> np.ndarray:
    """Half sizes (2,) of the axis-aligned rectangle that holds a rectangle at every yaw in an interval [m]."""
    low, high = yaws
    result = []
    for a, b in ((half_size[0], half_size[1]), (half_size[1], half_size[0])):
        peak = np.arctan2(b, a)  # |a cos| + |b sin| is largest here, and by symmetry at the mirrored angles
        peaks = [sign * peak + turn * np.pi for sign in (-1, 1) for turn in range(-3, 4)]
        yaws_to_try = [low, high, *(p for p in peaks if low <= p <= high)]
        result.append(support(np.array([a, b]), ALONG_X, np.array(yaws_to_try)).max())
    return np.array(result)


def footprint_range(half_size: np.ndarray, normal: np.ndarray, yaws: tuple[float, float]) -> tuple[float, float]:
    """Least and largest support of the torso's rectangle along a normal, shape (3,), over an interval of yaw [m]."""
    length = float(np.hypot(normal[0], normal[1]))
    if length == 0:
        return 0.0, 0.0
    angle = float(np.arctan2(normal[1], normal[0]))
    low, high = yaws[0] - angle, yaws[1] - angle
    # Between its kinks at multiples of a quarter turn the support is concave.
    kinks = np.arange(np.ceil(low / (np.pi / 2)), np.floor(high / (np.pi / 2)) + 1) * np.pi / 2
    candidates = np.array([low, high, *kinks])
    values = support(half_size[:2], ALONG_X, candidates)
    return length * float(values.min()), length * float(footprint(half_size, (low, high))[0])
