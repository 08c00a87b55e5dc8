"""Which epoch's parameters a training keeps, for each of its seeds, and when it stops early.

All is a pure function of the validation errors so far, thus of metrics.jsonl: a resumed training decides alike.
"""

import numpy as np

from agile_jax.training.metrics import Row
from agile_jax.training.settings import TrainingSettings


def validation_errors(rows: list[Row]) -> np.ndarray:
    """The validation errors of the epochs so far, shape (epochs, seeds) [(m/s)^2, (rad/s)^2]."""
    return np.array([row.get("validation_mse_by_seed", [row["validation_mse"]]) for row in rows])


def kept_epochs(errors: np.ndarray, settings: TrainingSettings) -> np.ndarray:
    """The epoch (from 1) that each seed keeps after these epochs. Shape (seeds,).

    The last; or with select = "best" that with the least error, the first of equals. A seed that has gone `patience`
    epochs without a lesser one is done, as if it had been trained alone.
    """
    count, seeds = errors.shape
    if settings.select == "last":
        return np.full(seeds, count)
    best = np.zeros(seeds, int)
    for epoch in range(1, count):
        done = np.zeros(seeds, bool) if settings.patience is None else epoch - 1 - best >= settings.patience
        better = errors[epoch] < errors[best, np.arange(seeds)]
        best = np.where(better & ~done, epoch, best)
    return best + 1


def stops(errors: np.ndarray, settings: TrainingSettings) -> bool:
    """Whether every seed has gone `patience` epochs without a lesser error."""
    if settings.patience is None or len(errors) == 0:
        return False
    return bool((len(errors) - kept_epochs(errors, settings) >= settings.patience).all())


def chosen_seed(errors: np.ndarray, settings: TrainingSettings) -> int:
    """The position of the seed whose kept parameters have the least validation error."""
    kept = kept_epochs(errors, settings)
    return int(np.argmin(errors[kept - 1, np.arange(errors.shape[1])]))
