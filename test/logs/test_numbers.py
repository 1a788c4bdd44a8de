"""Cells of tables as numbers."""

from hypothesis import given
from hypothesis import strategies as st

from evpinn_ros.logs.numbers import filled, is_missing

WRITTEN = st.sampled_from(("", " ", "NaN", " null ", "--", "N/A", "0", "-0", "na\u00efve", "\t?"))


@given(st.lists(WRITTEN | st.text(st.characters(exclude_categories=("C",)), max_size=4)))
def test_cells_that_say_a_value_are_those_that_are_not_missing(cells):
    assert list(filled(cells)) == [cell for cell in cells if not is_missing(cell)]
