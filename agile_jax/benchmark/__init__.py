"""Benchmarks against the peers: ratios measured in one process, on the same problems, with their method stated.

One module a subject; what a benchmark needs is loaded by running it, not by importing this package:

    expert       our labels against the nonlinear programs that a user would write first
    training     a training step against the machine's own matrix products, and against PyTorch
    mpc          our solver of the MPC's problems against general ones
    policy       a query of the policy against a solve of the expert
    tracking     random commands and disturbances: what the controller follows and survives
    evaluation   the closed loop's speed by backend and batch, and where the time goes
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
