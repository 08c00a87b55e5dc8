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

**Where the constants come from.** None is derived. They were chosen by trial on recorded problems of the A1
(`benchmark/workloads/mpc_problems.py`: a thousand of robots that walk at random commands, a thousand from disturbed
states), at the default horizon, weights and tolerance of `MpcSettings`, for the least time of a batch of 64 on one
core. `agile benchmark mpc` measures on these problems; a choice that no longer holds shows there as a rate that falls,
as problems that are not accurate, or as a larger error. None of them changes what the solution is, only how soon it is
found: `tests/control` compares with other solvers and with solutions known beforehand.

    cone_admm   FORCE_PENALTY 0.2          decides how fast the first pass converges; scaled objective, cones alone
                OVER_RELAXATION 1.8        the upper end of what Boyd et al. 2011, section 3.4.3, recommend
                ANDERSON_RIDGE 1e-6        only keeps the 2 x 2 system of the acceleration regular in float32
                CHECK_INTERVAL 5           a look at the residuals costs about half an iteration
    limit_admm  FORCE_PENALTY 0.3,         found together, on problems with active torque and joint limits; the rows of
                TORQUE_PENALTY 0.1,        torque are as long as those of force by LEVER_UNIT, those of position have
                JOINT_PENALTY 10           radians, hence the other size
                JOINT_MULTIPLIER_MAX 1000  above the multipliers of all feasible recorded problems, so limits are hard
    newton      FORCE_PENALTY 6, ...       twenty to thirty times the second pass's, since a step solves its subproblem
                PENALTY_GROWTH 3, _MAX 30  and up to what float32 resolves beside the rest of the Hessian
                SUBPROBLEM_TOLERANCE 0.1,  usual sizes of an inexact method of multipliers
                SLOW_DECREASE 0.6
                SHORTEST_STEP 10,          times the tolerance: rounding errors of float32 in the recorded problems
                GRADIENT_TOLERANCE 0.3
                LINE_SEARCH                the slope of a step is piecewise linear; denser where steps are cut most
    cascade     BLOCK 64                   problems whose matrices stay in a core's cache
                GROUPS, SMALLEST_GROUP     few problems are left after a pass: a group should not wait for many

**How far they hold.** Over robots: `control/scaling.py` scales weights and tolerance by the robot's mass, and the
robots of docs/results.md walk with no problem unsolved. A robot of another order of mass needs another FORCE_UNIT, or
else the penalties are as many times off. Over other weights, horizons and time steps: tried only near the defaults.
"""
