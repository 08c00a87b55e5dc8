"""The solver of the MPC's quadratic program: three passes over a batch of problems, in float32.

The problem (`problem.py`, `leg_limits.py`), condensed to the foot forces f of N nodes, with y = B f the accelerations
of the body and K y the change of the joints' positions:

    minimise    1/2 y' H y + h' y + w/2 |f|^2
    subject to  f in the friction cones (`projection.py`),  A f in the torque limits,  K y in the position limits

H has 6N rows and is the same in every plan; only B, A, K and the bounds change. So each pass works in wrench space, on
a system of 6N equations, instead of on the 12N forces. Forces are scaled to units of 30 N (`scaled_qp.py`).

**Why three passes.** Nearly all problems of a walk touch no limit of a joint, and a batch waits for its slowest.

1. `cone_admm.py` knows the cones only: one 6N x 6N inverse a problem, then cheap iterations (ADMM with Anderson
   acceleration). A solution that keeps the other limits too is the solution.
2. `limit_admm.py` goes on with all rows where that fails (ADMM, another inverse). What is left of a batch is
   gathered into groups.
3. `newton.py` ends the few that fixed penalties would take hundreds of iterations for: many active limits, or joints
   that no forces keep. Each of its steps factorises anew and costs about twenty iterations. Without it seven of a
   thousand hard problems stayed up to 7.8 N from their optimum after 300 iterations of the second pass.

Positions are limited by an exact penalty, so that a problem always has a solution: where no forces keep the joints
within their limits, these break them least, and the status says INFEASIBLE.

**Where the constants come from.** None is derived. They were chosen by trial, for few iterations and little time, on
recorded problems of walking A1s (`benchmark/workloads/mpc_problems.py`: calm ones as they come, hard ones from
disturbed states) at the default horizon, time step, weights and tolerance of `MpcSettings`. No table of the trials was
kept. But for JOINT_MULTIPLIER_MAX none of them moves the solution, only how soon it is found: `tests/control` compares
with other solvers and with solutions known beforehand, and `agile benchmark mpc` shows a choice that no longer fits as
a lower rate or as inaccurate answers.

    cone_admm    FORCE_PENALTY 0.2            sets the speed of the first pass; chosen on calm problems, of which all of
                                              300 are solved within 30 iterations, 2 % within 15
                 OVER_RELAXATION 1.8          the upper end of what Boyd et al. 2011, section 3.4.3, recommend
                 ANDERSON_RIDGE 1e-6          keeps a 2 x 2 system regular in float32
    limit_admm   FORCE_PENALTY 0.3,           chosen together on hard problems with active torque and joint limits; one
                 TORQUE_PENALTY 0.1,          row of torque is about as long as one of force (LEVER_UNIT), one of
                 JOINT_PENALTY 10             position is in radians
                 JOINT_MULTIPLIER_MAX 1000    c of the exact penalty: must exceed the multipliers of feasible problems
    newton       FORCE_PENALTY 6, ...         where the penalties begin; ten to thirty times those of the second pass
                 PENALTY_GROWTH 3, _MAX 30    how they grow, up to where float32 no longer resolves a step
                 SLOW_DECREASE 0.6,           when they grow, and how well a subproblem is solved before the multipliers
                 SUBPROBLEM_TOLERANCE 0.1     change
                 REGULARISATION 0.02          conditions the Hessian of a step
                 SHORTEST_STEP 10,            times the tolerance: what rounding errors of float32 leave
                 GRADIENT_TOLERANCE 0.3
                 LINE_SEARCH                  where the slope along a step, piecewise linear, is looked at
    CHECK_INTERVAL 5, 10                      iterations between two looks at the residuals
    cascade      BLOCK 64                     problems whose matrices stay in a core's cache
                 GROUPS, SMALLEST_GROUP       sizes of the groups that the second and third pass gather

**How far they hold.** `control/scaling.py` scales weights, force limit and tolerance by the robot's mass, so the scaled
problem of another robot resembles the A1's; what other robots did is in docs/results.md. FORCE_UNIT stays, so a robot
of a tenth or ten times the mass is outside of what was tried, as are other horizons, time steps and weights.
"""
