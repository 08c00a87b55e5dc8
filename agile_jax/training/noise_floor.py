"""The error below which no velocity field can come on these labels.

A rest-to-rest trajectory passes a place at a velocity that depends on where it began: the label is not a function
of the position, and E[Var(v | s)] is the floor of every mean squared error. The Gamma test (Stefansson, Koncar and
Jones, "A note on the Gamma test", Neural Computing and Applications 5, 1997) estimates it without a model. For a
sample q let n_p be its p-th nearest neighbour among the other trajectories, one a trajectory. With v = f(s) + r, r
of variance G,

    gamma(p) = mean_q |v_q - v_np|^2 / 2  ~  G + A delta(p),     delta(p) = mean_q |s_q - s_np|^2

so the regression of gamma on delta, p = 1 .. P, meets delta = 0 at G: the neighbours' distance is accounted for, not
neglected. Subtracting any fixed function of the position from the velocities leaves G as it is and makes A, thus the
error, smaller.

When it is meaningful. The line is right only while the neighbours are so near that f is straight between them. Where
trajectories are far apart gamma bends, the line meets zero too high, and the estimate errs upwards: it is then no proof
that a field cannot do better. So does every pair of neighbours with a boundary between two routes in between: to the
test a jump is noise. `share` = G / gamma(1) tells how much of what the nearest neighbours differ by is the floor and
how much is their distance: near one the floor is what was measured, near zero it is the end of a long extrapolation.
On known floors (tests/training/test_noise_floor.py) the estimate is within 30 % where the share is above one half, and
up to a hundred times too high where it is below.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from agile_jax.policy.network import PolicyParameters
from agile_jax.policy.policy import Policy
from agile_jax.single_precision import in_single_precision
from agile_jax.training.samples import SI, Samples, Unit

FEWEST = 3  # trajectories
MEMORY = 16_000_000  # distances held at once


class GammaTest(NamedTuple):
    """An estimate, ordered by the floor."""

    floor: float  # G averaged over the outputs, in their unit's square; 0 when the regression meets zero below it
    share: float  # of the floor in what nearest neighbours differ by, 0 to 1: how far it is to be trusted


def gamma_test(
    inputs: Float[np.ndarray, "n nodes _"],
    outputs: Float[np.ndarray, "n nodes _outputs"],
    queries: int = 1000,
    neighbours: int = 8,
    max_trajectories: int = 2000,
    seed: int = 0,
) -> GammaTest:
    """Estimate the floor.

    Args:
        inputs: poses [m, rad] or states [m, rad, m/s, rad/s], by trajectory.
        outputs: velocities [m/s, rad/s] or accelerations, minus any function of the inputs.
        queries: samples at most for which neighbours are sought.
        neighbours: P, of different trajectories.
        max_trajectories: searched at most.
        seed: of the subsamples.

    Raises:
        ValueError: fewer than three trajectories.
    """
    if len(inputs) < FEWEST:
        raise ValueError(f"a noise floor needs at least {FEWEST} trajectories, not {len(inputs)}")
    generator = np.random.default_rng(seed)
    if len(inputs) > max_trajectories:
        chosen = generator.permutation(len(inputs))[:max_trajectories]
        inputs, outputs = inputs[chosen], outputs[chosen]
    count, nodes, _ = inputs.shape
    neighbours = min(neighbours, count - 1)
    scaled = inputs.astype(np.float32).reshape(count * nodes, -1)
    scaled = scaled - scaled.mean(0)
    spread = scaled.std(0)
    scaled = scaled / np.where(spread > 1e-3, spread, 1.0)  # an axis without spread parts no neighbours
    flat = np.asarray(outputs, np.float32).reshape(count * nodes, -1)
    picked = generator.permutation(count * nodes)[:queries]

    squares, differences = [], []
    square_norm = (scaled**2).sum(-1)
    block = max(1, MEMORY // (count * nodes))
    for first in range(0, len(picked), block):
        query = picked[first : first + block]
        distance = square_norm[query, None] - 2 * scaled[query] @ scaled.T + square_norm  # (b, n m)
        by_trajectory = distance.reshape(len(query), count, nodes)
        nearest_node = by_trajectory.argmin(-1)
        nearest = np.take_along_axis(by_trajectory, nearest_node[..., None], -1)[..., 0]  # (b, n)
        nearest[np.arange(len(query)), query // nodes] = np.inf
        others = np.argpartition(nearest, neighbours - 1, axis=1)[:, :neighbours]
        others = np.take_along_axis(others, np.take_along_axis(nearest, others, 1).argsort(1), 1)  # (b, P)
        rows = others * nodes + np.take_along_axis(nearest_node, others, 1)
        squares.append(((scaled[query, None] - scaled[rows]) ** 2).sum(-1))
        differences.append(((flat[query, None] - flat[rows]) ** 2).mean(-1) / 2)
    delta = np.concatenate(squares).mean(0, dtype=np.float64)
    gamma = np.concatenate(differences).mean(0, dtype=np.float64)
    slope = np.polyfit(delta, gamma, 1)[0] if np.ptp(delta) > 0 else 0.0
    floor = float(max(gamma.mean() - max(slope, 0.0) * delta.mean(), 0.0))
    return GammaTest(floor, min(floor / max(float(gamma[0]), 1e-30), 1.0))


@in_single_precision
def noise_floor(
    policy: Policy,
    parameters: PolicyParameters,
    trajectories: Samples,
    held_out: Bool[np.ndarray, " n"],
    unit: Unit = SI,
) -> GammaTest | None:
    """The noise floor of a policy's samples; None with fewer than three trajectories.

    The lesser of two estimates, both of which err upwards where trajectories are far apart: over all trajectories with
    the designed part subtracted, and over the held-out ones with the trained policy subtracted (on those it was trained
    on, it may have learned the noise).

    Args:
        policy, parameters: what was trained.
        trajectories: samples by trajectory.
        held_out: which trajectories it was not trained on.
        unit: in which the floor is, squared.
    """
    designed = jax.vmap(jax.vmap(lambda given: policy.encode(given).base))
    trained = jax.vmap(jax.vmap(lambda given: policy.output(parameters, policy.encode(given))))
    found = []
    for chosen, known in ((np.ones(len(held_out), bool), designed), (held_out, trained)):
        if chosen.sum() >= FEWEST:
            given = trajectories.inputs[chosen]
            rest = trajectories.outputs[chosen] - np.asarray(jax.jit(known)(jnp.asarray(given, jnp.float32)))
            found.append(gamma_test(given, rest / unit))
    return min(found, default=None)
