"""Transcription schemes of the double integrator s'' = u over one interval of length h.

    zoh          u constant:            s+ = s + h s' + h^2 u / 2,              s'+ = s' + h u              exact
    foh          u linear:              s+ = s + h s' + h^2 (2 u + u+) / 6,     s'+ = s' + h (u + u+) / 2   exact
    trapezoidal  averages of s' and u:  s+ = s + h s' + h^2 (u + u+) / 4,       s'+ = s' + h (u + u+) / 2

foh is what Hermite-Simpson collocation (Hargraves and Paris 1987) becomes for this system: a cubic in s and the
midpoint condition met exactly. Trapezoidal collocation, the usual textbook scheme, is here for comparison: against the
exact motion under the same linear u each step is off by h^2 (u+ - u) / 12 in position.

The functions take whatever can be added and multiplied: numbers, arrays, CasADi expressions.
"""

from typing import Any, TypeAlias

Term: TypeAlias = Any  # a number, an array, or an expression of CasADi
LINEAR = ("foh", "trapezoidal")  # controls are values at the nodes, linear in between


def step(scheme: str, pose: Term, rate: Term, h: Term, u: Term, u_next: Term) -> tuple[Term, Term]:
    """Pose and rate after an interval; `u_next` is not used by zoh."""
    if scheme == "zoh":
        return pose + h * rate + h**2 / 2 * u, rate + h * u
    if scheme == "foh":
        return pose + h * rate + h**2 / 6 * (2 * u + u_next), rate + h / 2 * (u + u_next)
    return pose + h * rate + h**2 / 4 * (u + u_next), rate + h / 2 * (u + u_next)


def square_integral(scheme: str, h: Term, u: Term, u_next: Term) -> Term:
    """Integral of u^2 over an interval."""
    return h * u**2 if scheme == "zoh" else h / 3 * (u**2 + u * u_next + u_next**2)


def control_points(scheme: str, pose: Term, rate: Term, h: Term, u: Term, u_next: Term) -> list[Term]:
    """The pose's Bernstein coefficients over an interval but for its begin: the motion is in the convex hull of all."""
    end, end_rate = step(scheme, pose, rate, h, u, u_next)
    inner = [pose + h / 3 * rate, end - h / 3 * end_rate] if scheme == "foh" else [pose + h / 2 * rate]
    return [*inner, end]


def rate_points(scheme: str, rate: Term, h: Term, u: Term, u_next: Term) -> list[Term]:
    """The rate's Bernstein coefficients over an interval but for its begin, as many as the pose has.

    Trapezoidal collocation takes the rate for linear between nodes.
    """
    end = rate + h * u if scheme == "zoh" else rate + h / 2 * (u + u_next)
    if scheme != "foh":
        return [(rate + end) / 2, end]
    middle = rate + h / 2 * u
    return [(rate + 2 * middle) / 3, (2 * middle + end) / 3, end]
