"""What is refused counts nowhere: totals of a drive with faults are those of the sound drive."""

from dataclasses import replace
import math
from pathlib import Path
import time

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.admission import Admission, CarLimits
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.driven import counted, without_lone
from evpinn_ros.replays.history import History
from evpinn_ros.replays.run import ReplayOptions, replay
from evpinn_ros.report.owner_text import owner_line, part_text
from test.recorded import Recorded

SECONDS = 900
PREDICTED = {"energy": {"measured_j": 1.0, "predicted_j": None}}


@pytest.fixture(scope="module")
def rows():
    """Speed, m/s, voltage, V, and current, A, once a second: 15 minutes of traffic."""
    t = np.arange(SECONDS, dtype=float)
    speed = 16.0 + 8.0 * np.sin(t / 19.0) + 4.0 * np.sin(t / 5.0)
    power = 700.0 * speed + 2.4e3 * speed * np.gradient(speed) + 500.0
    voltage = 352.0 - power / 9e3
    return np.column_stack((speed, np.round(voltage, 1), np.round(-power / voltage, 1)))


def drive_of(rows, vehicle):
    """The drive that a replay collects of these rows."""
    readings, history = [], History()
    for second, (speed, voltage, current) in enumerate(rows.tolist()):
        stamp_ns = (1_700_000_000 + second) * NANOSECONDS
        readings += SpeedReading(stamp_ns, speed), BatteryReading(stamp_ns, voltage, current)
    history.add_block(Admission(CarLimits.of(vehicle)).admit(Block.of(readings)))
    return history.drive()


WRONG = (
    st.sampled_from(
        [255 / 3.6, 163.83 / 3.6, 6553.5 / 3.6, 655.35 / 3.6, 9e11, math.nan, 0.0, 1.7e308]
    )
    | st.floats(0.0, 70.0),
    st.sampled_from([6553.5, 655.35, 3276.7, 1638.3, 255.0, 0.0, math.nan, 3500.0])
    | st.floats(0.0, 800.0),
    st.sampled_from([6553.5, 3276.7, -3276.8, 1638.3, 655.35, -327.68, math.nan, 1e9, 0.0])
    | st.floats(-500.0, 500.0),
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_faults_in_some_rows_change_no_total(rows, vehicle, data):
    """Up to 5 % of the rows: energy and distance within 1 %, or the first line says so.

    Not the first rows: while the rate of a signal is unknown no step of 3 s is joined.
    """
    sound = counted(drive_of(rows, vehicle))
    faulty = rows.copy()
    columns = data.draw(st.sets(st.integers(0, 2), min_size=1))
    places = st.integers(5, SECONDS - 2)
    for row in data.draw(st.sets(places, min_size=1, max_size=SECONDS // 20)):
        for column in columns:
            faulty[row, column] = data.draw(WRONG[column])
    drive = drive_of(faulty, vehicle)
    faulty_total, line = counted(drive), owner_line(drive, PREDICTED)
    missing = "that could be read" in line or "leapt away and back" in line
    assert missing or faulty_total.energy == pytest.approx(sound.energy, rel=0.01)
    assert missing or faulty_total.distance == pytest.approx(sound.distance, rel=0.01)


@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("zeros", [True, False], ids=["zeros", "jumps"])
@pytest.mark.parametrize("seed", range(4))
def test_lone_readings_that_a_car_could_have_are_told_with_the_totals_without_them(
    rows, vehicle, column, zeros, seed
):
    """5 % of a signal is 0, or leaps within what the car can do: by up to 12 % of the energy."""
    random, faulty = np.random.default_rng(seed), rows.copy()
    where = random.choice(np.arange(5, SECONDS - 2), SECONDS // 20, replace=False)
    least, most = ((0.0, 60.0), (200.0, 700.0), (-400.0, 400.0))[column]
    faulty[where, column] = 0.0 if zeros else random.uniform(least, most, len(where))
    sound, drive = counted(drive_of(rows, vehicle)), drive_of(faulty, vehicle)
    total, without = counted(drive), without_lone(drive)
    kept = total if without is None else without[0]
    assert kept.energy == pytest.approx(sound.energy, rel=0.01)
    assert kept.distance == pytest.approx(sound.distance, rel=0.01)
    assert ("leapt away and back" in owner_line(drive, PREDICTED)) == (without is not None)
    assert without_lone(drive_of(rows, vehicle)) is None


def test_volts_ten_times_too_large_are_no_energy(rows, vehicle):
    totals = counted(drive_of(rows * (1.0, 10.0, 1.0), vehicle))
    assert math.isnan(totals.energy) and totals.measured == 0.0
    assert totals.distance == pytest.approx(counted(drive_of(rows, vehicle)).distance)


def test_time_that_could_not_be_read_is_in_the_first_line(rows, vehicle):
    """Zeros of a battery that is not connected yet are no power of 0 W."""
    late = rows.copy()
    late[:200, 1:] = 0.0
    drive = drive_of(late, vehicle)
    kwh = counted(drive_of(rows[200:], vehicle)).energy / 3.6e6
    assert f": {kwh:.2f} kWh from the battery in the 12 of 15 min that could be read" in (
        owner_line(drive, PREDICTED)
    )
    assert "could be read" not in owner_line(drive_of(rows, vehicle), PREDICTED)
    assert part_text(885.0, 900.0) == "14.8 of 15.0 min" and part_text(20, 60) == "20 of 60 s"


def test_the_account_counts_what_the_page_says(vehicle, readings):
    """With gaps and faults, in a replay: distance and energy are those of the account."""
    spoilt = [
        reading
        for reading in readings
        if not 40.0 < (reading.stamp_ns - readings[0].stamp_ns) / NANOSECONDS < 50.0
    ]
    batteries = [i for i, reading in enumerate(spoilt) if isinstance(reading, BatteryReading)]
    for index in batteries[100::150]:
        spoilt[index] = replace(spoilt[index], voltage=6553.5)
    speeds = [i for i, reading in enumerate(spoilt) if isinstance(reading, SpeedReading)]
    for index in speeds[50::170]:
        spoilt[index] = replace(spoilt[index], speed=6553.5 / 3.6)
    chain = Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))
    source, options = Recorded(spoilt, Path("town")), ReplayOptions(warm_up=30.0)
    result = replay(source, chain, options, vehicle=vehicle.key, mode="hybrid")
    total, state = counted(result.drive), chain.account.state
    assert total.distance == pytest.approx(chain.account.since_reset().distance, rel=1e-6)
    assert total.energy == pytest.approx(state.measured.energy, rel=2e-3)
    dropped = result.metrics["input"]["dropped"]
    assert dropped == {
        "battery_out_of_range": len(batteries[100::150]),
        "speed_out_of_range": len(speeds[50::170]),
    }
