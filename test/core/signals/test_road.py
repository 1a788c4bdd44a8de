import math

import numpy as np
import pytest

from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    GradeReading,
    PressureReading,
    TemperatureReading,
    WindReading,
)
from evpinn_ros.core.signals.road import GradeSource, Road
from test.core.signals.test_kinematics import at


def climb(road: Road, slope: float, seconds: int = 20, speed: float = 10.0) -> int:
    """Drive with one altitude a second on a road that rises `slope` m each m of road."""
    for second in range(seconds):
        road.add_reading(AltitudeReading(at(second), 100.0 + slope * speed * second))
        road.travel(speed)
    return at(seconds - 1)


@pytest.mark.parametrize("slope", [0.05, -0.05, 0.0])
def test_grade_from_altitude_is_positive_uphill(slope):
    road = Road(GradeSource.AUTO, 1.2)
    assert road.grade(climb(road, slope)) == pytest.approx(math.atan(slope), rel=0.1)
    assert road.grade(climb(road, slope, seconds=200)) == pytest.approx(math.atan(slope), abs=1e-4)


def test_a_noisy_barometer_makes_no_hills():
    """On a flat road: a line through the last 60 m would be off by 0.016 rad, 1-sigma."""
    rng = np.random.default_rng(0)
    road, grades = Road(GradeSource.FIX, 1.2), []
    for second in range(600):
        road.add_reading(AltitudeReading(at(second), 100.0 + 0.7 * rng.standard_normal()))
        road.travel(10.0)
        grades.append(road.grade(at(second)))
    assert 0.0 < np.std(grades) < 0.006


def test_grade_from_altitude_needs_fresh_news():
    road = Road(GradeSource.FIX, 1.2)
    assert road.grade(at(2)) == 0.0
    now = climb(road, 0.05)
    assert road.grade(now + 9 * NANOSECONDS) == pytest.approx(math.atan(0.05), rel=0.1)
    assert road.grade(now + 11 * NANOSECONDS) == 0.0
    road.forget()
    assert road.grade(now) == 0.0


def test_a_slope_no_road_has_is_not_believed():
    road = Road(GradeSource.FIX, 1.2)
    assert road.grade(climb(road, 0.4, seconds=200)) == 0.0


def test_a_parked_car_piles_up_no_altitudes():
    """An hour at 10 Hz on one spot, then off: still quick, and the grade of the new road."""
    road = Road(GradeSource.FIX, 1.2)
    for tick in range(36_000):
        road.add_reading(AltitudeReading(at(tick / 10), 100.0))
    assert road.grade(at(3600)) == 0.0
    road.travel(1.0)
    now = climb(road, 0.05, seconds=200)
    assert road.grade(now) == pytest.approx(math.atan(0.05), abs=1e-3)


def test_grade_from_the_imu_is_a_mean_over_a_second():
    road = Road(GradeSource.IMU, 1.2)
    for tick, grade in enumerate([0.3, 0.3, *[0.02, 0.04] * 5, 0.03]):
        road.add_reading(GradeReading(at(tick / 10), grade))
    # 0.02 to 1.2 s: the readings of the last second, 0.2 to 1.2 s, five pairs and 0.03
    assert road.grade(at(1.2)) == pytest.approx((5 * 0.06 + 0.03) / 11)
    assert road.grade(at(12.0)) == 0.0


def test_a_stray_stamp_does_not_keep_an_old_grade():
    road = Road(GradeSource.IMU, 1.2)
    road.add_reading(GradeReading(2**62, 0.2))
    assert road.grade(at(0)) == 0.0
    for tick in range(11):
        road.add_reading(GradeReading(at(tick / 10), 0.01))
    assert road.grade(at(1.0)) == pytest.approx(0.01)


def test_sources():
    both = {source: Road(source, 1.2) for source in GradeSource}
    for road in both.values():
        now = climb(road, 0.05, seconds=200)
        road.add_reading(GradeReading(now, 0.01))
    grades = {source.value: road.grade(now) for source, road in both.items()}
    fix = pytest.approx(math.atan(0.05), abs=1e-4)
    assert grades == {"none": 0.0, "imu": 0.01, "fix": fix, "auto": 0.01}
    assert both[GradeSource.AUTO].grade(now + 10 * NANOSECONDS) == fix  # the IMU fell silent


def density(road: Road) -> float:
    return road.conditions(at(0)).air_density


def test_air_density_follows_temperature():
    road = Road(GradeSource.NONE, 1.2)
    assert density(road) == 1.2
    road.add_reading(TemperatureReading(at(0), 20.0))
    assert density(road) == pytest.approx(1.2)
    road.add_reading(TemperatureReading(at(1), 0.0))
    assert density(road) == pytest.approx(1.2 * 293.15 / 273.15)
    road.forget()
    assert density(road) == pytest.approx(1.2 * 293.15 / 273.15)


@pytest.mark.parametrize(
    ("kind", "value", "name", "seconds"),
    [
        (AuxiliaryReading, 1500.0, "load", 10.0),
        (WindReading, 6.0, "head_wind", 600.0),
    ],
)
def test_known_loads_and_wind_count_while_they_are_fresh(kind, value, name, seconds):
    road = Road(GradeSource.NONE, 1.2)

    def ask(second):
        return getattr(road.conditions(at(second)), name)

    assert ask(0) == 0.0
    road.add_reading(kind(at(0), value))
    assert ask(seconds) == value
    assert ask(seconds + 0.1) == 0.0
    road.add_reading(kind(2**62, value / 2))
    assert ask(0) == 0.0


@pytest.mark.parametrize(
    ("celsius", "known"), [(None, 1750.0), (-5.0, 1750.0), (19.5, 1750.0), (25.0, 250.0)]
)
def test_a_heater_is_not_believed_on_a_warm_day(celsius, known):
    road = Road(GradeSource.NONE, 1.2)
    if celsius is not None:
        road.add_reading(TemperatureReading(at(0), celsius))
    road.add_reading(AuxiliaryReading(at(0), 1500.0, 250.0))
    assert road.conditions(at(1)).load == known


def test_density_from_pressure_and_temperature():
    """The standard atmosphere (ISO 2533): 1.2250 kg/m^3 at 15 degrees and 101325 Pa."""
    road = Road(GradeSource.NONE, 1.16)
    road.add_reading(PressureReading(at(0), 101_325.0))
    assert density(road) == pytest.approx(101_325.0 / (287.05 * 293.15))
    road.add_reading(TemperatureReading(at(0), 15.0))
    assert density(road) == pytest.approx(1.2250, abs=1e-4)


def test_what_no_input_tells_is_named():
    road = Road(GradeSource.AUTO, 1.2)
    assert road.unknown(at(0)) == ("grade", "temperature", "pressure", "wind", "loads")
    for reading in (
        GradeReading(at(0), 0.01),
        PressureReading(at(0), 1e5),
        AuxiliaryReading(at(0), 500.0),
    ):
        road.add_reading(reading)
    assert road.unknown(at(1)) == ("temperature", "wind")
