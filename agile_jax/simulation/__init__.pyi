"""Names that the package offers; `__init__.py` loads each when it is first used."""

from .closed_loop import ClosedLoop as ClosedLoop, Episode as Episode
from .mjx_slots import MjxSlots as MjxSlots, mjx_loop as mjx_loop
from .mujoco_slots import MujocoSlots as MujocoSlots, batch_loop as batch_loop
from .outcome import OUTCOME_NAMES as OUTCOME_NAMES, SUCCESS as SUCCESS, UNSTABLE as UNSTABLE, Outcome as Outcome
from .paths import PathPlanner as PathPlanner, TimedPath as TimedPath, path_guidance as path_guidance
from .perception import IDEAL as IDEAL, Estimated as Estimated, Perception as Perception
from .physics.bullet_physics import BulletPhysics as BulletPhysics
from .physics.bullet_world import check_bullet as check_bullet
from .physics.host_physics import HostPhysics as HostPhysics
from .physics.mjx_physics import Implementation as Implementation, check_warp as check_warp, mjx_init as mjx_init
from .physics.mujoco_physics import MujocoPhysics as MujocoPhysics, set_solver as set_solver
from .pushes import push_after as push_after
from .reference import Guidance as Guidance, policy_guidance as policy_guidance, slowed as slowed
from .sensed import Sensed as Sensed
from .streaming import Rollout as Rollout, Slots as Slots, gather as gather, stream as stream
from .traces import LastStates as LastStates, Recorder as Recorder, Trace as Trace
