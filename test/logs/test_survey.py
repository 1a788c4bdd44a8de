"""The look through a whole table before it is read."""

from hypothesis import given
from hypothesis import strategies as st
import pytest

from evpinn_ros.logs import survey as module
from evpinn_ros.logs.survey import find_head, look_through, names_some
from evpinn_ros.logs.text_table import TextTable


@given(st.integers(1001, 5000), st.integers(0, 4))
def test_cells_are_kept_evenly_from_the_first_row_on(tmp_path_factory, rows, blank):
    """Of 1000 rows at most; rows behind a comment come one by one, and not by column."""
    path = tmp_path_factory.mktemp("table") / "drive.csv"
    lines = [f"{row},10" for row in range(rows)]
    lines[rows // 2 : rows // 2] = ["# comment"] * blank
    path.write_text("\n".join(["t_s,speed_mps", *lines, ""]))
    table = TextTable(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MOST_CELLS", 0)
        looked = look_through(table, find_head(table), [0], early=lambda _: None)
    numbers = [int(cell) for cell in looked.cells[0]]
    assert numbers == list(range(0, rows, looked.stride)) and 500 < len(numbers) <= 1000


def test_a_row_of_nothing_names_nothing():
    """As a sheet's first row may be."""
    assert not names_some([]) and not names_some([""]) and names_some(["t_s", "speed_mps"])
