"""Text read by column gives the rows that are read line by line."""

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.logs import text_table
from evpinn_ros.logs.batch import batches_of, regrouped
from evpinn_ros.logs.survey import Head, data_batches, data_rows
from evpinn_ros.logs.text_table import TextTable

HEADER = "time_s,speed_kmh,voltage,current"
plain = st.lists(
    st.sampled_from(["0.1", "-3", "12.50", "", "7e1", "+4", "x"]), min_size=3, max_size=3
).map(lambda cells: ",".join(["1.5", *cells]))
lines = st.lists(
    plain
    | plain
    | st.sampled_from([
        HEADER,
        "voltage,time_s,current,speed_kmh",  # of another order
        *("", "# a comment", ",,,", '"1","2","3","4"', '1,"2,3,4', "1,2,3,4,", "1,2", "1,2,3,4,5"),
        *(" 1,2,3,4", "1,2,3,4\0", "2024-03-05,1,2,3", "1,é,3,4", "1,2,3," + "9" * 2100),
    ]),
    max_size=40,
)  # fmt: skip


@given(lines, st.integers(1, 200), st.sampled_from(["\n", "\r\n"]), st.booleans())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_columns_are_the_rows(tmp_path, monkeypatch, below, size, ending, ends):
    path = tmp_path / "drive.csv"
    text = ending.join([HEADER, *below]) + (ending if ends else "")
    path.write_bytes(text.encode())
    monkeypatch.setattr(text_table, "CHUNK", size)
    monkeypatch.setattr(text_table, "FIRST", size)
    table, again = TextTable(path, separator=","), TextTable(path, separator=",")
    head = Head(HEADER.split(","), 1)
    rows, error = collected(data_rows(table, head))
    batches, other = collected(data_batches(again, head))
    assert [row for batch in batches for row in batch.rows()] == rows
    assert (str(other), again.torn) == (str(error), table.torn)
    assert [row for batch in regrouped(batches) for row in batch.rows()] == rows
    for place in range(5):
        cells = [cell for batch in batches for cell in batch.cells(place)]
        assert cells == [row[place] if place < len(row) else "" for _, row in rows]


def collected(parts):
    """What comes, and the error that ends it, if any."""
    come = []
    try:
        come.extend(parts)
    except InputError as error:
        return come, error
    return come, None


def test_rows_before_an_error_are_passed_on():
    def rows():
        yield 1, ["a"]
        raise InputError("broken")

    come, error = collected(batches_of(rows()))
    assert [row for batch in come for row in batch.rows()] == [(1, ["a"])]
    with pytest.raises(InputError, match="broken"):
        raise error
