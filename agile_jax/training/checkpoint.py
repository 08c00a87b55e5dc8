"""Checkpoints of the training: the only module that knows Orbax.

Orbax commits a step atomically but does not checksum the arrays: a flipped bit is restored in silence. So each step
also holds `integrity.json`, written last, with the sha256 of every other file and the identity of the run that made
it. Where a training goes on, a step whose files disagree with it, or that has none because the process was killed
before, is set aside (renamed `<step>.damaged`), which is said in one line, and the step before is used. Where a
finished training is read, only the step that it ended with will do (finished.py).
"""

import json
import os
import pathlib
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import jax
import orbax.checkpoint as ocp
from jax.experimental import multihost_utils
from jaxtyping import PyTree

from agile_jax.expert import MotionLimits
from agile_jax.files import hash_json, sha256, sync_folder, write_json
from agile_jax.policy import Policy, PolicyParameters, PolicySettings, TrainedPolicy, make_policy
from agile_jax.scene import Scene
from agile_jax.settings import BadInput
from agile_jax.single_precision import in_single_precision
from agile_jax.store.artefact import differences
from agile_jax.training.finished import CHECKPOINTS, INTEGRITY, read_finished
from agile_jax.training.metrics import Row

Identity = Mapping[str, object]
"""What must be equal for a training to go on from a checkpoint, as JSON: settings, inputs (store/artefact.py)."""


@dataclass(frozen=True)
class Keeping:
    """Where a training is kept: metrics.jsonl, tensorboard/, checkpoints/, finished.json.

    Attributes:
        directory: of them.
        identity: of samples, policy, settings and seed, as JSON; a checkpoint of another identity is refused.
    """

    directory: pathlib.Path
    identity: Identity

    def inside(self, name: str, more: Mapping[str, object]) -> "Keeping":
        """A folder in this one, for a training that also depends on `more`."""
        return Keeping(self.directory / name, {**self.identity, **more})


class Checkpoint(NamedTuple):
    """One step of a training."""

    step: int  # epochs done
    state: PyTree  # all from which the training goes on; None when not asked for
    policy: PolicyParameters  # what the training would have made of its policy, had it ended here
    rows: list[Row]  # of metrics.jsonl
    seconds: float  # in epochs


def save_checkpoint(folder: pathlib.Path, checkpoint: Checkpoint, identity: Identity, keep: int) -> None:
    """Write a step, then its integrity.json; delete all but the last `keep` steps.

    Args:
        folder: holds one folder a step.
        checkpoint: what to write.
        identity: of the run.
        keep: steps kept, at least 2.

    Raises:
        OSError: the disk is full or cannot be written; the steps before are whole.
    """
    path = folder / str(checkpoint.step)
    first = jax.process_index() == 0  # of several hosts, which share the folder, one writes what Orbax does not
    if first:
        _remove_unfinished(folder)
    metadata = {"rows": checkpoint.rows, "seconds": checkpoint.seconds}
    try:
        with _manager(folder, keep) as manager:
            manager.save(
                checkpoint.step,
                args=ocp.args.Composite(
                    state=ocp.args.StandardSave(checkpoint.state),
                    policy=ocp.args.StandardSave(checkpoint.policy),
                    metadata=ocp.args.JsonSave(metadata),
                ),
            )
            manager.wait_until_finished()
        if first:
            content = {"files": _hashes(path), "identity": identity, "shapes": _shapes(checkpoint.policy)}
            write_json(path / INTEGRITY, content | {"sha256": hash_json(content)})
        if jax.process_count() > 1:
            multihost_utils.sync_global_devices(f"checkpoint {checkpoint.step}")
    except ValueError as error:  # Orbax's word for a failed write: a page of text with the system's error code in it
        code = re.search(r"os_error_code='(\d+)'", str(error))
        if code is None:
            raise
        _remove_unfinished(folder)
        raise OSError(int(code[1]), f"{os.strerror(int(code[1]))}, saving a checkpoint", str(path)) from error


def restore_checkpoint(
    folder: pathlib.Path,
    policy: PolicyParameters,
    state: PyTree = None,
    identity: Identity | None = None,
    tell: Callable[[str], None] = print,
) -> Checkpoint | None:
    """The last sound step, from which a training goes on; None when there is none.

    Args:
        folder: of `save_checkpoint`.
        policy, state: arrays, where they shall be placed, or jax.ShapeDtypeStruct, of the expected structure; without
            `state` it is not read.
        identity: of this run; not compared when None.
        tell: is given one line for each step that was set aside.

    Raises:
        BadInput: the last sound step was made with another identity or another network.
    """
    steps = sorted((int(path.name) for path in folder.glob("*") if path.is_dir() and path.name.isdigit()), reverse=True)
    for step in steps:
        path = folder / str(step)
        content, damage = _verified(path)
        if content is None:
            tell(f"{path}: {damage}; set aside, using the step before")
            _set_aside(path)
            continue
        if identity is not None and content["identity"] != json.loads(json.dumps(identity)):
            raise BadInput(
                f"{folder} was made with other settings: {'; '.join(differences(content['identity'], identity))}. "
                "Use another run directory, or delete this folder to train anew"
            )
        return _restore(folder, step, content, policy, state)
    return None


def load_policy(directory: pathlib.Path, scene: Scene, limits: MotionLimits, settings: PolicySettings) -> TrainedPolicy:
    """The policy that a finished training has ended with.

    Args:
        directory: of the training stage, in a run directory.
        scene, limits, settings: with which it was trained.

    Raises:
        BadInput: the training is not finished, its checkpoint is damaged, or it holds another network.
    """
    policy = make_policy(scene, limits, settings)
    return TrainedPolicy(policy, load_parameters(directory, policy))


@in_single_precision
def load_parameters(directory: pathlib.Path, policy: Policy) -> PolicyParameters:
    """The parameters of a policy that a finished training has ended with; see `load_policy`."""
    finished, folder = read_finished(directory), directory / CHECKPOINTS
    remedy = f"`agile train {directory.parent}` goes on from the last sound checkpoint"
    if finished is None:
        raise BadInput(f"{directory}: the training is not finished; {remedy}")
    path = folder / str(finished.step)
    content, damage = _verified(path)
    if content is not None and sha256((path / INTEGRITY).read_bytes()) != finished.digest:
        content, damage = None, "is not the checkpoint that the training ended with"
    if content is None:
        raise BadInput(f"{path}: {damage}; {remedy}")
    expected = jax.eval_shape(policy.init, jax.random.key(0))
    return _restore(folder, finished.step, content, expected, None).policy


def _restore(
    folder: pathlib.Path, step: int, content: dict[str, object], policy: PolicyParameters, state: PyTree
) -> Checkpoint:
    """A step whose files are sound; `content` is its integrity.json's."""
    if content["shapes"] != _shapes(policy):
        raise BadInput(f"{folder} holds another network: {'; '.join(differences(content['shapes'], _shapes(policy)))}")
    items = {"policy": ocp.args.StandardRestore(_placed(policy)), "metadata": ocp.args.JsonRestore()}
    if state is not None:
        items["state"] = ocp.args.StandardRestore(_placed(state))
    with _manager(folder, None) as manager:
        restored = manager.restore(step, args=ocp.args.Composite(**items))
    metadata = restored["metadata"]
    return Checkpoint(step, restored.get("state"), restored["policy"], metadata["rows"], metadata["seconds"])


@contextmanager
def _manager(folder: pathlib.Path, keep: int | None) -> Iterator[ocp.CheckpointManager]:
    options = ocp.CheckpointManagerOptions(max_to_keep=keep, enable_async_checkpointing=False, create=True)
    with ocp.CheckpointManager(folder.absolute(), options=options) as manager:
        yield manager


def _remove_unfinished(folder: pathlib.Path) -> None:
    """Delete what a kill or a full disk has left of a step that Orbax had not yet committed."""
    for path in folder.glob("*.orbax-checkpoint-tmp*"):
        shutil.rmtree(path, ignore_errors=True)


def _hashes(path: pathlib.Path) -> dict[str, str]:
    """The sha256 of every file below a step's folder but integrity.json, by its relative path."""
    files = (file for file in path.rglob("*") if file.is_file() and file != path / INTEGRITY)
    return {file.relative_to(path).as_posix(): sha256(file.read_bytes()) for file in sorted(files)}


def _verified(path: pathlib.Path) -> tuple[dict[str, object] | None, str]:
    """The content of a sound step's integrity.json, or None and what is wrong."""
    try:
        content = json.loads((path / INTEGRITY).read_text())
        digest = content.pop("sha256")
        if hash_json(content) != digest:
            return None, f"{INTEGRITY} is damaged"
        found, listed = _hashes(path), content["files"]
        changed = sorted(name for name in found.keys() | listed.keys() if found.get(name) != listed.get(name))
    except FileNotFoundError:
        return None, f"has no {INTEGRITY} (killed while saving?)" if path.is_dir() else "is missing"
    except (OSError, ValueError, KeyError, AttributeError) as error:
        return None, f"{INTEGRITY} is damaged ({type(error).__name__})"
    return (None, f"damaged file {changed[0]}") if changed else (content, "")


def _set_aside(path: pathlib.Path) -> None:
    """Rename a step to `<step>.damaged`; a read-only folder is left as it is."""
    aside = path.with_name(f"{path.name}.damaged")
    try:
        if aside.exists():
            shutil.rmtree(aside)
        path.rename(aside)
        sync_folder(path.parent)
    except OSError:
        return


def _shapes(tree: PyTree) -> dict[str, list[int]]:
    """The shape of every leaf by its path."""
    return {jax.tree_util.keystr(key): list(leaf.shape) for key, leaf in jax.tree_util.tree_leaves_with_path(tree)}


def _placed(tree: PyTree) -> PyTree:
    """What Orbax shall restore: on the devices that hold `tree`, whichever saved it; abstract leaves on the first."""
    first = jax.sharding.SingleDeviceSharding(jax.devices()[0])
    return jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=getattr(leaf, "sharding", None) or first),
        tree,
    )
