"""A shard: the labels of some consecutive trajectories, as one npz file whose bytes are a pure function of settings,
seed and index.

Solve times are therefore not inside. Failed labels are kept with their cause; their arrays are zero.
"""

import pathlib
import time
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from agile_jax.dataset.expert_time import expert_of
from agile_jax.dataset.settings import DatasetSettings
from agile_jax.dataset.starts import draw_start
from agile_jax.expert import ExpertSettings, ExpertSolution, Residuals
from agile_jax.scene import POSE_SIZE, SceneSettings, make_scene
from agile_jax.store.artefact import LABELS, key
from agile_jax.store.npz import Arrays
from agile_jax.store.parts import Made, Parts

SCHEMA = 4
CAUSE_LENGTH, BRANCH_LENGTH, METHOD_LENGTH = 480, 48, 24
RESIDUALS = Residuals._fields
NUMBERS = ("duration", "lower_bound", "gap", "objective", *RESIDUALS)
_KINDS = {"index": "i", "draws": "i", "solved": "b", "branch": "U", "method": "U", "cause": "U"}  # others are floats


class LabelSettings(NamedTuple):
    """What labels are made from."""

    scene: SceneSettings
    expert: ExpertSettings
    dataset: DatasetSettings
    seed: int

    def tables(self) -> dict[str, object]:
        """As plain tables, as an experiment has them."""
        sections = {"scene": self.scene, "expert": self.expert, "dataset": self.dataset}
        return {"seed": self.seed} | {name: part.model_dump(mode="json") for name, part in sections.items()}

    def of_the_problem(self) -> dict[str, object]:
        """What labels made elsewhere must agree in with the experiment that uses them, as plain tables."""
        bounds = {"velocity", "acceleration", "clearance_margin", "initial_velocity"}
        return {
            "scene": self.scene.model_dump(mode="json", exclude={"start"}),
            "expert": self.expert.model_dump(mode="json", include=bounds),
        }

    def target(self, index: int) -> Float[np.ndarray, "4"]:
        """The target of a trajectory [m, rad]: the settings' in turn, the scene's if they have none."""
        targets = self.dataset.targets or (self.scene.target,)
        return np.array(targets[index % len(targets)])


class ShardTask(NamedTuple):
    """What a worker needs to make labels of one shard."""

    settings: LabelSettings
    indices: tuple[int, ...]  # of the trajectories


def labels_at(
    directory: pathlib.Path,
    settings: LabelSettings,
    listed: Mapping[str, tuple[int, str]] | None = None,
    made_elsewhere: str = "",
) -> Parts:
    """The labels of a dataset, as far as they are there.

    Args:
        directory: of the dataset.
        settings: what they are made from.
        listed: rows and sha256 of the files in its manifest.
        made_elsewhere: the digest of labels that the expert has not made.
    """
    return Parts(
        directory,
        LABELS.name,
        key(LABELS, settings.tables(), foreign={"labels": made_elsewhere} if made_elsewhere else None),
        np.arange(settings.dataset.trajectories),
        settings.dataset.shard_size,
        name="shard",
        item_name="index",
        check=check_shard,
        listed=listed,
    )


def make_shard(task: ShardTask) -> Made:
    """Draw the starts of some labels and solve them. Runs in a worker."""
    began = time.perf_counter()
    settings = task.settings
    scene, expert = make_scene(settings.scene), expert_of(settings.scene, settings.expert)
    solutions: list[ExpertSolution] = []
    starts, targets, accounts = [], [], []
    for i in task.indices:
        target = settings.target(i)
        world = scene._replace(target=target)
        drawn = draw_start(world, settings.scene, settings.expert, settings.dataset, settings.seed, i)
        starts.append(drawn.poses[0])
        targets.append(target)
        accounts.append((drawn.attempted, drawn.rejected_collision, drawn.rejected_bounds))
        solutions.append(expert.solve(drawn.poses[0], target=target))
    arrays = {
        "start": np.array(starts),
        "target": np.array(targets),
        "draws": np.array(accounts, dtype=np.int64),
        **rows_of(solutions),
    }
    times = [round(1e3 * s.solve_time_s, 3) for s in solutions]
    return Made(arrays, {"seconds": time.perf_counter() - began, "solve_ms": times})


def rows_of(solutions: list[ExpertSolution]) -> Arrays:
    """The columns of a shard that tell of solutions."""
    return {
        "times": np.stack([s.trajectory.times for s in solutions]),
        "states": np.stack([s.trajectory.states for s in solutions]),
        "controls": np.stack([s.trajectory.controls for s in solutions]),
        "solved": np.array([s.status == "solved" for s in solutions]),
        "branch": np.array([s.branch[:BRANCH_LENGTH] for s in solutions], dtype=f"U{BRANCH_LENGTH}"),
        "method": np.array([s.method[:METHOD_LENGTH] for s in solutions], dtype=f"U{METHOD_LENGTH}"),
        "cause": np.array([s.cause[:CAUSE_LENGTH] for s in solutions], dtype=f"U{CAUSE_LENGTH}"),
        **{name: np.array([getattr(s, name) for s in solutions], float) for name in NUMBERS},
    }


def check_shard(rows: Arrays) -> None:
    """Refuse rows that no labels can have (ValueError): a missing array, wrong shapes, numbers that are not finite."""
    n, nodes = rows["index"].shape[0], rows["times"].shape[-1] if "times" in rows else 0
    shapes: dict[str, tuple[int, ...]] = {
        "start": (n, POSE_SIZE),
        "target": (n, POSE_SIZE),
        "draws": (n, 3),
        "times": (n, nodes),
        "states": (n, nodes, 2 * POSE_SIZE),
        **dict.fromkeys(("index", "solved", "branch", "method", "cause", *NUMBERS), (n,)),
    }
    for name in (*shapes, "controls"):
        if name not in rows:
            raise ValueError(f"array {name} is missing")
        array, kind = rows[name], _KINDS.get(name, "f")
        fits = array.shape == shapes[name] if name in shapes else array.shape in _control_shapes(n, nodes)
        if not fits or array.dtype.kind != kind:
            raise ValueError(f"array {name} has shape {array.shape} and type {array.dtype}")
        if kind == "f" and name != "min_clearance" and not np.isfinite(array).all():
            raise ValueError(f"array {name} holds values that are not finite")


def _control_shapes(n: int, nodes: int) -> tuple[tuple[int, ...], ...]:
    """One control an interval, or one a node."""
    return (n, nodes - 1, POSE_SIZE), (n, nodes, POSE_SIZE)
