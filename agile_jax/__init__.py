"""Learning agile paths from optimal control, from the optimal control problem to a robot that crawls under a table.

    scene -> expert -> dataset -> policy -> control -> simulation -> evaluation -> report

`agile_jax.scene` describes the world, `expert` solves the minimum-time problem, `dataset` stores its verified
solutions, `policy` learns the velocity field s -> s', `control` tracks it with torques, `simulation` runs the
physics, `evaluation` counts successes, `report` draws. Importing this package imports nothing.
"""
