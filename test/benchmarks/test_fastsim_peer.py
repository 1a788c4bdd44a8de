"""Drive cycles as their files have them."""

import numpy as np
import pytest

from benchmarks.fastsim_peer import read_cycle
from evpinn_ros.common.errors import InputError


def test_a_cycle_is_read(tmp_path):
    speed = np.linspace(0.0, 16.0, 121)
    rows = [f"{second},{v},0,0" for second, v in enumerate(speed)]
    text = "\n".join(["cycSecs,cycMps,cycGrade,cycRoadType", *rows])
    (tmp_path / "udds.csv").write_text(text, encoding="utf-8-sig")
    time_s, found = read_cycle(tmp_path / "udds.csv")
    assert time_s[-1] == 120 and found == pytest.approx(speed)


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "cycSecs,cycMps\n1,fast\n"])
def test_what_is_no_cycle_is_named(tmp_path, text):
    file = tmp_path / "udds.csv"
    with pytest.raises(InputError, match=r"udds\.csv"):
        read_cycle(file)
    file.write_text(text)
    with pytest.raises(InputError, match="cycSecs and cycMps"):
        read_cycle(file)
