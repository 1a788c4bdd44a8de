import math

import numpy as np
import pytest

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    GradeReading,
    PressureReading,
    Reading,
    SpeedReading,
    TemperatureReading,
    WindReading,
)
from evpinn_ros.core.signals.road import GradeSource, Road
from test.core.signals.conftest import now
from test.core.signals.conftest import stamp_at as at


def add(road: Road, reading: Reading) -> None:
    """Take one reading."""
    road.extend(Block.of([reading]), np.empty(0, np.int64), np.empty(0))


def travel(road: Road, distance: float) -> None:
    """Move on by a distance, m."""
    road.extend(Block.of([]), np.zeros(1, np.int64), np.array([distance]))


def grade(road: Road, moment: int) -> float:
    """Grade at a moment, rad, by all that came."""
    return float(road.grades(now(moment))[0])


def climb(road: Road, slope: float, seconds: int = 20, begin: int = 0) -> int:
    """Drive at 10 m/s with one altitude a second on a road that rises `slope` m each m."""
    for second in range(seconds):
        add(road, AltitudeReading(at(begin + second), 100.0 + slope * 10.0 * second))
        travel(road, 10.0)
    return at(begin + seconds - 1)


@pytest.mark.parametrize("slope", [0.05, -0.05, 0.0])
def test_grade_from_altitude_is_positive_uphill(slope):
    road = Road(GradeSource.AUTO, 1.2)
    assert grade(road, climb(road, slope)) == pytest.approx(math.atan(slope), rel=0.1)
    assert grade(road, climb(road, slope, seconds=200)) == pytest.approx(
        math.atan(slope), abs=1e-4
    )


def test_a_noisy_barometer_makes_no_hills():
    """On a flat road: a line through the last 60 m would be off by 0.016 rad, 1-sigma."""
    rng = np.random.default_rng(0)
    road, grades = Road(GradeSource.FIX, 1.2), []
    for second in range(600):
        add(road, AltitudeReading(at(second), 100.0 + 0.7 * rng.standard_normal()))
        travel(road, 10.0)
        grades.append(grade(road, at(second)))
    assert 0.0 < np.std(grades) < 0.006


def test_grade_from_altitude_needs_fresh_news():
    road = Road(GradeSource.FIX, 1.2)
    assert grade(road, at(2)) == 0.0
    now = climb(road, 0.05)
    assert grade(road, now + 9 * NANOSECONDS) == pytest.approx(math.atan(0.05), rel=0.1)
    assert grade(road, now + 11 * NANOSECONDS) == 0.0
    road.forget()
    assert grade(road, now) == 0.0


def test_a_slope_no_road_has_is_not_believed():
    road = Road(GradeSource.FIX, 1.2)
    assert grade(road, climb(road, 0.4, seconds=200)) == 0.0


def test_a_parked_car_piles_up_no_altitudes():
    """An hour at 10 Hz on one spot, then off: still quick, and the grade of the new road."""
    road = Road(GradeSource.FIX, 1.2)
    parked = Block.of(AltitudeReading(at(tick / 10), 100.0) for tick in range(36_000))
    road.extend(parked, np.empty(0, np.int64), np.empty(0))
    assert grade(road, at(3600)) == 0.0
    travel(road, 1.0)
    now = climb(road, 0.05, seconds=200, begin=3600)
    assert grade(road, now) == pytest.approx(math.atan(0.05), abs=1e-3)


def test_grade_from_the_imu_is_a_mean_over_a_second():
    road = Road(GradeSource.IMU, 1.2)
    for tick, pitch in enumerate([0.3, 0.3, *[0.02, 0.04] * 5, 0.03]):
        add(road, GradeReading(at(tick / 10), pitch))
    # 0.02 to 1.2 s: the readings of the last second, 0.2 to 1.2 s, five pairs and 0.03
    assert grade(road, at(1.2)) == pytest.approx((5 * 0.06 + 0.03) / 11)
    assert grade(road, at(12.0)) == 0.0


def test_sources():
    both = {source: Road(source, 1.2) for source in GradeSource}
    for road in both.values():
        now = climb(road, 0.05, seconds=200)
        add(road, GradeReading(now, 0.01))
    grades = {source.value: grade(road, now) for source, road in both.items()}
    fix = pytest.approx(math.atan(0.05), abs=1e-4)
    assert grades == {"none": 0.0, "imu": 0.01, "fix": fix, "auto": 0.01}
    assert grade(both[GradeSource.AUTO], now + 10 * NANOSECONDS) == fix  # the IMU fell silent


def density(road: Road) -> float:
    return float(road.conditions(now(at(2))).air_density[0])


def test_air_density_follows_temperature():
    road = Road(GradeSource.NONE, 1.2)
    assert density(road) == 1.2
    add(road, TemperatureReading(at(0), 20.0))
    assert density(road) == pytest.approx(1.2)
    add(road, TemperatureReading(at(1), 0.0))
    assert density(road) == pytest.approx(1.2 * 293.15 / 273.15)
    road.forget()
    assert density(road) == pytest.approx(1.2 * 293.15 / 273.15)


@pytest.mark.parametrize(
    ("kind", "value", "name", "seconds"),
    [(AuxiliaryReading, 1500.0, "load", 10.0), (WindReading, 6.0, "head_wind", 600.0)],
)
def test_known_loads_and_wind_count_while_they_are_fresh(kind, value, name, seconds):
    road = Road(GradeSource.NONE, 1.2)

    def ask(second):
        return getattr(road.conditions(now(at(second))), name)[0]

    assert ask(0) == 0.0
    add(road, kind(at(0), value))
    assert ask(seconds) == value
    assert ask(seconds + 0.1) == 0.0
    assert ask(-1) == 0.0, "not yet told"


def test_density_from_pressure_and_temperature():
    """The standard atmosphere (ISO 2533): 1.2250 kg/m^3 at 15 degrees and 101325 Pa."""
    road = Road(GradeSource.NONE, 1.16)
    add(road, PressureReading(at(0), 101_325.0))
    assert density(road) == pytest.approx(101_325.0 / (287.05 * 293.15))
    add(road, TemperatureReading(at(0), 15.0))
    assert density(road) == pytest.approx(1.2250, abs=1e-4)


def test_what_no_input_tells_is_named():
    road = Road(GradeSource.AUTO, 1.2)
    assert road.unknown(at(0)) == ("grade", "temperature", "pressure", "wind", "loads")
    for reading in (
        GradeReading(at(0), 0.01),
        PressureReading(at(0), 1e5),
        AuxiliaryReading(at(0), 500.0),
    ):
        add(road, reading)
    assert road.unknown(at(1)) == ("temperature", "wind")


@pytest.mark.parametrize("source", GradeSource)
def test_a_grade_of_a_source_that_is_not_read_is_unknown(source):
    road = Road(source, 1.2)
    add(road, GradeReading(at(0), 0.05))
    assert ("grade" in road.unknown(at(1))) == (source in (GradeSource.NONE, GradeSource.FIX))
    assert (grade(road, at(1)) == 0.0) == ("grade" in road.unknown(at(1)))


def test_a_height_is_known_at_the_first_moment_after_its_altitude():
    """One altitude a second, on a road that rises by 5 %; the first shows no rise."""
    step = 20.0  # m
    readings: list[Reading] = []
    for second in range(12):
        readings.append(SpeedReading(at(second), step))
        readings.append(AltitudeReading(at(second + 0.5), 100.0 + second))
    block = Block.of(readings)
    stamps = block.of_kind(SpeedReading).stamps
    road = Road(GradeSource.AUTO, 1.2)
    road.extend(block, stamps[1:], np.full(len(stamps) - 1, step))
    heights = list(road.heights(stamps, step * np.arange(len(stamps))))
    assert not heights[0]
    newest = [known[-1] for known in heights[1:]]
    assert newest == [(step * (k + 1.5), pytest.approx(k + 1.0)) for k in range(len(newest))]
