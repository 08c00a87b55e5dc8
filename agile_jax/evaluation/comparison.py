"""Two evaluations from the same starts, compared episode by episode."""

import pathlib

import numpy as np

from agile_jax.evaluation.kept import Columns, find_evaluation
from agile_jax.evaluation.statistics import mcnemar_p_value, wilson_interval
from agile_jax.settings import BadInput
from agile_jax.store.npz import load_npz

NEEDED = ("start", "success", "arrival_time")


def compare(first: pathlib.Path | str, second: pathlib.Path | str, backend: str = "mujoco") -> dict[str, object]:
    """Pair the episodes of two evaluations.

    Args:
        first, second: RUN_DIR, or RUN_DIR:NAME for one of several evaluations of a run (kept.find_evaluation).
        backend: of the evaluations of a RUN_DIR without a name.

    Returns:
        Success rates with Wilson intervals, the four counts of pairs, McNemar's exact p-value, and over the starts from
        which both arrive the median ratio of arrival times (second over first) with the share of starts where the
        second is faster.

    Raises:
        BadInput: an evaluation is missing or damaged, or the starts differ.
    """
    one, other = _load(first, backend), _load(second, backend)
    if one["start"].shape != other["start"].shape or not np.array_equal(one["start"], other["start"]):
        raise BadInput(
            f"{first} and {second} were evaluated from different starts ({len(one['start'])} and "
            f"{len(other['start'])}); the same scene, seed, evaluation.episodes and evaluation.seed give the same ones"
        )
    a, b = one["success"].astype(bool), other["success"].astype(bool)
    only_first, only_second = int((a & ~b).sum()), int((~a & b).sum())
    both = a & b
    ratio = other["arrival_time"][both] / one["arrival_time"][both]
    count = len(a)
    return {
        "episodes": count,
        "success_rate_first": float(a.mean()),
        "success_interval_first": list(wilson_interval(int(a.sum()), count)),
        "success_rate_second": float(b.mean()),
        "success_interval_second": list(wilson_interval(int(b.sum()), count)),
        "both": int(both.sum()),
        "only_first": only_first,
        "only_second": only_second,
        "neither": int((~a & ~b).sum()),
        "mcnemar_p": mcnemar_p_value(only_first, only_second),
        "arrival_time_ratio_median": float(np.median(ratio)) if len(ratio) else None,
        "second_is_faster": float((ratio < 1).mean()) if len(ratio) else None,
    }


def _load(which: pathlib.Path | str, backend: str) -> Columns:
    path = find_evaluation(which, backend)
    if not path.is_file():
        raise BadInput(f"{path}: there is no such evaluation; `agile evaluate` makes it")
    columns = load_npz(path, NEEDED)
    return {name: columns[name] for name in NEEDED}
