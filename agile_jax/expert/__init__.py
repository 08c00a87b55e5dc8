"""The expert: minimum-time trajectories around obstacles, to global quality, with unique labels, each one verified.

The obstacle problem is split into routes (regions.py, routes.py), each route is a smooth program whose regions are
simple bounds (transcription.py), the best route by the objective T + w E is kept (expert.py), and nothing leaves
without the independent check (verify.py). Minimum time alone leaves all axes but the slowest undetermined; the effort
E, with a small weight w, determines them and, where routes tie in time, the route. The default w = 1e-2 with
100 nodes makes T longer than w = 1e-4 with 400 nodes does by 1e-4 in the median and 4e-4 at worst (40 starts of the
paper's distribution, from rest; 3e-4 with free initial velocity). The paper's u_0 = u_N = 0 costs 2 %.

Importing this package loads neither CasADi nor JAX.
"""

from agile_jax.expert.expert import Expert, make_expert
from agile_jax.expert.minimum_time import lower_bound, minimum_time
from agile_jax.expert.regions import check_start, check_target, planning_margin
from agile_jax.expert.settings import ExpertSettings
from agile_jax.expert.solution import ExpertSolution, Residuals, Trajectory
from agile_jax.expert.verify import integrate, rejection, verify

__all__ = [
    "Expert",
    "ExpertSettings",
    "ExpertSolution",
    "Residuals",
    "Trajectory",
    "check_start",
    "check_target",
    "integrate",
    "lower_bound",
    "make_expert",
    "minimum_time",
    "planning_margin",
    "rejection",
    "verify",
]
