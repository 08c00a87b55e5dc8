"""Where labels start. Start i is a pure function of (seed, i), so shards need to know nothing of each other.

`unseen_starts` draws those of tests and evaluations, with the same margin.

"paper" is the scene's start distribution. "wide" also covers where the closed loop gets to: a mixture of the paper's
starts at any height, of poses around the target, and of poses uniform over each convex part of the free space (in
front of, behind, left and right of, under or over each obstacle), so that the tunnel under a table is as well covered
as the open floor. All with a spread in yaw.
"""

import numpy as np
from jaxtyping import Float

from agile_jax.dataset.settings import DatasetSettings
from agile_jax.expert import ExpertSettings, planning_margin
from agile_jax.scene import (
    BOX_FACES,
    POSE_SIZE,
    Scene,
    SceneSettings,
    Starts,
    clearance,
    make_scene,
    obstacle_boxes,
    sample_starts,
    streams,
    without_way_over,
)
from agile_jax.settings import BadInput

MAX_DRAWS = 10_000
COUNTED_STARTS = 100_000  # of which the rejected share is found, to a tenth of a per cent


def unseen_starts(
    scene: SceneSettings, expert: ExpertSettings, count: int, key: tuple[int, ...]
) -> Float[np.ndarray, "n 4"]:
    """Starts of the scene's distribution from which the expert may plan [m, rad]; `key` is a random stream of its own.

    Start i is a pure function of (key, i).
    """
    return _of_the_scene(make_scene(scene), scene, expert, count, key).poses


def rejected_shares(scene: SceneSettings, expert: ExpertSettings, key: tuple[int, ...]) -> dict[str, float]:
    """What part of the scene's start distribution `unseen_starts` leaves out, by cause, as keys of a summary."""
    starts = _of_the_scene(make_scene(scene), scene, expert, COUNTED_STARTS, key)
    collision, bounds = starts.rejected_collision / starts.attempted, starts.rejected_bounds / starts.attempted
    return {
        "rejected_starts_share": collision + bounds,
        "rejected_starts_collision_share": collision,
        "rejected_starts_bounds_share": bounds,
    }


def draw_start(
    scene: Scene,
    scene_settings: SceneSettings,
    expert: ExpertSettings,
    settings: DatasetSettings,
    seed: int,
    index: int,
) -> Starts:
    """Draw start `index` of the dataset, with the account of what was rejected before it.

    Raises:
        BadInput: hardly any start is free.
    """
    margin = planning_margin(expert)
    key = (seed, streams.LABEL_STARTS, index)
    if settings.starts == "paper":
        return _of_the_scene(scene, scene_settings, expert, 1, key)

    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))
    boxes = wide_boxes(scene, scene_settings, expert, settings)
    collisions = outside = 0
    for attempted in range(1, MAX_DRAWS + 1):
        pose = _draw_wide(scene, scene_settings, settings, boxes, generator)
        if ((pose < scene.lower) | (pose > scene.upper)).any():
            outside += 1
        elif clearance(scene, pose) < margin:
            collisions += 1
        else:
            return Starts(pose[None], attempted, collisions, outside)
    raise BadInput(
        f'dataset.starts = "wide": none of {MAX_DRAWS} draws is free with a margin of {margin:g} m; '
        "widen the bounds or move the starts away from the obstacles"
    )


def wide_boxes(
    scene: Scene, scene_settings: SceneSettings, expert: ExpertSettings, settings: DatasetSettings
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The boxes (lower, upper), each of shape (3,), over which wide starts are uniform [m].

    They lie within the box around the paper's starts (two standard deviations), all obstacles and the target, padded,
    and near the obstacle: that under it is its own footprint.
    """
    scene = without_way_over(scene)
    start = scene_settings.start
    mean, std = np.array(start.mean[:2]), np.array(start.std[:2])
    half = scene.obstacle_half_sizes[:, :2].max(-1, initial=0.0)[:, None] * np.sqrt(2)  # holds at any yaw
    corners = [
        (mean - 2 * std)[None],
        (mean + 2 * std)[None],
        scene.target[None, :2],
        scene.obstacle_centers[:, :2] - half,
        scene.obstacle_centers[:, :2] + half,
    ]
    points = np.concatenate(corners)
    lower = np.append(np.maximum(points.min(0) - settings.wide_padding, scene.lower[:2]), scene.lower[2])
    upper = np.append(np.minimum(points.max(0) + settings.wide_padding, scene.upper[:2]), scene.upper[2])
    if len(scene.obstacle_centers) == 0:
        return [(lower, upper)]

    boxes = []
    outer = [parts[0] for parts in obstacle_boxes(scene)]  # legs are within their table's outline
    grown = scene.obstacle_half_sizes + scene.torso_half_size + planning_margin(expert)
    for center, body in zip(scene.obstacle_centers[outer], grown[outer], strict=True):
        for _, axis, sign in BOX_FACES:
            low, high = lower.copy(), upper.copy()
            reach = body[:2] + (0.0 if axis == 2 else settings.wide_padding)
            for other in {0, 1} - {axis}:
                low[other] = max(low[other], center[other] - reach[other])
                high[other] = min(high[other], center[other] + reach[other])
            if sign > 0:
                low[axis] = max(low[axis], center[axis] + body[axis])
            else:
                high[axis] = min(high[axis], center[axis] - body[axis])
            if (low <= high).all():
                boxes.append((low, high))
    return boxes or [(lower, upper)]


def _of_the_scene(
    scene: Scene, settings: SceneSettings, expert: ExpertSettings, count: int, key: tuple[int, ...]
) -> Starts:
    mean, std = np.array(settings.start.mean), np.array(settings.start.std)
    return sample_starts(scene, mean, std, count, planning_margin(expert), key)


def _draw_wide(
    scene: Scene,
    scene_settings: SceneSettings,
    settings: DatasetSettings,
    boxes: list[tuple[np.ndarray, np.ndarray]],
    generator: np.random.Generator,
) -> np.ndarray:
    """One pose of the mixture, shape (4,), free or not."""
    kind = generator.random()
    normal = generator.standard_normal(POSE_SIZE)
    uniform = generator.random(POSE_SIZE)
    pose = np.empty(POSE_SIZE)
    pose[2] = scene.lower[2] + uniform[2] * (scene.upper[2] - scene.lower[2])
    pose[3] = np.clip(scene.target[3] + settings.wide_yaw_std * normal[3], scene.lower[3], scene.upper[3])
    if kind < settings.wide_paper_fraction:
        start = scene_settings.start
        pose[:2] = np.array(start.mean[:2]) + np.array(start.std[:2]) * normal[:2]
    elif kind < settings.wide_paper_fraction + settings.wide_target_fraction:
        pose[:2] = scene.target[:2] + settings.wide_target_std * normal[:2]
    else:
        low, high = boxes[int(generator.integers(len(boxes)))]
        pose[:3] = low + uniform[:3] * (high - low)
    return pose
