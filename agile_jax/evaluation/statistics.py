"""Honest intervals and tests of success rates."""

from scipy import stats


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % Wilson score interval of a binomial proportion (Wilson 1927).

    Unlike the normal approximation it stays inside [0, 1] and is not empty at 0 or `trials` successes.

    Raises:
        ValueError: no trials, or more successes than trials.
    """
    interval = stats.binomtest(successes, trials).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)


def mcnemar_p_value(only_first: int, only_second: int) -> float:
    """Exact two-sided p-value of McNemar's test (1947): were two methods, tried on the same cases, equally good?

    Only the cases count in which one succeeded and the other did not; if both are equally good, either is as likely.

    Args:
        only_first, only_second: cases in which only that one succeeded.

    Raises:
        ValueError: a negative number.
    """
    if only_first == only_second == 0:
        return 1.0
    return float(stats.binomtest(only_first, only_first + only_second, 0.5).pvalue)
