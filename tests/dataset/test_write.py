"""Labels made elsewhere: verified, written, read, trained on and kept by a run."""

import json

import numpy as np
import pytest
from small_dataset import EXPERT, SCENE, SEED, make

from agile_jax import pipeline
from agile_jax.dataset import load, write
from agile_jax.experiment import Experiment
from agile_jax.expert import Trajectory
from agile_jax.run_directory import stage_state
from agile_jax.settings import BadInput


@pytest.fixture(scope="module")
def trajectories(reference):
    dataset = load(reference[0])
    return [Trajectory(*arrays) for arrays in zip(dataset.times, dataset.states, dataset.controls, strict=True)]


def test_what_is_written_is_what_is_loaded(reference, trajectories, tmp_path):
    summary = write(tmp_path / "d", trajectories, SCENE, EXPERT, seed=SEED)
    one, other = load(reference[0]), load(tmp_path / "d")
    for name in ("times", "states", "controls", "starts", "targets", "durations"):
        np.testing.assert_array_equal(getattr(other, name), getattr(one, name))
    np.testing.assert_allclose(other.lower_bounds, one.lower_bounds, atol=1e-9)
    assert other.seed == SEED
    assert set(other.branches) == {"elsewhere"}
    assert summary["trajectories"] == len(trajectories)
    whole = {"objective": [], "index": []}
    for name in sorted(path.name for path in reference[0].glob("shard-*.npz")):
        with np.load(reference[0] / name) as file:
            for column, values in whole.items():
                values.extend(file[column].tolist())
    with np.load(tmp_path / "d/shard-00000.npz") as file:
        wanted = [whole["objective"][whole["index"].index(i)] for i in one.indices]
        np.testing.assert_allclose(file["objective"], wanted, rtol=1e-6)


def test_a_run_goes_on_from_labels_made_elsewhere(trajectories, tmp_path):
    folder = tmp_path / "run/dataset"
    experiment = Experiment(name="n", scene=SCENE, expert=EXPERT)
    written = write(folder, trajectories, experiment.scene, EXPERT)
    shard = (folder / "shard-00000.npz").read_bytes()
    for reused in (False, True):
        result = pipeline.run(experiment, tmp_path / "run", ("dataset",), engine="tcp://127.0.0.1:1")["dataset"]
        assert result.reused == reused
        assert result.summary == written
    assert (folder / "shard-00000.npz").read_bytes() == shard
    assert not (folder / "quarantine").exists()
    faster = EXPERT.model_copy(update={"velocity": (2.0, 0.5, 0.3, 1.0)})
    with pytest.raises(BadInput, match=r"made elsewhere, with other settings: expert\.velocity"):
        make(folder, expert=faster)
    (folder / "shard-00000.npz").write_bytes(shard[:-1])
    assert stage_state(tmp_path / "run", experiment, "dataset") == "begun"
    with pytest.raises(BadInput, match=r"shard-00000\.npz: its sha256 is not the manifest's"):
        pipeline.run(experiment, tmp_path / "run", ("dataset",), engine="inline")
    (folder / "shard-00000.npz").write_bytes(shard)
    assert json.loads((folder / "summary.json").read_text()) == written


def test_labels_that_do_not_pass_are_named(trajectories, tmp_path):
    broken = [*trajectories]
    states = trajectories[2].states.copy()
    states[5, 1] += 0.01
    broken[2] = trajectories[2]._replace(states=states)
    with pytest.raises(BadInput, match=r"^trajectory 2: dynamics_residual 1\.00e-02 exceeds 1e-06$"):
        write(tmp_path / "d", broken, SCENE, EXPERT)
    with pytest.raises(BadInput, match=r"^trajectory 0: end_residual"):
        write(tmp_path / "d", trajectories, SCENE, EXPERT, targets=np.tile([2.9, 0.0, 0.28, 0.0], (len(broken), 1)))
    short = trajectories[1]._replace(controls=trajectories[1].controls[:-1])
    with pytest.raises(BadInput, match="one number of intervals"):
        write(tmp_path / "d", [trajectories[0], short], SCENE, EXPERT)
    assert not (tmp_path / "d").exists()
    (tmp_path / "d").mkdir()
    (tmp_path / "d/thesis.txt").touch()
    with pytest.raises(BadInput, match="is not empty"):
        write(tmp_path / "d", trajectories, SCENE, EXPERT)
