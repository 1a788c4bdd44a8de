"""Options and tables that the commands of `evpinn bench` share."""

import json

import pytest

from benchmarks.cli.output import json_at_the_end


def test_ctrl_c_leaves_the_rows_so_far(tmp_path):
    rows = []
    with (
        pytest.raises(KeyboardInterrupt),
        json_at_the_end(tmp_path / "rows.json", lambda: {"rows": rows}),
    ):
        rows.append(1)
        raise KeyboardInterrupt
    assert json.loads((tmp_path / "rows.json").read_text()) == {"rows": [1]}
