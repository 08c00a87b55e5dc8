"""The collision constraint of the peers: the largest signed distance along an obstacle's face normals.

    d = max(|q_x| - c_x - e_x,  |q_y| - c_y - e_y,  |q_z| - c_z - e_z) >= margin

q is the torso's centre in the obstacle's frame, c the obstacle's half size, e the torso's half extent along that
frame's axes at its yaw. The maximum is over six faces (|q| = max(q, -q)). It keeps the margin exactly beside a face,
and at an edge up to sqrt(2) times as much. A user would take the maximum itself, or smooth it by log-sum-exp,

    d_smooth = d_max + w log sum_i exp((d_i - d_max) / w),

which exceeds the maximum by up to w log 2 at an edge: it rounds the edge off, as the exact clearance does.
"""

import casadi as ca

from agile_jax.scene import Scene

YAW_SMOOTHING = 1e-6  # rounds the kinks of |sin| and |cos|; adds at most 0.3 mm to the torso


def face_distances(scene: Scene, pose: ca.MX, width: float) -> list[ca.MX]:
    """A CasADi expression for each obstacle, of the pose, shape (4,) [m].

    Args:
        scene: obstacles and torso.
        pose: CasADi expression.
        width: w of the smoothing [m]; 0 takes the maximum itself.
    """
    found = []
    half = scene.torso_half_size
    for center, obstacle, yaw in zip(
        scene.obstacle_centers, scene.obstacle_half_sizes, scene.obstacle_yaws, strict=True
    ):
        x, y, z = (pose[i] - center[i] for i in range(3))
        along, across = ca.cos(yaw) * x + ca.sin(yaw) * y, ca.cos(yaw) * y - ca.sin(yaw) * x
        cos = ca.sqrt(ca.cos(pose[3] - yaw) ** 2 + YAW_SMOOTHING)
        sin = ca.sqrt(ca.sin(pose[3] - yaw) ** 2 + YAW_SMOOTHING)
        reach = (
            obstacle[0] + half[0] * cos + half[1] * sin,
            obstacle[1] + half[0] * sin + half[1] * cos,
            obstacle[2] + half[2],
        )
        faces = [sign * q - r for q, r in zip((along, across, z), reach, strict=True) for sign in (1, -1)]
        found.append(_maximum(ca.vertcat(*faces), width))
    return found


def _maximum(values: ca.MX, width: float) -> ca.MX:
    largest = ca.mmax(values)
    if width == 0:
        return largest
    # Shifted so that nothing overflows. CasADi's own logsumexp cannot be expanded to scalar expressions.
    return largest + width * ca.log(ca.sum1(ca.exp((values - largest) / width)))
