"""The Wilson interval against published values and its defining equation."""

import pytest

from agile_jax.evaluation import wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    # Newcombe 1998, table I, method 3, to its four digits.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_published_intervals(successes: int, trials: int, low: float, high: float):
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=6e-5)


def test_ends_solve_the_score_equation():
    """At either end p the observed rate is exactly z standard errors of p away."""
    successes, trials, z = 61, 64, 1.959963984540054
    for end in wilson_interval(successes, trials):
        assert abs(successes / trials - end) == pytest.approx(z * (end * (1 - end) / trials) ** 0.5)


def test_never_leaves_the_unit_interval_and_holds_the_rate():
    for trials in (1, 7, 64):
        for successes in range(trials + 1):
            low, high = wilson_interval(successes, trials)
            assert 0 <= low <= successes / trials <= high <= 1
            assert low < high


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (3, 2), (-1, 5)])
def test_what_is_no_proportion_is_refused(successes: int, trials: int):
    with pytest.raises(ValueError, match="must"):
        wilson_interval(successes, trials)
