"""The convex model predictive control: centroidal dynamics, the limits of the legs, the problem, and its solver."""
