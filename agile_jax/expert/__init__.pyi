"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .expert import Expert as Expert
from .feasible_poses import (
    check_start as check_start,
    check_target as check_target,
    check_targets as check_targets,
    lowest_underside as lowest_underside,
    pose_errors as pose_errors,
)
from .kinds import make_expert as make_expert
from .planar_comparison import Comparison as Comparison, compare_dimensions as compare_dimensions
from .search.minimum_time import lower_bound as lower_bound, minimum_time as minimum_time
from .settings import (
    ExpertSettings as ExpertSettings,
    InitialVelocity as InitialVelocity,
    MotionLimits as MotionLimits,
)
from .solution import (
    CERTIFIED as CERTIFIED,
    ExpertSolution as ExpertSolution,
    Residuals as Residuals,
    Trajectory as Trajectory,
)
from .space.regions import planning_margin as planning_margin
from .verify import Rejection as Rejection, integrate as integrate, rejection as rejection, verify as verify
