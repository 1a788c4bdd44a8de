from dataclasses import replace

import pytest

from benchmarks.carried import CarriedBenchmark, CarriedForecast, energy_errors
from evpinn_ros.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.simulate import simulate

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def drive(vehicle):
    return simulate(DriveKind.URBAN, vehicle, 60.0, 3, altitude=True).readings


def benchmark(vehicle, *, speed_only=False) -> CarriedBenchmark:
    return CarriedBenchmark(vehicle, lambda: 0.0, speed_only=speed_only)


@pytest.fixture(scope="module")
def forecast(vehicle, drive) -> CarriedForecast:
    """Of the drive, by a car of which nothing was learned."""
    return benchmark(vehicle).drive(lambda: drive)


def test_a_drive_is_forecast_without_its_battery(vehicle, drive, forecast):
    """Twice the current: twice the energy measured, and the very same forecast."""
    double = [
        replace(each, current=2 * each.current) if isinstance(each, BatteryReading) else each
        for each in drive
    ]
    other = benchmark(vehicle).drive(lambda: double)
    assert other.measured_j == pytest.approx(2 * forecast.measured_j)
    assert other.predicted_j == forecast.predicted_j


def test_what_one_drive_taught_improves_the_next_forecast(vehicle, drive):
    found = benchmark(vehicle)
    first, again = found.drive(lambda: drive), found.drive(lambda: drive)
    assert abs(again.error_percent) < abs(first.error_percent)
    assert abs(again.predicted_j - again.measured_j) < abs(first.predicted_j - first.measured_j)


def test_speed_only_hears_nothing_else(vehicle, drive, forecast):
    bare = [each for each in drive if isinstance(each, (SpeedReading, BatteryReading))]
    assert len(bare) < len(drive)
    hidden = benchmark(vehicle, speed_only=True).drive(lambda: drive)
    assert hidden == benchmark(vehicle).drive(lambda: bare)
    assert hidden != forecast


def test_the_first_drive_does_not_count():
    def outcome(percent: float | None) -> CarriedForecast:
        return CarriedForecast(1.0, 0.9, 1.0, 1.0, percent)

    assert energy_errors(
        [outcome(90.0), outcome(-2.0), outcome(4.0), outcome(None), outcome(9.0)]
    ) == (4.0, 5.0)
    assert energy_errors([outcome(None), outcome(-6.0)]) == (6.0, 6.0)
    assert energy_errors([outcome(1.0)]) is None
