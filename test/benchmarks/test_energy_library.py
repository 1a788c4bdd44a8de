from importlib.util import find_spec

import numpy as np
import pytest

from benchmarks.energy_library import CYCLES, compare_cycles, hilly_profiles, read_cycle
from evpinn_ros.common.errors import InputError


@pytest.fixture
def cycles(tmp_path):
    """A folder with one small cycle under the three names."""
    time = np.arange(0, 121)
    speed = 8 * (1 - np.cos(2 * np.pi * time / 60))
    rows = [f"{t},{v},0,0" for t, v in zip(time, speed, strict=True)]
    for name in CYCLES:
        text = "\n".join(["cycSecs,cycMps,cycGrade,cycRoadType", *rows])
        (tmp_path / f"{name}.csv").write_text(text, encoding="utf-8-sig")
    return tmp_path


def test_a_cycle_is_read(cycles):
    time, speed = read_cycle(cycles / "udds.csv")
    assert time[-1] == 120 and speed.max() == pytest.approx(16.0)


@pytest.mark.parametrize("text", ["a,b\n1,2\n", "cycSecs,cycMps\n1,fast\n"])
def test_what_is_no_cycle_is_named(tmp_path, text):
    file = tmp_path / "udds.csv"
    with pytest.raises(InputError, match=r"udds\.csv"):
        read_cycle(file)
    file.write_text(text)
    with pytest.raises(InputError, match="cycSecs and cycMps"):
        read_cycle(file)


def test_candidates_can_be_driven():
    found = hilly_profiles(4, 50)
    assert found.speed.shape == found.elevation.shape == (4, 50)
    assert (found.speed >= 0).all() and len(np.unique(found.speed[:, 10])) == 4


@pytest.mark.skipif(find_spec("fastsim") is None, reason="fastsim is not installed")
def test_fastsims_car_costs_about_the_same_in_our_equations(cycles, vehicle):
    rows = list(compare_cycles(cycles, vehicle))
    assert [row.cycle for row in rows] == list(CYCLES)
    assert rows[0].same_car_j == pytest.approx(rows[0].fastsim_j, rel=0.15)
    assert min(rows[0].fastsim_us, rows[0].ours_us) > 0
