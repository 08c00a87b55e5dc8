"""Recorded episodes as files."""

import pathlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Shaped

from agile_jax.settings import BadInput
from agile_jax.simulation import Trace
from agile_jax.store.npz import NpzError, read_npz, write_npz


def save_traces(path: pathlib.Path, traces: Sequence[Trace]) -> None:
    """Traces padded to the longest with their last sample; `length` (n,) tells how many samples count."""
    longest = max(len(trace.time) for trace in traces)

    def pad(values: Shaped[np.ndarray, "k ..."]) -> Shaped[np.ndarray, "longest ..."]:
        return np.concatenate([values, np.repeat(values[-1:], longest - len(values), 0)])

    columns = {name: np.stack([pad(getattr(trace, name)) for trace in traces]) for name in Trace._fields}
    write_npz(path, {"length": np.array([len(trace.time) for trace in traces]), **columns})


def load_traces(path: pathlib.Path) -> list[Trace]:
    """What `save_traces` wrote.

    Raises:
        BadInput: no such file, or it holds no traces.
    """
    if not path.exists():
        raise BadInput(f"{path}: no such file")
    try:
        columns = read_npz(path)
        return [Trace(*(columns[name][i, :n] for name in Trace._fields)) for i, n in enumerate(columns["length"])]
    except (NpzError, KeyError, IndexError) as error:
        raise BadInput(f"{path}: holds no recorded episodes ({type(error).__name__}: {error})") from None
