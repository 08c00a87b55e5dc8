"""Paired comparisons and breakdowns with known answers."""

from pathlib import Path

import numpy as np
import pytest

from agile_jax.evaluation import compare, mcnemar_p_value
from agile_jax.evaluation.breakdown import distributions, outcomes_by_region
from agile_jax.settings import BadInput


def write(run_dir: Path, success: list[bool], arrival: list[float], shift: float = 0.0) -> Path:
    folder = run_dir / "evaluation"
    folder.mkdir(parents=True)
    start = np.arange(4 * len(success), dtype=float).reshape(-1, 4) + shift
    arrays = {"start": start, "success": np.array(success), "arrival_time": np.array(arrival)}
    np.savez(folder / "mujoco.npz", **arrays)
    return run_dir


@pytest.mark.parametrize(("first", "second", "p"), [(0, 0, 1.0), (5, 0, 2 / 32), (1, 9, 22 / 1024), (3, 3, 1.0)])
def test_mcnemar_is_the_exact_binomial(first: int, second: int, p: float):
    assert mcnemar_p_value(first, second) == pytest.approx(p)
    assert mcnemar_p_value(second, first) == pytest.approx(p)


def test_mcnemar_refuses_nonsense():
    with pytest.raises(ValueError, match="not less than 0"):
        mcnemar_p_value(-1, 2)


def test_pairs_are_counted(tmp_path: Path):
    one = write(tmp_path / "a", [True, True, False, False, True], [2.0, 4.0, np.nan, np.nan, 1.0])
    other = write(tmp_path / "b", [True, False, True, False, True], [1.0, np.nan, 3.0, np.nan, 2.0])
    result = compare(one, other)
    assert (result["both"], result["only_first"], result["only_second"], result["neither"]) == (2, 1, 1, 1)
    assert result["mcnemar_p"] == 1.0
    assert result["arrival_time_ratio_median"] == pytest.approx((0.5 + 2.0) / 2)
    assert result["second_is_faster"] == 0.5


def test_other_starts_and_missing_files_are_refused(tmp_path: Path):
    one = write(tmp_path / "a", [True], [1.0])
    other = write(tmp_path / "b", [True], [1.0], shift=0.1)
    with pytest.raises(BadInput, match="different starts"):
        compare(one, other)
    with pytest.raises(BadInput, match="no such evaluation"):
        compare(one, tmp_path / "c")
    (other / "evaluation" / "mujoco.npz").write_bytes(b"not an archive")
    with pytest.raises(BadInput, match="unreadable"):
        compare(one, other)


def test_every_episode_is_in_one_route_and_one_distance():
    columns = {
        "expert_time": np.array([1.0, 2.0, np.nan, 1.0]),
        "branch": np.array(["under", "left", "no route", "under"]),
        "outcome": np.array([0, 1, 3, 0]),
    }
    regions = outcomes_by_region(columns, np.array([0.1, 0.5, 0.2, 0.9]))
    assert regions["route under"]["success"] == 2
    assert regions["route left"]["collision"] == 1
    assert regions["route no path"]["timeout"] == 1
    assert sum(sum(counts.values()) for name, counts in regions.items() if name.startswith("route")) == 4
    assert sum(regions["nearer than 0.3 m"].values()) == 2


def test_cost_of_transport_is_work_over_weight_and_way():
    columns = {name: np.zeros(2) for name in ("min_clearance", "min_envelope_clearance", "min_self_clearance")}
    columns |= {"velocity_tracking_rmse": np.zeros(2), "torque_saturation": np.zeros(2)}
    columns |= {"success": np.array([True, True]), "arrival_time": np.ones(2)}
    columns |= {"expert_time": np.ones(2), "expert_arrival_time": np.ones(2)}
    columns |= {"work": np.array([98.1, 5.0]), "distance": np.array([2.0, 0.0])}
    found = distributions(columns, mass=10.0)["cost_of_transport_quantiles"]
    assert found == pytest.approx([0.5, 0.5, 0.5])  # who has not moved has none
