from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import trapezoid

from benchmarks.integrators import (
    RULES,
    SAMPLINGS,
    UnbrokenPower,
    agreement,
    at_most,
    compare_integrators,
    divided,
    gappy,
    measured_power,
    simulated_power,
)
from benchmarks.logs import Log, find_logs
from evpinn_ros.common.errors import InputError
from evpinn_ros.energy.rknn import STEP_LIMIT

URBAN = Path(__file__).parents[2] / "bags" / "urban"


def series(seconds=400, rate=10, shift=0.0):
    time = np.arange(seconds * rate + 1) / rate
    power = 6e3 + 20e3 * np.sin(time / 3 + shift) + 8e3 * np.sin(time * 1.3)
    return UnbrokenPower("made", time, power)


def write_csv(path, rows):
    path.write_text("t_s,speed_mps,power_w\n" + "".join(f"{t},10.0,{p}\n" for t, p in rows))
    return Log(path, "bmw_i3", None)


def test_samplings_keep_the_ends_and_lose_what_they_should():
    drive = series(rate=100)
    sampled = {name: sample(drive) for name, sample in SAMPLINGS.items()}
    lengths = [len(each.time) for each in sampled.values()]
    assert lengths[:2] == [4001, 401]
    assert 0.05 < 1 - lengths[2] / 401 < 0.15
    for each in sampled.values():
        assert each.time[[0, -1]].tolist() == [0.0, 400.0]
        rows = np.rint(each.time * 100).astype(int)
        assert (each.power == drive.power[rows]).all()
    assert np.diff(gappy(drive).time).max() >= 2.0


def test_a_log_that_is_slower_is_left_as_it_is():
    drive = series(rate=4)
    assert at_most(10.0, drive).time.tolist() == drive.time.tolist()


@given(st.lists(st.tuples(st.floats(0.05, 30.0), st.floats(-1e5, 1e5)), min_size=2, max_size=30))
def test_divided_is_the_same_straight_lines(samples):
    time = np.cumsum([dt for dt, _ in samples])
    drive = UnbrokenPower("", time, np.array([power for _, power in samples]))
    fine = divided(drive)
    assert np.diff(fine.time).max() <= STEP_LIMIT * (1 + 1e-6)
    assert np.isin(time, fine.time).all()
    expected = trapezoid(drive.power, drive.time)
    assert trapezoid(fine.power, fine.time) == pytest.approx(expected, abs=1e-3)


@pytest.mark.nightly
def test_every_method_on_every_sampling():
    rows = list(compare_integrators("made", [series(200), series(200, shift=1.0)], epochs=10))
    table = {(row.method, row.sampling): row for row in rows}
    assert len(table) == len(rows) == 5 * 3
    assert all(row.drives == 2 and 0 <= row.median <= row.worst for row in rows)
    for row in rows:  # truth is the straight line through all samples
        if (row.method, row.sampling) == ("trapezoid", "10 Hz"):
            assert row.worst < 1e-9
    slow = {method: table[method, "1 Hz"].worst for method in RULES}
    assert slow["trapezoid"] > 0.01
    assert slow["RKNN, shipped"] == pytest.approx(slow["trapezoid"], abs=0.05)
    learned = table["RKNN, as published", "10 Hz"].worst
    assert 0.0 < learned < 50.0


def test_the_shipped_network_agrees_with_the_trapezoid_on_a_log():
    (log,) = find_logs(str(URBAN), "tesla_model_3_lr")
    drive = measured_power(log)
    assert drive.time[0] == 0.0 and (np.diff(drive.time) > 0).all()
    assert 0.0 < abs(agreement(drive).percent) < 0.1


def test_only_the_longest_piece_without_a_gap_counts(tmp_path):
    rows = [(t / 5, 1e3 + t) for t in range(2000) if not 300 < t < 900]
    drive = measured_power(write_csv(tmp_path / "gap.csv", rows))
    assert drive.time[-1] == pytest.approx(219.8)
    assert drive.power[0] == pytest.approx(1e3 + 900)


@pytest.mark.parametrize(
    "rows",
    [
        [(t / 10, 2e3) for t in range(1000)],  # too short
        [(t / 10, 0.0) for t in range(3000)],  # nothing to compare with
        [(t / 10, "") for t in range(3000)],  # no battery
    ],
)
def test_a_log_that_tells_nothing_is_refused(tmp_path, rows):
    with pytest.raises(InputError, match=r"log\.csv: no 150 s of power"):
        measured_power(write_csv(tmp_path / "log.csv", rows))


@pytest.mark.nightly
def test_simulated_drives_have_truth_between_the_samples_of_10_hz():
    drives = simulated_power()
    assert len(drives) >= 3
    for drive in drives:
        coarse = at_most(10.0, drive)
        exact = trapezoid(drive.power, drive.time)
        assert 0 < abs(trapezoid(coarse.power, coarse.time) / exact - 1) < 1e-4
