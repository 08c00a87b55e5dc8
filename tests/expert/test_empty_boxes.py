"""The largest empty boxes, against points and against a search over all boxes that the given planes bound."""

import itertools

import numpy as np
import pytest

from agile_jax.expert.space.empty_boxes import largest_empty_boxes
from agile_jax.scene import BOX_FACES


def random_boxes(generator, count):
    center, half = generator.uniform(-1, 1, (count, 3)), generator.uniform(0.1, 0.6, (count, 3))
    return center - half, center + half


@pytest.mark.parametrize("count", [1, 2, 5])
def test_they_cover_what_is_free_and_nothing_else(count):
    generator = np.random.default_rng(count)
    for _ in range(5):
        lower, upper = random_boxes(generator, count)
        found = largest_empty_boxes(lower, upper)
        points = generator.uniform(-1.5, 1.5, (3000, 3))
        inside = ((points[:, None] > lower) & (points[:, None] < upper)).all(2).any(1)
        held = np.zeros(len(points), bool)
        for box in found:
            held |= ((points > box.lower) & (points < box.upper)).all(1)
        np.testing.assert_array_equal(held, ~inside)
        assert inside.any()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_they_are_the_largest(count):
    """All boxes whose sides are planes of the given ones, or at infinity: the empty ones within no other."""
    generator = np.random.default_rng(10 + count)
    lower, upper = random_boxes(generator, count)
    sides = []
    for axis in range(3):
        lows, highs = [-np.inf, *upper[:, axis]], [np.inf, *lower[:, axis]]
        sides.append([(a, b) for a in lows for b in highs if a < b])
    empty = []
    for box in itertools.product(*sides):
        low, high = np.array(box).T
        if not ((low < upper) & (high > lower)).all(1).any():
            empty.append((low, high))
    largest = {
        (*low, *high)
        for low, high in empty
        if not any((a <= low).all() and (b >= high).all() and (*a, *b) != (*low, *high) for a, b in empty)
    }
    assert {(*box.lower, *box.upper) for box in largest_empty_boxes(lower, upper)} == largest


def test_around_one_box_they_are_its_half_spaces():
    lower, upper = np.array([[0.0, 1.0, 2.0]]), np.array([[3.0, 4.0, 5.0]])
    found = largest_empty_boxes(lower, upper)
    assert [box.planes for box in found] == [((axis, sign, 0),) for _, axis, sign in BOX_FACES]
    assert found[0].lower[1] == 4.0


def test_planes_that_bound_them_for_the_least_footprint_serve_a_larger_one():
    """The argument of the module: boxes grown by h are as free when the planes move along."""
    generator = np.random.default_rng(5)
    lower, upper = random_boxes(generator, 4)
    lower, upper = lower * [1, 1, 0.3], upper * [1, 1, 0.3]
    found = largest_empty_boxes(lower, upper)
    for grow in (0.05, 0.2):
        low, high = lower - grow, upper + grow
        points = generator.uniform(-2, 2, (2000, 3))
        inside = ((points[:, None] > low) & (points[:, None] < high)).all(2).any(1)
        held = np.zeros(len(points), bool)
        for box in found:
            beyond = np.ones(len(points), bool)
            for axis, sign, number in box.planes:
                beyond &= points[:, axis] > high[number, axis] if sign > 0 else points[:, axis] < low[number, axis]
            held |= beyond
        np.testing.assert_array_equal(held, ~inside)


def test_legs_that_are_flush_with_their_table_up_to_rounding_add_no_corridor_outside():
    slab = [[-0.25, -0.2, 0.25], [0.25, 0.2, 0.75]]
    legs = [
        ([x - 0.025 - 1e-16, y - 0.025, 0.0], [x + 0.025, y + 0.025, 0.25])
        for x in (-0.225, 0.225)
        for y in (-0.175, np.nextafter(0.175, 1))
    ]
    lower, upper = (np.array([slab[i], *(leg[i] for leg in legs)]) for i in (0, 1))
    boxes = [box for box in largest_empty_boxes(lower, upper) if box.lower[2] < 0.1 < box.upper[2]]
    assert len(boxes) == 6  # four beside the table, two between its legs
