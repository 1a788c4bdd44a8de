import itertools
import math
import time

import numpy as np
import pytest

from benchmarks.energy_forecast import (
    ForecastBenchmark,
    PlannedForecast,
    driven_plan,
    forecast_totals,
)
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.drives.sources import open_source
from evpinn_ros.signals.readings import NANOSECONDS, AltitudeReading, SpeedReading

pytestmark = pytest.mark.nightly

SECOND = NANOSECONDS


def hilly_readings(seconds=300):
    """10 Hz, with an altitude in steps of a metre."""
    distance = 0.0
    for i in range(10 * seconds):
        speed = 12 + 6 * math.sin(i / 300)
        distance += speed / 10
        yield SpeedReading(i * SECOND // 10, speed)
        yield AltitudeReading(i * SECOND // 10, float(round(400 + 20 * math.sin(distance / 400))))


def test_the_plan_of_a_drive_has_its_speed_and_its_road():
    plan = driven_plan(hilly_readings())
    assert np.diff(plan.time) == pytest.approx(1.0)
    assert plan.speed == pytest.approx(12 + 6 * np.sin(plan.time / 30), abs=0.05)
    road = 400 + 20 * np.sin(plan.distance / 400)
    inside = slice(20, -20)  # smoothing bends the ends
    assert plan.elevation[inside] == pytest.approx(road[inside], abs=0.7)


def test_without_altitude_the_road_is_flat():
    speeds = [r for r in hilly_readings() if isinstance(r, SpeedReading)]
    assert not driven_plan(speeds).elevation.any()


def test_a_moment_is_no_drive():
    with pytest.raises(InputError, match="less than 10 s"):
        driven_plan(hilly_readings(5))


def test_totals_leave_out_the_first():
    drives = [
        PlannedForecast(100.0, energy, 10.0, 0.0, 1.0) for energy in (500.0, 110.0, 120.0, 84.0)
    ]
    median, mean, covered, counted = forecast_totals(drives)
    assert (median, mean) == (pytest.approx(16.0), pytest.approx(46.0 / 3))
    assert (covered, counted) == (2, 3)  # 10 and 16 J off, of 16.4
    assert forecast_totals(drives[:1]) is None


def test_the_second_time_a_drive_is_known_better(vehicle):
    bag = share_directory() / "bags" / "urban"
    readings = list(itertools.islice(open_source(bag, vehicle).readings(), 5000))
    benchmark = ForecastBenchmark(vehicle, time.thread_time)
    first, second = benchmark.drive(readings), benchmark.drive(readings)
    assert first.measured_j == second.measured_j > 0
    assert abs(second.error_percent) < 0.5 * abs(first.error_percent)
    assert second.covered and second.sigma_j < 0.6 * first.sigma_j
