"""A lower bound on the effort of axes that pass intervals at given times: a beam that is pressed through gates.

The motion p of least integral of p''^2 between fixed ends is a beam: clamped where the motion is at rest, simply
supported at the begin when its velocity there is free. With forces f_b at the times t_b its deflection is c + G f,
where c is the unforced cubic and G the influence of one time on another, and the energy grows by f' G f. For gates
lower_b <= p(t_b) <= upper_b, any forces give a lower bound, the dual function

    D(f) = -f' G f + 2 sum_b (f_b (lower_b - c_b) if f_b > 0 else f_b (upper_b - c_b)),

which a few sweeps over the gates raise to nearly its maximum. Bounds on rate and acceleration can only add effort.
"""

from collections.abc import Sequence

import numpy as np

SWEEPS = 4


def effort_bound(
    first: np.ndarray,
    last: np.ndarray,
    duration: float,
    times: Sequence[np.ndarray],
    lower: Sequence[np.ndarray],
    upper: Sequence[np.ndarray],
    from_rest: bool,
) -> np.ndarray:
    """Lower bound on the integral of p''^2 of n axes, for m choices of the times. Shape (n, m).

    Args:
        first, last: positions, shape (n, 1).
        duration: of the motion [s].
        times: of each gate, shape (m,) [s].
        lower, upper: of each gate, shape (n, 1).
        from_rest: whether the motion begins at rest, else with free velocity.
    """
    moves = last - first
    energy = (12.0 if from_rest else 3.0) * moves**2 / duration**3 * np.ones_like(times[0])
    shares = [time / duration for time in times]
    cubics = [first + moves * (s**2 * (3 - 2 * s) if from_rest else s * (3 - s**2) / 2) for s in shares]
    count = range(len(times))
    influence = {
        (a, b): _influence(np.minimum(shares[a], shares[b]), np.maximum(shares[a], shares[b]), from_rest) * duration**3
        for a in count
        for b in count
        if a <= b
    }
    forces = [np.zeros_like(energy) for _ in count]
    deflections = [cubic.copy() for cubic in cubics]
    for _ in range(SWEEPS):
        for b in count:
            own = influence[b, b]
            without = deflections[b] - own * forces[b]
            force = (np.clip(without, lower[b], upper[b]) - without) / own
            for a in count:
                deflections[a] += influence[min(a, b), max(a, b)] * (force - forces[b])
            forces[b] = force
    for b in count:
        # -f' G f = -f' (deflection - c)
        reach = np.where(forces[b] > 0, lower[b], upper[b])
        energy += forces[b] * (2 * (np.where(forces[b] == 0, 0.0, reach) - cubics[b]) - (deflections[b] - cubics[b]))
    return energy


def _influence(x: np.ndarray, a: np.ndarray, from_rest: bool) -> np.ndarray:
    """Deflection at x of a beam of unit length and stiffness under a unit force at a >= x."""
    b = np.maximum(1 - a, 1e-6)
    x = np.maximum(x, 1e-6)
    if from_rest:
        return b**2 * x**2 * (3 * a - x * (3 * a + b)) / 6
    return b**2 * x * (3 * a - (2 + a) * x**2) / 12
