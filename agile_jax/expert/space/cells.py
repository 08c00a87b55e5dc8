"""The cells of an obstacle: convex parts of the space around it that overlap and together cover all that is free.

For an obstacle that is one box they are what lies beyond each of its faces; for one of several boxes, the largest
boxes that hold none of them (empty_boxes.py). regions.py says what the two accounts, boxes and exact, are. A pose can
keep the margin without being beyond any face, diagonally off an edge: such a start or target gets a cell of its own.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from agile_jax.expert.space.empty_boxes import Plane, largest_empty_boxes
from agile_jax.expert.space.footprint import footprint, footprint_range
from agile_jax.expert.space.polygons import planar_separation
from agile_jax.geometry import rotation_2d, support
from agile_jax.scene import BOX_FACES, Scene

CONTAINMENT = 1e-9  # [m]
PARALLEL = 1e-9  # [rad] an obstacle nearer to the axes than this is parallel to them
EndPoses = tuple[np.ndarray, np.ndarray]  # start and target, poses of shape (4,)


class Face(NamedTuple):
    """A plane that the torso stays beyond."""

    normal: np.ndarray  # (3,) away from the obstacle
    value: float  # the pose's position along the normal when the torso touches the face with its least footprint [m]
    reach: float  # how much larger that can be with other yaws [m]
    least: float  # footprint [m] on that face
    row: np.ndarray | None  # (4,) normal and offset of what the corners keep beyond; None where the cell's box says it
    crossable: bool = True  # whether routes may cross from region to region at it

    @property
    def axis(self) -> int:
        """The axis that the normal is nearest to."""
        sizes = [abs(component) for component in self.normal.tolist()]
        return sizes.index(max(sizes))


class Cell(NamedTuple):
    """A convex part of the space around one obstacle, in poses."""

    name: str  # of BOX_FACES, or "" for the cell around a start or target that is diagonally off an edge
    faces: tuple[Face, ...]  # that bound it
    lower: np.ndarray  # (4,) box around it, of the pose
    upper: np.ndarray  # (4,)

    @property
    def rows(self) -> list[np.ndarray]:
        """The rows of those of its faces that its box does not say."""
        return [face.row for face in self.faces if face.row is not None]


def box_cells(
    scene: Scene,
    boxes: list[int],
    margin: float,
    lower: np.ndarray,
    upper: np.ndarray,
    end_poses: EndPoses,
) -> list[Cell]:
    """The cells of an obstacle's bounding boxes, for the footprint over the whole interval of yaw."""
    torso = np.append(footprint(scene.torso_half_size, (lower[3], upper[3])), scene.torso_half_size[2])
    centers, yaw = scene.obstacle_centers[boxes], scene.obstacle_yaws[boxes[0]]
    bodies = torso + np.array(  # touching
        [np.append(footprint(half, (yaw, yaw)), half[2]) for half in scene.obstacle_half_sizes[boxes]]
    )

    def face(plane: Plane) -> Face:
        axis, sign, box = plane
        normal = np.zeros(3)
        normal[axis] = sign
        return Face(normal, float(normal @ centers[box] + bodies[box, axis] + margin), 0.0, 0.0, None)

    reach = bodies + margin
    cells = [
        _half_space_cell(name, [face(plane) for plane in planes], lower, upper)
        for name, planes in _cells_of_boxes(centers - reach, centers + reach)
    ]
    corners = [_corner_cell(pose, centers, bodies, margin, lower, upper) for pose in end_poses]
    return [*cells, *(cell for cell in corners if cell is not None)]


def _cells_of_boxes(lower: np.ndarray, upper: np.ndarray) -> Iterator[tuple[str, tuple[Plane, ...]]]:
    """Name and planes of the cells of an obstacle made of boxes with these corners, shape (K, 3)."""
    if len(lower) == 1:  # what follows would give the same
        for name, axis, sign in BOX_FACES:
            yield name, (Plane(axis, sign, 0),)
        return
    names = {(axis, sign): name for name, axis, sign in BOX_FACES}
    for box in largest_empty_boxes(lower, upper):
        # Between legs is under the table: heights say more than directions.
        yield names[max(((plane.axis, plane.sign) for plane in box.planes), key=lambda face: face[0])], box.planes


def _half_space_cell(name: str, faces: Sequence[Face], lower: np.ndarray, upper: np.ndarray) -> Cell:
    """What lies beyond faces."""
    for face in faces:
        lower, upper = half_space_box(face.normal, face.value, lower, upper)
    return Cell(name, tuple(faces), lower, upper)


def exact_cells(
    scene: Scene,
    boxes: list[int],
    margin: float,
    lower: np.ndarray,
    upper: np.ndarray,
    end_poses: EndPoses,
) -> list[Cell]:
    """The cells of an obstacle with its own yaw; the footprint is left to the rows."""
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
        row = None if flat else np.append(normal, offset)
        return Face(normal, offset + least, most - least, least, row)

    def face_of(plane: Plane) -> Face:
        axis, sign, box = plane
        normal = sign * rotation[:, axis]
        return face(normal, float(normal @ centers[box] + bodies[box, axis] + margin))

    least = [footprint_range(torso, rotation[:, axis], yaws)[0] for axis in range(3)]
    local, reach = (centers - centers[0]) @ rotation, bodies + least + margin
    cells = [
        _half_space_cell(name, [face_of(plane) for plane in planes], lower, upper)
        for name, planes in _cells_of_boxes(local - reach, local + reach)
    ]
    for pose in end_poses:
        if any(_beyond(existing, pose, torso) for existing in cells):
            continue
        faces = []
        for box in range(len(boxes)):
            around = [
                _half_space_cell("", [face_of(Plane(axis, sign, box))], lower, upper) for _, axis, sign in BOX_FACES
            ]
            if (beyond := next((cell for cell in around if _beyond(cell, pose, torso)), None)) is not None:
                faces.append(beyond.faces[0])
                continue
            toward = _separation(pose, torso, centers[box], halves[box], own_yaw)
            if np.linalg.norm(toward) < margin:
                break
            normal = toward / np.linalg.norm(toward)
            planar = support(halves[box, :2], normal[:2], own_yaw)
            height = (halves[box, 2] + torso[2]) * abs(normal[2])
            faces.append(face(normal, float(normal @ centers[box] + planar + height) + margin))
        else:
            witness = _half_space_cell("", faces, lower, upper)
            cells.append(witness._replace(faces=tuple(face._replace(crossable=False) for face in faces)))
    return cells


def _separation(pose: np.ndarray, torso: np.ndarray, center: np.ndarray, half: np.ndarray, yaw: float) -> np.ndarray:
    """The shortest vector from a box to the torso, shape (3,) [m]."""
    apart = planar_separation(pose[:2], torso[:2], float(pose[3]), center[:2], half[:2], yaw)
    vertical = float(pose[2] - center[2])
    gap = max(abs(vertical) - half[2] - torso[2], 0.0)
    return np.append(apart, np.copysign(gap, vertical))


def _beyond(cell: Cell, pose: np.ndarray, torso: np.ndarray) -> bool:
    """Whether a pose, shape (4,), is in an exact cell."""
    for face in cell.faces:
        if face.row is None:
            continue
        footprint_now = support(torso[:2], face.row[:2], pose[3])
        if not face.row[:3] @ pose[:3] - footprint_now >= face.row[3] - CONTAINMENT:
            return False
    return bool(
        len(cell.rows) == len(cell.faces)
        or ((pose >= cell.lower - CONTAINMENT).all() and (pose <= cell.upper + CONTAINMENT).all())
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


def _corner_cell(
    pose: np.ndarray, centers: np.ndarray, bodies: np.ndarray, margin: float, lower: np.ndarray, upper: np.ndarray
) -> Cell | None:
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
    return Cell("", (), low, high)
