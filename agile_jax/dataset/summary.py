"""The account of a dataset: what was drawn, rejected, solved and failed, and how good the labels are."""

from collections import Counter
from collections.abc import Callable, Mapping

import numpy as np

from agile_jax.dataset.dataset import accepted
from agile_jax.expert import CERTIFIED
from agile_jax.store.npz import Arrays

FIRST_METHODS = ("certified", "fatrop")  # the others are attempts that solved what these could not


def summarise(rows: Arrays, notes: Mapping[str, Mapping[str, object]], dataset_hash: str) -> dict[str, object]:
    """The contents of summary.json. Maxima and medians are over the verified trajectories; null when there is none.

    Args:
        rows: of all labels.
        notes: how the shards were made, by name, as far as known: seconds, solve times, number of workers.
        dataset_hash: of the manifest.
    """
    whole, good = rows, accepted(rows)
    solved = whole["solved"]
    certified = (whole["method"] == CERTIFIED) | (whole["gap"] < 1e-3)  # with u_0 = u_N = 0 the gap is 2 / (N - 2)
    seconds, solve_times, workers = _timing(notes)
    drawn, collisions, outside = (int(n) for n in whole["draws"].sum(0))
    causes = Counter(cause.partition(":")[0] for cause in whole["cause"][~solved].tolist())
    methods = dict(sorted(Counter(whole["method"][good].tolist()).items()))

    def over(name: str, reduce: Callable[[np.ndarray], np.floating]) -> float | None:
        return float(reduce(whole[name][good])) if good.any() else None

    return {
        "trajectories": int(good.sum()),
        "attempted": len(solved),
        "drawn_starts": drawn,
        "rejected_starts": collisions + outside,
        "rejected_starts_collision": collisions,
        "rejected_starts_bounds": outside,
        "failed": dict(sorted(causes.items())),
        "unverified": int((solved & ~good).sum()),
        "methods": methods,
        "rescued": {name: count for name, count in methods.items() if name not in FIRST_METHODS},
        "branches": dict(sorted(Counter(whole["branch"][good].tolist()).items())),
        "labels_per_second": len(solve_times) / seconds if seconds > 0 else None,
        "solve_time_ms_median": float(np.median(solve_times)) if solve_times else None,
        "workers": workers,
        "duration_s_median": over("duration", np.median),
        "max_clearance_violation_m": over("clearance_violation", np.max),
        "min_clearance_m": over("min_clearance", np.min) if np.isfinite(whole["min_clearance"]).all() else None,
        "max_dynamics_residual": over("dynamics_residual", np.max),
        "max_integration_defect": over("integration_defect", np.max),
        "max_end_residual": over("end_residual", np.max),
        "max_bound_violation": over("bound_violation", np.max),
        "optimality_gap_median": over("gap", np.median),
        "optimality_gap_p95": over("gap", lambda x: np.quantile(x, 0.95)),
        "certified_fraction": float(np.mean(certified[good])) if good.any() else None,
        "dataset_hash": dataset_hash,
    }


def _timing(notes: Mapping[str, Mapping[str, object]]) -> tuple[float, list[float], int]:
    """Seconds that all workers together took, time of each solve [ms], and the number of workers of the last engine."""
    seconds, solve_times, workers = 0.0, list[float](), 1
    for note in notes.values():
        spent, solves, count = note.get("seconds"), note.get("solve_ms"), note.get("workers")
        if isinstance(spent, float) and isinstance(solves, list) and isinstance(count, int):
            seconds, workers = seconds + spent / count, count
            solve_times += solves
    return seconds, solve_times, workers
