"""The convex parts of the space around one obstacle.

For an obstacle that is one box they are what lies beyond each of its faces; for one of several boxes, the largest
boxes that hold none of them (empty_boxes.py). regions.py says what the two accounts, boxes and exact, are. A pose can
keep the margin without being beyond any face, diagonally off an edge: such a start or target gets a side of its own.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.space.empty_boxes import Plane, largest_empty_boxes
from agile_jax.expert.space.footprint import footprint, footprint_range
from agile_jax.expert.space.polygons import planar_separation
from agile_jax.geometry import rotation_2d
from agile_jax.scene import BOX_FACES, Scene

CONTAINMENT = 1e-9  # [m]
PARALLEL = 1e-9  # [rad] an obstacle nearer to the axes than this is parallel to them
NO_ROW = np.array([0.0, 0.0, 0.0, -1.0])  # a face that is always kept
Ends = tuple[np.ndarray, np.ndarray]  # start and target, poses of shape (4,)


class Face(NamedTuple):
    """A plane that the torso stays beyond."""

    normal: np.ndarray  # (3,) away from the obstacle; zero where no path is pinned to it
    value: float  # the pose's position along the normal when the torso touches the face with its least footprint [m]
    reach: float  # how much larger that can be with other yaws [m]
    least: float  # footprint [m] on that face
    row: np.ndarray  # (4,) normal and offset of what the corners keep beyond; NO_ROW in boxes

    @property
    def axis(self) -> int:
        """The axis that the normal is nearest to."""
        sizes = [abs(component) for component in self.normal.tolist()]
        return sizes.index(max(sizes))


class Side(NamedTuple):
    """A convex part of the space around one obstacle."""

    name: str  # of BOX_FACES, or "" for the part around a start or target that is diagonally off an edge
    faces: tuple[Face, ...]  # that bound it
    lower: np.ndarray  # (4,) box around it, of the pose
    upper: np.ndarray  # (4,)

    @property
    def rows(self) -> list[np.ndarray]:
        """Of its faces, those that are not kept by its box."""
        return [face.row for face in self.faces if face.row is not NO_ROW]


def box_sides(
    scene: Scene,
    boxes: list[int],
    margin: float,
    lower: np.ndarray,
    upper: np.ndarray,
    ends: Ends,
) -> list[Side]:
    """The sides of an obstacle's bounding boxes, for the footprint over the whole interval of yaw."""
    torso = np.append(footprint(scene.torso_half_size, (lower[3], upper[3])), scene.torso_half_size[2])
    centers, yaw = scene.obstacle_centers[boxes], scene.obstacle_yaws[boxes[0]]
    bodies = torso + np.array(  # touching
        [np.append(footprint(half, (yaw, yaw)), half[2]) for half in scene.obstacle_half_sizes[boxes]]
    )

    def face(plane: Plane) -> Face:
        axis, sign, box = plane
        normal = np.zeros(3)
        normal[axis] = sign
        return Face(normal, float(normal @ centers[box] + bodies[box, axis] + margin), 0.0, 0.0, NO_ROW)

    reach = bodies + margin
    sides = [
        _side(name, [face(plane) for plane in planes], lower, upper)
        for name, planes in _sides_of_boxes(centers - reach, centers + reach)
    ]
    cells = [_cell(pose, centers, bodies, margin, lower, upper) for pose in ends]
    return [*sides, *(cell for cell in cells if cell is not None)]


def _sides_of_boxes(lower: np.ndarray, upper: np.ndarray) -> Iterator[tuple[str, tuple[Plane, ...]]]:
    """Name and planes of the sides of an obstacle made of boxes with these corners, shape (K, 3)."""
    if len(lower) == 1:  # what follows would give the same
        for name, axis, sign in BOX_FACES:
            yield name, ((axis, sign, 0),)
        return
    names = {(axis, sign): name for name, axis, sign in BOX_FACES}
    for box in largest_empty_boxes(lower, upper):
        # Between legs is under the table: heights say more than directions.
        yield names[max((plane[:2] for plane in box.planes), key=lambda plane: plane[0])], box.planes


def _side(name: str, faces: Sequence[Face], lower: np.ndarray, upper: np.ndarray) -> Side:
    """What lies beyond faces."""
    for face in faces:
        lower, upper = half_space_box(face.normal, face.value, lower, upper)
    return Side(name, tuple(faces), lower, upper)


def exact_sides(
    scene: Scene,
    boxes: list[int],
    margin: float,
    lower: np.ndarray,
    upper: np.ndarray,
    ends: Ends,
) -> list[Side]:
    """The sides of an obstacle with its own yaw; the footprint is left to the rows."""
    centers, halves = scene.obstacle_centers[boxes], scene.obstacle_half_sizes[boxes]
    torso, yaws = scene.torso_half_size, (lower[3], upper[3])
    own_yaw = float(scene.obstacle_yaws[boxes[0]])
    turn = round(own_yaw / (np.pi / 2))  # names of faces go by the nearest axis
    planar = halves[:, :2] if turn % 2 == 0 else halves[:, 1::-1]
    bodies = np.column_stack([planar, halves[:, 2] + torso[2]])
    rotation = np.eye(3)
    rotation[:2, :2] = rotation_2d(own_yaw - turn * np.pi / 2)

    def face(normal: np.ndarray, offset: float) -> Face:
        """Poses p with n.p - footprint(n, yaw) >= offset."""
        least, most = footprint_range(torso, normal, yaws)
        flat = bool(np.abs(normal[:2]).max() == 0)  # under and over are bounds, they need no row
        row = NO_ROW if flat else np.append(normal, offset)
        return Face(normal, offset + least, most - least, least, row)

    def face_of(plane: Plane) -> Face:
        axis, sign, box = plane
        normal = sign * rotation[:, axis]
        return face(normal, float(normal @ centers[box] + bodies[box, axis] + margin))

    least = [footprint_range(torso, rotation[:, axis], yaws)[0] for axis in range(3)]
    local, reach = (centers - centers[0]) @ rotation, bodies + least + margin
    sides = [
        _side(name, [face_of(plane) for plane in planes], lower, upper)
        for name, planes in _sides_of_boxes(local - reach, local + reach)
    ]
    for pose in ends:
        if any(_beyond(existing, pose, torso) for existing in sides):
            continue
        faces = []
        for box in range(len(boxes)):
            around = [_side("", [face_of((axis, sign, box))], lower, upper) for _, axis, sign in BOX_FACES]
            if (beyond := next((side for side in around if _beyond(side, pose, torso)), None)) is not None:
                faces.append(beyond.faces[0])
                continue
            toward = _separation(pose, torso, centers[box], halves[box], own_yaw)
            if np.linalg.norm(toward) < margin:
                break
            normal = toward / np.linalg.norm(toward)
            turned = rotation_2d(own_yaw).T @ normal[:2]
            support = float(
                normal @ centers[box] + halves[box, :2] @ np.abs(turned) + (halves[box, 2] + torso[2]) * abs(normal[2])
            )
            faces.append(face(normal, support + margin))
        else:
            witness = _side("", faces, lower, upper)
            sides.append(witness._replace(faces=tuple(face._replace(normal=np.zeros(3)) for face in faces)))
    return sides


def _separation(pose: np.ndarray, torso: np.ndarray, center: np.ndarray, half: np.ndarray, yaw: float) -> np.ndarray:
    """The shortest vector from a box to the torso, shape (3,) [m]."""
    apart = planar_separation(pose[:2], torso[:2], float(pose[3]), center[:2], half[:2], yaw)
    vertical = float(pose[2] - center[2])
    gap = max(abs(vertical) - half[2] - torso[2], 0.0)
    return np.append(apart, np.copysign(gap, vertical))


def _beyond(side: Side, pose: np.ndarray, torso: np.ndarray) -> bool:
    """Whether a pose is on an exact side."""
    for face in side.faces:
        if face.row is NO_ROW:
            continue
        footprint_now = torso[:2] @ np.abs(rotation_2d(pose[3]).T @ face.row[:2])
        if not face.row[:3] @ pose[:3] - footprint_now >= face.row[3] - CONTAINMENT:
            return False
    return bool(
        len(side.rows) == len(side.faces)
        or ((pose >= side.lower - CONTAINMENT).all() and (pose <= side.upper + CONTAINMENT).all())
    )


def half_space_box(
    normal: np.ndarray, value: float, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The box around the part of a box of poses where normal . position >= value; lower > upper when it is empty."""
    low, high = lower.copy(), upper.copy()
    most = np.maximum(normal * lower[:3], normal * upper[:3])
    for axis in [i for i, component in enumerate(normal.tolist()) if abs(component) > PARALLEL]:
        needed = (value - (most.sum() - most[axis])) / normal[axis]
        if normal[axis] > 0:
            low[axis] = max(low[axis], needed)
        else:
            high[axis] = min(high[axis], needed)
    return low, high


def _cell(
    pose: np.ndarray, centers: np.ndarray, bodies: np.ndarray, margin: float, lower: np.ndarray, upper: np.ndarray
) -> Side | None:
    """The box of poses that are on no axis nearer to the obstacle's boxes than `pose`.

    Diagonally off an edge a pose can keep the margin although it is within it on every axis, hence beyond no enlarged
    face. None for all other poses.
    """
    gaps = np.abs(pose[:3] - centers) - bodies  # (K, 3)
    beyond = (gaps >= margin).any(1)
    if beyond.all():
        return None
    low, high = lower.copy(), upper.copy()
    for box, center in enumerate(centers):
        if beyond[box]:
            axis = int(np.argmax(gaps[box]))
            away = np.copysign(bodies[box, axis] + margin, pose[axis] - center[axis])
            limits = {axis: float(center[axis] + away)}
        elif np.linalg.norm(gaps[box][gaps[box] > 0]) < margin:
            return None
        else:
            limits = {axis: float(pose[axis]) for axis in range(3) if gaps[box, axis] > 0}
        for axis, limit in limits.items():
            if pose[axis] > center[axis]:
                low[axis] = max(low[axis], limit)
            else:
                high[axis] = min(high[axis], limit)
    return Side("", (), low, high)
