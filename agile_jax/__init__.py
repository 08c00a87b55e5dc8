"""Learning agile paths from optimal control, from the optimal control problem to a robot that crawls under a table.

    scene -> expert -> dataset -> policy -> control -> simulation -> evaluation -> report

`agile_jax.scene` describes the world, `expert` solves the minimum-time problem, `dataset` stores its verified
solutions, `policy` learns the velocity field s -> s', `control` tracks it with torques, `simulation` runs the
physics, `evaluation` counts successes, `report` draws.

    import agile_jax as aj

    aj.solve("experiments/quickstart.toml", (0, 0, 0.28, 0))    # one optimal path
    run = aj.open_run("runs/quickstart")                        # a finished run: run.policy, run.rollout, ...

Importing this package imports nothing: each name is loaded when it is first used (docs/python.md).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
