"""The account of a dataset: what was drawn, rejected, solved and failed, and how good the labels are."""

from collections import Counter
from typing import Any

import numpy as np

from agile_jax.dataset.dataset import SPLITS, Dataset, accepted, split_mask
from agile_jax.dataset.settings import DatasetSettings
from agile_jax.expert.programs.retries import CERTIFIED

FIRST_METHODS = ("certified", "fatrop")  # the others are rungs that solved what these could not


def summarise(
    shards: list[dict[str, np.ndarray]],
    timing: dict[str, Any],
    dataset_hash: str,
    settings: DatasetSettings,
    seed: int,
) -> dict[str, Any]:
    """The contents of summary.json. Maxima and medians are over the verified trajectories; null when there is none.

    Args:
        shards: their arrays, in order.
        timing: seconds and solve times by shard, as far as known, and the number of workers.
        dataset_hash: of the manifest.
        settings: the split.
        seed: of the split.
    """
    whole = {name: np.concatenate([shard[name] for shard in shards]) for name in shards[0] if shards[0][name].ndim}
    good = np.concatenate([accepted(shard) for shard in shards])
    solved = whole["solved"]
    certified = (whole["method"] == CERTIFIED) | (whole["gap"] < 1e-3)  # with u_0 = u_N = 0 the gap is 2 / (N - 2)
    entries = list(timing["shards"].values())
    seconds = sum(entry["seconds"] for entry in entries) / timing["workers"]
    solve_times = [t for entry in entries for t in entry["solve_ms"]]
    drawn, collisions, outside = (int(n) for n in whole["draws"].sum(0))
    causes = Counter(cause.partition(":")[0] for cause in whole["cause"][~solved].tolist())
    methods = dict(sorted(Counter(whole["method"][good].tolist()).items()))
    index = whole["index"][good]
    # Only indices and seed matter for the split.
    empty = np.empty(0)
    dataset = Dataset(index, empty, empty, empty, empty, empty, empty, empty, empty, seed, dataset_hash)

    def over(name: str, reduce: Any) -> float | None:
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
        "workers": int(timing["workers"]),
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
        "split": {name: int(split_mask(dataset, name, settings).sum()) for name in SPLITS},
        "dataset_hash": dataset_hash,
    }
