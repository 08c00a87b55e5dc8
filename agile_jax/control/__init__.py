"""Whole-body control: gait, footholds, swing, convex MPC, torques. Knows no scene, no policy.

`controller.py` composes them. The MPC is in `mpc/`: `mpc/problem.py` builds its quadratic program, friction cones and
limits included, and `mpc/solver/` solves it. `interface.py` says what another controller must have.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
