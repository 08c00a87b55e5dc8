"""What the report's words mean, with their numbers from where they are decided."""

import numpy as np

from agile_jax.dataset import time_limit
from agile_jax.dataset.expert_time import NO_PATH_LIMIT
from agile_jax.evaluation.breakdown import NEAR_M
from agile_jax.scene import SceneSettings
from agile_jax.scene.tolerance import HEIGHT_TOLERANCE, PLANAR_TOLERANCE, YAW_TOLERANCE
from agile_jax.simulation.outcome import LARGEST_TILT_COSINE, STAY

ARRIVAL = (
    "An episode arrives when the trunk enters this tolerance for good. The arrival time is compared with the time at "
    "which the expert's own path, from the same start, enters the same tolerance for good. A path ends in the target's "
    "centre, later than it enters the tolerance: over the duration of the whole path, the same arrival is a smaller "
    "ratio, which can be below 1 although no robot is faster than the expert."
)
STARTS = (
    "Starts are told apart by the route of the expert's path and by the distance of the torso's envelope from the "
    f"nearest obstacle at the start: below {NEAR_M:g} m, or {NEAR_M:g} m and more."
)


def success() -> str:
    """When an episode succeeds, and when it fails."""
    extra, after_one_second = time_limit(np.array([0.0, 1.0]))
    tilt = np.degrees(np.arccos(LARGEST_TILT_COSINE))
    return (
        f"An episode succeeds when the trunk stays for {STAY:g} s within {PLANAR_TOLERANCE:.2f} m of the target in the "
        f"plane, {HEIGHT_TOLERANCE:.2f} m in height and {YAW_TOLERANCE:g} rad in yaw. Its time limit is "
        f"{after_one_second - extra:g} T + {extra:g} s, where T is the duration of the expert's path from the same "
        f"start ({NO_PATH_LIMIT:g} s where the expert finds none). It fails at once when any part of the robot touches "
        f"an obstacle, the trunk, a hip or a thigh touches the floor, the trunk tilts by more than {tilt:.0f} degrees, "
        "or a number is not finite."
    )


def obstacles(scene: SceneSettings) -> str:
    """What stands in the scene, as it collides; "" for an empty one."""
    words = []
    for obstacle in scene.obstacles:
        if obstacle.kind == "box":
            words.append(f"a full box, {' x '.join(f'{size:g}' for size in obstacle.size)} m")
        elif obstacle.leg_size is None:
            words.append(
                f"a slab, as in the paper: it blocks everything from {obstacle.underside:g} m to {obstacle.top:g} m "
                "above the floor, and has no legs. Pictures show its underside as a board, what it blocks above in pale"
            )
        else:
            words.append(
                f"a table with four legs, which collide; its slab blocks everything from {obstacle.underside:g} m to "
                f"{obstacle.top:g} m. Pictures show it as a board, and what it blocks above in pale"
            )
    counted = {word: words.count(word) for word in words}
    found = [word if count == 1 else f"{count} times {word}" for word, count in counted.items()]
    return f"Obstacles: {'; '.join(found)}." if found else ""
