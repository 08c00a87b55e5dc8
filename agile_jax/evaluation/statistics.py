"""Honest intervals for success rates."""

import math


def wilson_interval(successes: int, trials: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """Wilson score interval of a binomial proportion (Wilson 1927), by default at 95 %.

    Unlike the normal approximation it stays inside [0, 1] and is not empty at 0 or `trials` successes.

    Raises:
        ValueError: no trials, or more successes than trials.
    """
    if not 0 <= successes <= trials or trials < 1:
        raise ValueError(f"{successes} successes in {trials} trials is not a proportion")
    proportion = successes / trials
    scale = 1 + z**2 / trials
    center = (proportion + z**2 / (2 * trials)) / scale
    half = z / scale * math.sqrt(proportion * (1 - proportion) / trials + z**2 / (4 * trials**2))
    # Exactly 0 and 1 at the ends, where rounding would leave 1e-17.
    low = 0.0 if successes == 0 else center - half
    high = 1.0 if successes == trials else center + half
    return low, high


def mcnemar_p_value(only_first: int, only_second: int) -> float:
    """Exact two-sided p-value of McNemar's test (1947): were two methods, tried on the same cases, equally good?

    Only the cases count in which one succeeded and the other did not; if both are equally good, either is as likely.

    Args:
        only_first, only_second: cases in which only that one succeeded.

    Raises:
        ValueError: a negative number.
    """
    if min(only_first, only_second) < 0:
        raise ValueError(f"{only_first} and {only_second} must not be negative")
    trials, fewer = only_first + only_second, min(only_first, only_second)
    tail = sum(math.comb(trials, k) for k in range(fewer + 1))
    return min(1.0, 2 * tail / 2**trials)
