"""The expert: minimum-time trajectories around obstacles, to global quality, with unique labels, each one verified.

Free space is split into regions (space/), connected sequences of them are routes (search/). Least time comes first: a
route that attains the analytic lower bound is globally optimal, its duration is closed form, and the other axes'
motions are convex programs (programs/certified.py, programs/axis_program.py). Where no route does, each route is a
smooth nonlinear program (programs/transcription.py), tried in several ways (programs/retries.py), and the best by
T + w E is kept (minimum_time_expert.py). Nothing leaves without the independent check (verify.py). Minimum time alone
leaves all axes but the slowest undetermined; the effort E determines them and, where routes tie in time, the route.

The default weight w = 5e-3 with 100 nodes keeps the program's durations within 1e-4 of the analytic minimum (2.5e-5
at worst over 1,000 random pairs with random bounds). The paper's u_0 = u_N = 0 multiplies the time by N / (N - 2) with
constant and by N / (N - 1) with linear accelerations.

Rates are bounded axis by axis unless `velocity_bound` says otherwise. That is the paper's problem, it makes the axes
independent, and so most durations closed form and certified; the norm bound couples x and y, attains no closed form
and needs the general program for every label.

Importing this package loads neither CasADi nor JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
