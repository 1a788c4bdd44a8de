import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from evpinn_ros.nodes.live.power_line import (
    BIN_NS,
    DOT_ROWS,
    KEPT_BINS,
    STARTED_OVER_NS,
    PowerHistory,
    braille_line,
    power_axis,
)

ANY = st.floats(allow_nan=True, allow_infinity=True)


def test_a_bag_that_starts_over_starts_the_line_over_and_a_straggler_does_not():
    line = PowerHistory()
    line.add("measured", 20 * BIN_NS, 1.0)
    line.add("measured", 19 * BIN_NS, 2.0)
    assert line.last("measured", 2) == [2.0, 1.0]
    line.add("measured", 20 * BIN_NS - STARTED_OVER_NS - 1, 3.0)
    assert line.newest_ns == 20 * BIN_NS - STARTED_OVER_NS - 1
    assert line.last("measured", 2) == pytest.approx([math.nan, 3.0], nan_ok=True)


def test_hours_are_not_kept():
    line = PowerHistory()
    for index in range(2 * KEPT_BINS):
        line.add("measured", index * BIN_NS, 1.0)
    kept = line.last("measured", 2 * KEPT_BINS)
    assert sum(math.isfinite(value) for value in kept) == KEPT_BINS


# A subnormal number is nothing beside a step of the axis: -5e-324 W lay below its end, zero.
@given(st.lists(st.floats(allow_subnormal=False)))
def test_an_axis_holds_zero_and_what_a_car_can_have(values):
    low, high = power_axis(values)
    assert low <= 0 < high and math.isfinite(high - low)
    assert all(low <= value <= high for value in values if abs(value) < 1e9)


@given(st.lists(ANY, max_size=40), st.integers(0, 12), st.integers(1, 5))
def test_a_line_has_the_size_asked_for(values, width, height):
    rows = braille_line(values, width, height, (-1.0, 1.0))
    assert [len(row) for row in rows] == height * [width]


@given(st.integers(0, DOT_ROWS - 1))
def test_a_constant_is_a_straight_line(row):
    (drawn,) = braille_line([row / (DOT_ROWS - 1)] * 8, 4, 1, (0.0, 1.0))
    assert len(set(drawn)) == 1
