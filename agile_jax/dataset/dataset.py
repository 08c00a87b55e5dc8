"""Reading a dataset: verified trajectories, split by trajectory, and the samples that a policy learns from."""

import pathlib
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from agile_jax.dataset.settings import DatasetSettings
from agile_jax.dataset.shard import RESIDUALS, SCHEMA, check_shard
from agile_jax.expert import Residuals, rejection
from agile_jax.files import read_json, sha256
from agile_jax.geometry import GOLDEN
from agile_jax.scene import POSE_SIZE, streams
from agile_jax.settings import BadInput
from agile_jax.store.npz import Arrays, read_keyed

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")


class Dataset(NamedTuple):
    """n verified trajectories of T intervals."""

    indices: Int[np.ndarray, " n"]  # of the trajectories in the order of drawing; failed ones are missing
    times: Float[np.ndarray, "n nodes"]  # [s]
    states: Float[np.ndarray, "n nodes 8"]  # [m, rad, m/s, rad/s]
    controls: Float[np.ndarray, "n controls 4"]  # one an interval, or one a node [m/s^2, rad/s^2]
    starts: Float[np.ndarray, "n 4"]  # [m, rad]
    targets: Float[np.ndarray, "n 4"]  # [m, rad]; where the yaw may go round, a trajectory may end full turns away
    durations: Float[np.ndarray, " n"]  # [s]
    lower_bounds: Float[np.ndarray, " n"]  # [s]
    branches: Shaped[np.ndarray, " n"]  # names
    seed: int
    dataset_hash: str


def accepted(arrays: Arrays) -> Bool[np.ndarray, " n"]:
    """Which labels of a shard are solved with residuals within the verifier's tolerances."""
    residuals = zip(*(arrays[name] for name in RESIDUALS), strict=True)
    return arrays["solved"] & np.array([rejection(Residuals(*r)) is None for r in residuals], bool)


def load(directory: pathlib.Path | str) -> Dataset:
    """Load a finished dataset; every shard is checked against the manifest's sha256 before it is read.

    Raises:
        BadInput: no dataset there, or a file of it is damaged.
    """
    directory = pathlib.Path(directory)
    manifest = read_manifest(directory)
    if manifest is None:
        raise BadInput(f"{directory / 'manifest.json'} is missing or damaged: generate the dataset (again) first")
    try:
        if manifest["schema_version"] != SCHEMA:
            raise BadInput(
                f"{directory / 'manifest.json'}: schema_version {manifest['schema_version']} is not {SCHEMA}"
            )
        key, seed, dataset_hash = str(manifest["key"]), int(manifest["seed"]), str(manifest["dataset_hash"])
        entries = [(str(e["file"]), str(e["sha256"]), int(e["trajectories"])) for e in manifest["shards"]]
    except (KeyError, TypeError, ValueError) as error:
        raise BadInput(f"{directory / 'manifest.json'} is damaged ({type(error).__name__}: {error})") from None
    parts = []
    for name, digest, count in entries:
        try:
            data = (directory / name).read_bytes()
            if sha256(data) != digest:
                raise ValueError("its sha256 is not the manifest's")
            arrays = read_keyed(data, key)
            check_shard(arrays)
        except (OSError, ValueError) as error:
            raise BadInput(f"{directory / name}: {error}; the command that made it repairs it") from None
        arrays = {name: rows[:count] for name, rows in arrays.items()}
        keep = accepted(arrays)
        parts.append({name: rows[keep] for name, rows in arrays.items()})
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Dataset(
        indices=whole["index"],
        times=whole["times"],
        states=whole["states"],
        controls=whole["controls"],
        starts=whole["start"],
        targets=whole["target"],
        durations=whole["duration"],
        lower_bounds=whole["lower_bound"],
        branches=whole["branch"],
        seed=seed,
        dataset_hash=dataset_hash,
    )


def read_manifest(directory: pathlib.Path) -> dict[str, Any] | None:
    """The manifest, or None when there is none that can be read."""
    manifest = read_json(directory / "manifest.json")
    return manifest if manifest is not None and isinstance(manifest.get("shards"), list) else None


def labels_to(dataset: Dataset, target: Float[np.ndarray, "4"]) -> Dataset:
    """The trajectories that lead to one target [m, rad].

    Raises:
        BadInput: there is none.
    """
    chosen = (dataset.targets == np.asarray(target)).all(1)
    if not chosen.any():
        others = np.unique(dataset.targets, axis=0).tolist()
        raise BadInput(
            f"no label leads to scene.target = {np.asarray(target).tolist()}, which the policy is of; they lead to "
            f"{', '.join(map(str, others)) or 'nowhere: there are none'}; add it to dataset.targets"
        )
    return dataset._replace(
        **{name: value[chosen] for name, value in dataset._asdict().items() if isinstance(value, np.ndarray)}
    )


def split_mask(dataset: Dataset, split: Split, settings: DatasetSettings) -> Bool[np.ndarray, " n"]:
    """Which trajectories belong to a split.

    A pure function of (seed, trajectory index), whatever else is in the dataset: a golden-ratio sequence with an
    offset from the seed, which keeps the fractions in every stretch of indices.
    """
    offset = np.random.Generator(np.random.Philox(np.random.SeedSequence((dataset.seed, streams.SPLIT)))).random()
    position = (offset + dataset.indices * GOLDEN) % 1.0
    edges = np.cumsum((0.0, *settings.split))
    i = SPLITS.index(split)
    upper = np.inf if i == len(SPLITS) - 1 else edges[i + 1]  # rounding of the sum loses nobody
    return (position >= edges[i]) & (position < upper)


def labels(dataset: Dataset, settings: DatasetSettings) -> Float[np.ndarray, "n nodes 4"]:
    """What is learned at each node: velocities [m/s, rad/s], or displacements to the next node
    [m, rad]."""
    if settings.label_kind == "velocity":
        return dataset.states[..., POSE_SIZE:]
    poses = dataset.states[..., :POSE_SIZE]
    return np.diff(poses, axis=1, append=poses[:, -1:])


def samples(
    dataset: Dataset, split: Split, settings: DatasetSettings
) -> tuple[Float[np.ndarray, "m 4"], Float[np.ndarray, "m 4"]]:
    """The samples of a split: poses [m, rad] and their labels as `labels` has them."""
    poses, targets = dataset.states[..., :POSE_SIZE], labels(dataset, settings)
    keep = np.broadcast_to(split_mask(dataset, split, settings)[:, None], poses.shape[:2])
    if settings.split_by == "sample":
        keep = _sample_mask(dataset, split, settings)
    if settings.samples == "without_start":
        keep = keep & (dataset.times >= settings.start_seconds)
    return poses[keep], targets[keep]


def _sample_mask(dataset: Dataset, split: Split, settings: DatasetSettings) -> Bool[np.ndarray, "n nodes"]:
    """Which samples belong to a split when they are dealt out one by one; a function of the seed."""
    shape = dataset.states.shape[:2]
    sequence = np.random.SeedSequence((dataset.seed, streams.SAMPLE_SPLIT))
    order = np.random.Generator(np.random.Philox(sequence)).permutation(np.prod(shape))
    edges = np.round(np.cumsum((0.0, *settings.split)) * len(order)).astype(int)
    i = SPLITS.index(split)
    mask = np.zeros(len(order), bool)
    mask[order[edges[i] : edges[i + 1]]] = True
    return mask.reshape(shape)
