"""The Kalman filter's two steps for an error x of covariance P (Kalman 1960)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def predict(
    covariance: Float[Array, "n n"], transition: Float[Array, "n n"], noise: Float[Array, " n"]
) -> Float[Array, "n n"]:
    """Covariance of the error a step later: F P F' + Q, with Q diagonal."""
    return transition @ covariance @ transition.T + jnp.diag(noise)


def correct(
    covariance: Float[Array, "n n"],
    rows: Float[Array, "m n"],
    noise: Float[Array, " m"],
    innovation: Float[Array, " m"],
) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
    """The error that y = H x + noise tells, and its covariance after that.

    Joseph's form, which stays positive definite in single precision.

    Args:
        covariance: P, before.
        rows: H. A row of zeros tells nothing.
        noise: variances of the noise.
        innovation: y.
    """
    cross = rows @ covariance
    factor = jax.scipy.linalg.cho_factor(cross @ rows.T + jnp.diag(noise))
    gain = jax.scipy.linalg.cho_solve(factor, cross).T
    keep = jnp.eye(len(covariance)) - gain @ rows
    return gain @ innovation, keep @ covariance @ keep.T + (gain * noise) @ gain.T
