"""The convex model predictive control.

`problem.py` builds the quadratic program: cost, friction, limits of the joints. `centroidal.py` has its dynamics,
`leg_limits.py` the rows of the joints, and `solver/` solves it.
"""
