"""Evaluations side by side in a run directory, each in the folder of its key, with its episodes as they ended.

    evaluation/<backend>.json, .npz, -traces.npz, -unstable/    of the evaluation asked for last with this backend
    evaluation/kept/<key>/episodes-*.npz                        rows of episodes; a kill loses those of one file
    evaluation/kept/<key>/traces/, unstable/                    recorded episodes, a file each
    evaluation/kept/<key>/evaluation.json, .npz                 summary and rows, as asked for last
    evaluation/kept/names.json                                  names of evaluations, each with its folder

A file of episodes is whole and of its key, or its episodes are missing and made again.
"""

import pathlib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Shaped

from agile_jax.evaluation.traces import load_traces, save_traces
from agile_jax.files import read_json, write_atomic, write_json
from agile_jax.settings import BadInput
from agile_jax.simulation import Trace
from agile_jax.store.npz import NpzError, keyed_bytes, read_keyed, write_npz

Columns = dict[str, Shaped[np.ndarray, "_ ..."]]  # one entry an episode

KEPT = "kept"  # name of the folder of all evaluations of a run
KEY_LENGTH = 12  # letters of a key in the name of its folder


@dataclass(frozen=True)
class KeptEvaluation:
    """The episodes of one key, and what was made of them.

    Attributes:
        directory: `evaluation` of the run directory.
        key: of the episodes; equal keys mean equal episodes from equal starts.
    """

    directory: pathlib.Path
    key: str

    @property
    def folder(self) -> pathlib.Path:
        """Of this evaluation alone."""
        return self.directory / KEPT / self.key[:KEY_LENGTH]

    def rows(self) -> Columns:
        """All episodes that are there, in order; `episode` holds their numbers. Empty when there is none."""
        parts = [part for path in sorted(self.folder.glob("episodes-*.npz")) if (part := self._read(path))]
        return joined(parts) if parts else {"episode": np.zeros(0, int)}

    def add(self, rows: Columns) -> None:
        """Keep episodes; those that are there already stay as they are."""
        path = self.folder / f"episodes-{rows['episode'].min():06d}.npz"
        there = self._read(path)
        write_atomic(path, keyed_bytes(self.key, joined([rows] if there is None else [there, rows])))

    def trace(self, episode: int) -> Trace | None:
        """A recorded episode; None when it is not there or damaged."""
        try:
            return load_traces(self._trace_path(episode))[0]
        except BadInput:
            return None

    def add_trace(self, episode: int, trace: Trace) -> None:
        """Keep a recorded episode."""
        save_traces(self._trace_path(episode), [trace])

    def add_unstable(self, episode: int, trace: Trace) -> None:
        """Keep the last second of an episode that ended unstable, for `agile rollout --replay`."""
        save_traces(self.folder / f"unstable/episode-{episode:06d}.npz", [trace])

    def publish(
        self,
        backend: str,
        name: str | None,
        columns: Columns,
        summary: Mapping[str, object],
        traces: Sequence[Trace],
    ) -> None:
        """Write what was asked for, here and as the run's last evaluation with this backend, under its names.

        Args:
            backend: of the physics, in the names of the run's files.
            name: that the user gave, besides the backend's.
            columns: the episodes asked for.
            summary: of these.
            traces: recorded ones of these.
        """
        write_npz(self.folder / "evaluation.npz", columns)
        write_json(self.folder / "evaluation.json", summary)
        names = read_json(self.directory / KEPT / "names.json") or {}
        write_json(
            self.directory / KEPT / "names.json", names | dict.fromkeys([backend, name or backend], self.folder.name)
        )
        if traces:
            save_traces(self.directory / f"{backend}-traces.npz", traces)
        else:
            (self.directory / f"{backend}-traces.npz").unlink(missing_ok=True)
        shutil.rmtree(self.directory / f"{backend}-unstable", ignore_errors=True)
        for path in sorted((self.folder / "unstable").glob("episode-*.npz")):
            if int(path.stem.removeprefix("episode-")) < len(columns["outcome"]):
                write_atomic(self.directory / f"{backend}-unstable" / path.name, path.read_bytes())
        for suffix in (".npz", ".json"):
            content = (self.folder / f"evaluation{suffix}").read_bytes()
            write_atomic(self.directory / f"{backend}{suffix}", content)

    def _trace_path(self, episode: int) -> pathlib.Path:
        return self.folder / f"traces/episode-{episode:06d}.npz"

    def _read(self, path: pathlib.Path) -> Columns | None:
        try:
            return read_keyed(path, self.key)
        except NpzError:
            return None


def joined(parts: Sequence[Columns]) -> Columns:
    """Rows in the order of their episodes, each once: the first."""
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    first = np.unique(columns["episode"], return_index=True)[1]
    return {name: values[first] for name, values in columns.items()}


def find_evaluation(which: pathlib.Path | str, backend: str) -> pathlib.Path:
    """The file of the episodes that `which` names.

    Args:
        which: RUN_DIR for its last evaluation with the backend, or RUN_DIR:NAME, where NAME is an evaluation's name or
            the beginning of its key.
        backend: of the physics.

    Raises:
        BadInput: no evaluation, or several, are called so.
    """
    run_dir, colon, name = str(which).rpartition(":")
    if not colon or pathlib.Path(which).is_dir():
        return pathlib.Path(which) / "evaluation" / f"{backend}.npz"
    directory = pathlib.Path(run_dir) / "evaluation" / KEPT
    names = read_json(directory / "names.json") or {}
    keys = sorted(path.parent.name for path in directory.glob("*/evaluation.npz"))
    found = [str(names[name])] if name in names else [key for key in keys if name and key.startswith(name)]
    if len(found) != 1:
        known = [f"{key} ({', '.join(sorted(n for n in names if names[n] == key)) or 'no name'})" for key in keys]
        many = "several evaluations have a key that begins with" if found else "no evaluation is called"
        raise BadInput(f"{run_dir}: {many} {name!r}; it has {', '.join(known) or 'none'}")
    return directory / found[0] / "evaluation.npz"
