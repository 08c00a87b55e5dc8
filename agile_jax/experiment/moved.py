"""Settings that have another name than they had, or are gone: an old name in a file or an override is one message."""

from collections.abc import Iterator, Mapping

MOVED = {
    "closed_loop": "kinematic_test",
    "control.leash": "control.lead_limit",
    "dagger": "aggregation",
    "dataset.target": "dataset.label_kind",
    "expert.planner": "expert.dimensions",
    "expert.trajectories": "dataset.trajectories",
    "expert.targets": "dataset.targets",
    "expert.shard_size": "dataset.shard_size",
    "expert.starts": "dataset.starts",
    "expert.wide_paper_fraction": "dataset.wide_paper_fraction",
    "expert.wide_target_fraction": "dataset.wide_target_fraction",
    "expert.wide_target_std": "dataset.wide_target_std",
    "expert.wide_yaw_std": "dataset.wide_yaw_std",
    "expert.wide_padding": "dataset.wide_padding",
}
GONE = {"training.loss": "is no setting any more: the loss is the mean squared error"}


def moved(values: Mapping[str, object]) -> Iterator[tuple[tuple[str, ...], str]]:
    """The keys in an experiment's tables that have another name now, or none: their place, and what to do."""
    for old, told in ({name: f"is called {new} now" for name, new in MOVED.items()} | GONE).items():
        where = tuple(old.split("."))
        if _holds(values, where):
            yield where, told


def _holds(values: object, where: tuple[str, ...]) -> bool:
    for name in where:
        if not isinstance(values, Mapping) or name not in values:
            return False
        values = values[name]
    return True
