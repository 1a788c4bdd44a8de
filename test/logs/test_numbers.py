"""Cells of tables as numbers."""

import math

from hypothesis import example, given
from hypothesis import strategies as st

from evpinn_ros.logs.numbers import POINT, filled, is_missing, to_floats

WRITTEN = st.sampled_from(("", " ", "NaN", " null ", "--", "N/A", "0", "-0", "na\u00efve", "\t?"))


@given(st.lists(WRITTEN | st.text(st.characters(exclude_categories=("C",)), max_size=4)))
def test_cells_that_say_a_value_are_those_that_are_not_missing(cells):
    assert list(filled(cells)) == [cell for cell in cells if not is_missing(cell)]


@given(st.floats())
@example(5e-324)
@example(1e308)
def test_a_number_can_be_squared_whatever_a_damaged_cell_says(value):
    """Sums over the largest floats, and quotients by the smallest, are warnings of numpy."""
    (number,) = map(float, to_floats([repr(value)], POINT))
    assert number == value if 1e-30 < abs(value) < 1e30 else number == 0.0 or math.isnan(number)
    assert math.isnan(number) == (not abs(value) < 1e30)
