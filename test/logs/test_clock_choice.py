"""Clocks whose cells do not tell the time alone: half days, and headers of another unit."""

from datetime import timedelta
from pathlib import Path
import sys

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from exports import START, measured, opened, simulated, table

from evpinn_ros.core.signals.readings import SpeedReading

DRIVE = simulated()
RIGHT = pytest.approx((DRIVE.distance, DRIVE.energy), rel=0.01)
HALVES = {
    "a time of day": ("%I:%M:%S", 5.5),
    "a date": ("%Y-%m-%d %I:%M:%S", 5.5),
    "a date, day first": ("%d.%m.%Y %I:%M:%S", 5.5),
    "a time of day, at night": ("%I:%M:%S", 17.5),
    "a date, past midnight and one o'clock": ("%Y-%m-%d %I:%M:%S", 17.5),
}


@pytest.mark.parametrize("clock", HALVES)
@pytest.mark.parametrize("newest_first", [False, True])
def test_a_clock_of_12_hours_without_am_and_pm_runs_on(tmp_path, clock, newest_first):
    pattern, later = HALVES[clock]
    start = START + timedelta(hours=later)
    drive = simulated(step=5.0)

    def line(t, v, u, i, *_):
        return f"{start + timedelta(seconds=t):{pattern}},{3.6 * v:.2f},{u:.2f},{i:.2f}"

    text = table("Time,Speed (km/h),Pack volts (V),Pack amps (A)", drive, line)
    if newest_first:
        header, *rows = text.splitlines()
        text = "\n".join([header, *rows[::-1]])
    source = opened(tmp_path, text)
    stamps = [r.stamp_ns for r in source.readings() if isinstance(r, SpeedReading)]
    assert (stamps[-1] - stamps[0]) / 1e9 == drive.time[-1] and len(stamps) == drive.time.size
    assert "'Time' is assumed to be a 12-hour clock without AM and PM" in " ".join(source.notes)


@pytest.mark.parametrize("hours", [(7, 9), (11, 13), (12, 14), (1, 3)])
def test_a_clock_of_24_hours_is_none_of_12(tmp_path, hours):
    start = START.replace(hour=hours[0], minute=50)

    def line(t, v, u, i, *_):
        return f"{start + timedelta(seconds=t):%H:%M:%S},{3.6 * v:.2f},{u:.2f},{i:.2f}"

    text = table("Time,Speed (km/h),Pack volts (V),Pack amps (A)", DRIVE, line)
    source = opened(tmp_path, text)
    assert measured(source) == RIGHT and "12 hours" not in " ".join(source.notes)


@pytest.mark.parametrize("step", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(
    ("unit", "factor"), [("sec", 1e3), ("s", 1e3), ("ms", 1.0), ("min", 1.0), ("ms", 1e6)]
)
def test_the_unit_of_a_time_is_one_that_cars_can_drive(tmp_path, unit, factor, step):
    drive = simulated(step=step)

    def line(t, v, u, i, *_):
        return f"{factor * t:.1f},{3.6 * v:.1f},{u:.2f},{i:.2f}"

    source = opened(
        tmp_path, table(f"Time ({unit}),Speed (km/h),Pack volts (V),Pack amps (A)", drive, line)
    )
    assert measured(source) == pytest.approx((drive.distance, drive.energy), rel=0.01)
    assert "speed would change as no car's does" in " ".join(source.notes)


@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ms", 1e3), ("min", 1 / 60)])
@pytest.mark.parametrize("step", [0.02, 1.0, 30.0, 120.0])
def test_a_unit_that_cars_can_drive_is_believed(tmp_path, unit, factor, step):
    drive = simulated(step=step)

    def line(t, v, u, i, *_):
        return f"{factor * t:.6f},{3.6 * v:.0f},{u:.2f},{i:.2f}"

    source = opened(
        tmp_path, table(f"Time ({unit}),Speed (km/h),Pack volts (V),Pack amps (A)", drive, line)
    )
    seconds = [r.stamp_ns / 1e9 for r in source.readings() if isinstance(r, SpeedReading)]
    assert seconds[-1] - seconds[0] == pytest.approx(drive.time[-1], rel=1e-5)


@pytest.mark.parametrize("unit", ["s", "ms", "min"])
@pytest.mark.parametrize("rows_while_parked", [0, 1000, 30_000])
def test_a_car_that_stands_or_a_log_that_pauses_is_no_other_unit(
    tmp_path, unit, rows_while_parked
):
    """Twenty days between two drives of 15 minutes, with and without rows of a car that stands."""
    later = 20 * 86_400.0
    factor = {"s": 1.0, "ms": 1e3, "min": 1 / 60}[unit]

    def rows(begin):
        signals = zip(DRIVE.time, DRIVE.speed, DRIVE.voltage, DRIVE.current, strict=True)
        return [
            f"{factor * (begin + t):.6f},{3.6 * v:.2f},{u:.2f},{i:.2f}" for t, v, u, i in signals
        ]

    parked = np.linspace(900.0, later, rows_while_parked, endpoint=False)
    lines = [*rows(0.0), *(f"{factor * t:.6f},0.00,360.00,1.00" for t in parked), *rows(later)]
    header = f"Time ({unit}),Speed (km/h),Pack volts (V),Pack amps (A)"
    source = opened(tmp_path, "\n".join([header, *lines]))
    seconds = [r.stamp_ns / 1e9 for r in source.readings() if isinstance(r, SpeedReading)]
    assert seconds[-1] - seconds[0] == pytest.approx(later + DRIVE.time[-1], rel=1e-5)
