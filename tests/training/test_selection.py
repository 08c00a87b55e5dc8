"""Which epoch is kept, when training stops, several seeds at once, and all of it resumed."""

import jax
import numpy as np
import pytest
from synthetic import LIMITS, SMALL, fit, smooth_samples, table_scene

from agile_jax.policy import make_policy
from agile_jax.training import TrainingSettings
from agile_jax.training.checkpoint import load_parameters, restore_checkpoint
from agile_jax.training.selection import chosen_seed, kept_epochs, stops, validation_errors

LABELS = smooth_samples(500), smooth_samples(100, 1)
# So high a rate that the validation error goes up and down.
ROUGH = TrainingSettings(
    batch_size=64, epochs=9, checkpoint_every=4, learning_rate=0.05, schedule="constant", select="best", seeds=3
)


@pytest.fixture(scope="module")
def policy():
    return make_policy(table_scene(), LIMITS, SMALL)


@pytest.fixture(scope="module")
def three(policy, tmp_path_factory):
    directory = tmp_path_factory.mktemp("three")
    return fit(policy, *LABELS, ROUGH, 3, directory), directory


def alone(errors, patience):
    """The epoch that a training of one seed keeps and at which it stops, step by step."""
    best = None
    for epoch, error in enumerate(errors, 1):
        if best is None or error < errors[best - 1]:
            best = epoch
        if patience is not None and epoch - best >= patience:
            return best, epoch
    return best, None


@pytest.mark.parametrize("patience", [None, 1, 2, 4])
def test_each_seed_keeps_what_it_would_keep_alone(patience):
    settings = ROUGH.model_copy(update={"patience": patience})
    errors = np.random.default_rng(0).random((40, 5))
    for count in range(1, 41):
        found = [alone(errors[:count, seed], patience) for seed in range(5)]
        kept = np.array([best for best, _ in found])
        np.testing.assert_array_equal(kept_epochs(errors[:count], settings), kept)
        assert stops(errors[:count], settings) == all(stop is not None for _, stop in found)
        assert chosen_seed(errors[:count], settings) == np.argmin(errors[kept - 1, np.arange(5)])
    np.testing.assert_array_equal(kept_epochs(errors, settings.model_copy(update={"select": "last"})), 40)


@pytest.mark.parametrize("number", [0, 2])
def test_seeds_at_once_equal_each_alone(number, three, policy, tmp_path):
    """Within rounding: vmap adds up products in another order. The order of the samples is the same to the bit."""
    together, _ = three
    single = fit(policy, *LABELS, ROUGH.model_copy(update={"seeds": 1}), 3 + number, tmp_path)
    errors = validation_errors(together.rows)[:, number]
    np.testing.assert_allclose(errors[:3], validation_errors(single.rows)[:3, 0], rtol=1e-3)
    brief = ROUGH.model_copy(update={"epochs": 1, "checkpoint_every": 1})
    one = fit(policy, *LABELS, brief.model_copy(update={"seeds": 1}), 3 + number, tmp_path / "a")
    many = fit(policy, *LABELS, brief, 3, tmp_path / "b")
    for a, b in zip(jax.tree.leaves(one.parameters), jax.tree.leaves(many.by_seed), strict=True):
        np.testing.assert_allclose(a, b[number], atol=3e-5)


def test_the_best_epoch_of_the_best_seed_is_the_policy(three, policy):
    fitted, directory = three
    errors = validation_errors(fitted.rows)
    assert errors.shape == (9, 3)
    np.testing.assert_array_equal(fitted.epochs, errors.argmin(0) + 1)
    assert (fitted.epochs < 9).any()  # or this test would show nothing
    np.testing.assert_allclose(fitted.validation_mse, errors.min(0))
    assert fitted.seed == 3 + errors.min(0).argmin()
    chosen = load_parameters(directory, policy)
    for a, b in zip(jax.tree.leaves(chosen), jax.tree.leaves(fitted.parameters), strict=True):
        assert np.array_equal(a, b)
    predicted = jax.vmap(lambda pose: policy.output(chosen, policy.encode(pose)))(np.float32(LABELS[1][0]))
    assert np.mean((np.asarray(predicted) - LABELS[1][1]) ** 2) == pytest.approx(errors.min(), rel=1e-4)
    assert fitted.rows[0]["validation_mse"] == pytest.approx(errors[0].mean())


def test_interrupted_seeds_and_selection_go_on_to_the_same_bits(three, policy, tmp_path):
    whole, directory = three

    class StopError(Exception):
        pass

    def stop(work, done, total, note=""):
        if done == 6:
            raise StopError

    with pytest.raises(StopError):
        fit(policy, *LABELS, ROUGH, 3, tmp_path, stop)
    assert {path.name for path in (tmp_path / "checkpoints").iterdir()} == {"4"}
    resumed = fit(policy, *LABELS, ROUGH, 3, tmp_path)
    for a, b in zip(jax.tree.leaves(resumed.by_seed), jax.tree.leaves(whole.by_seed), strict=True):
        assert np.array_equal(a, b)
    assert (tmp_path / "metrics.jsonl").read_bytes() == (directory / "metrics.jsonl").read_bytes()


def test_early_stop_ends_with_a_checkpoint_and_stays_ended(policy, tmp_path):
    settings = ROUGH.model_copy(update={"patience": 2, "seeds": 1, "epochs": 60})
    fitted = fit(policy, *LABELS, settings, 3, tmp_path)
    errors = validation_errors(fitted.rows)[:, 0]
    best, end = alone(errors, 2)
    assert end == len(errors) < 60
    assert fitted.epochs.tolist() == [best]
    assert restore_checkpoint(tmp_path / "checkpoints", fitted.parameters).step == end
    calls = []
    again = fit(policy, *LABELS, settings, 3, tmp_path, lambda *call: calls.append(call))
    assert calls == [("fit", end, end, "done already")]
    assert again.compile_seconds == 0
    for a, b in zip(jax.tree.leaves(again.parameters), jax.tree.leaves(fitted.parameters), strict=True):
        assert np.array_equal(a, b)
