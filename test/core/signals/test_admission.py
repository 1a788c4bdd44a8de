from collections import Counter
from dataclasses import replace
import math

from hypothesis import example, given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.signals.admission import MAX_POWER, Admission, CarLimits
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import (
    MAX_CURRENT,
    MAX_VOLTAGE,
    NANOSECONDS,
    BatteryReading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.core.vehicle.files import load_vehicle, vehicle_names

LIMITS = CarLimits.of(load_vehicle("tesla_model_3_lr"))


def stamp(seconds):
    return round(seconds * NANOSECONDS)


def battery(voltage, current, seconds=0.0):
    return BatteryReading(stamp(seconds), voltage, current)


def speeds(values, step=1.0):
    return [SpeedReading(stamp(step * i), value) for i, value in enumerate(values)]


def admitted(readings, limits=LIMITS):
    admission = Admission(limits)
    return [reading for reading in readings if admission.admits(reading)], admission.refused


def test_limits_are_those_of_the_car():
    assert LIMITS.power == pytest.approx(772e3)
    assert LIMITS.voltage == 3 * 350.0
    assert admitted([battery(350.0, -2100.0), battery(300.0, -1500.0)])[1] == {}
    assert admitted([battery(350.0, 2300.0)])[1] == {"battery_beyond_car": 1}
    assert admitted([battery(math.nan, -3000.0)])[1] == {"battery_beyond_car": 1}
    assert admitted([battery(1100.0, math.nan)])[1] == {"battery_beyond_car": 1}


@pytest.mark.parametrize("name", vehicle_names())
def test_a_car_can_do_what_drivers_and_chargers_ask(name):
    """4 W a gram of the strongest cars is a C-rate of ten and more; chargers give less."""
    vehicle = load_vehicle(name)
    limits = CarLimits.of(vehicle)
    assert limits.power >= min(250.0 * vehicle.initial.mass, 350e3)
    assert vehicle.nominal_voltage * 1.3 < limits.voltage <= MAX_VOLTAGE
    assert limits.current <= MAX_CURRENT and limits.power <= MAX_POWER


def test_a_lorry_has_the_limits_of_all_vehicles():
    generic = load_vehicle("generic")
    priors = dict(generic.priors, mass=replace(generic.priors["mass"], value=4e4))
    lorry = CarLimits.of(replace(generic, priors=priors, nominal_voltage=800.0))
    assert lorry == (MAX_POWER, MAX_VOLTAGE, MAX_CURRENT)


@pytest.mark.parametrize(
    ("voltage", "current", "reason"),
    [
        (350.0, 3276.7, "battery_beyond_car"),
        (350.0, -3276.8, "battery_beyond_car"),
        (350.0, 6553.5, "battery_out_of_range"),
        (6553.5, 20.0, "battery_out_of_range"),
        (0.0, 0.0, "battery_out_of_range"),
        (655.35, 20.0, "voltage_sentinel_655.35"),
        (255.0, 20.0, "voltage_sentinel_255"),
        (350.0, 1638.3, "current_sentinel_1638.3"),
        (350.0, -327.68, "current_sentinel_-327.68"),
    ],
)
def test_what_a_bus_sends_in_place_of_a_measurement_is_refused(voltage, current, reason):
    rows = [battery(351.0, -20.0, i) for i in range(10)]
    rows[4] = rows[7] = replace(rows[4], voltage=voltage, current=current)
    kept, refused = admitted(rows)
    assert refused == {reason: 2}
    assert kept == [row for row in rows if row.voltage == 351.0]


def test_a_car_may_have_a_value_of_the_table_in_earnest():
    ramp = [battery(409.5 + 0.1 * i, -(255.0 - 5.0) - 1.0 * i, 0.1 * i) for i in range(10)]
    assert admitted(ramp)[1] == {}
    small = [battery(350.0, -2.0), battery(350.0, -51.2, 0.1), battery(350.0, -25.5, 0.2)]
    assert admitted(small)[1] == {}


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (255 / 3.6, "speed_sentinel_255"),
        (163.83 / 3.6, "speed_sentinel_163.83"),
        (60.0, "speed_leaps"),
        (0.0, "speed_sentinel_0"),
        (9e11, "speed_out_of_range"),
        (math.nan, "speed_out_of_range"),
    ],
)
def test_a_speed_that_leaps_and_returns_is_refused(wrong, reason):
    values = [25.0] * 10
    values[4] = wrong
    kept, refused = admitted(speeds(values))
    reason = "speed_leaps" if reason == "speed_sentinel_0" else reason
    assert refused == {reason: 1} and [reading.speed for reading in kept] == [25.0] * 9


@pytest.mark.parametrize("held", [2, 30])
@pytest.mark.parametrize("wrong", [255 / 3.6, 163.83 / 3.6, 255 * 0.44704])
def test_a_sentinel_does_not_confirm_itself_however_long_it_is_held(wrong, held):
    kept, refused = admitted(speeds([8.0] * 3 + [wrong] * held + [12.0] * 3))
    assert [reading.speed for reading in kept] == [8.0] * 3 + [12.0] * 3
    assert sum(refused.values()) == held


def test_a_speed_that_leaps_and_stays_is_confirmed_by_the_second_reading():
    kept, refused = admitted(speeds([0.0, 0.0, 30.0, 31.0, 32.0]))
    assert [reading.speed for reading in kept] == [0.0, 0.0, 31.0, 32.0]
    assert refused == {"speed_leaps": 1}


def test_across_a_gap_of_time_any_speed_follows_any_other():
    far = SpeedReading(stamp(60.0), 30.0)
    assert admitted([*speeds([0.0, 0.0]), far])[1] == {}


@given(
    st.lists(st.floats(-8.0, 5.0), min_size=1, max_size=60), st.sampled_from([0.01, 0.1, 1.0, 5.0])
)
def test_no_speed_that_tyres_allow_is_refused(accelerations, step):
    values = np.clip(20.0 + np.cumsum(accelerations) * step, 0.0, 90.0)
    assert admitted(speeds(values, step))[1] == {}


def test_other_readings_are_judged_by_their_range():
    kept, refused = admitted([TemperatureReading(0, 20.0), TemperatureReading(0, 200.0)])
    assert len(kept) == 1 and refused == Counter(temperature_out_of_range=1)


likely = st.sampled_from(
    [0.0, 10.0, 10.5, 20.0, 70.0, 255.0, 255.0 / 3.6, 327.67, 400.0, math.nan]
)
tense = st.sampled_from([350.0, 360.0, 204.7, 409.5, 655.35, 2000.0, math.nan])
drawn = st.sampled_from([-20.0, 60.0, -204.7, 204.7, -327.67, 1638.3, 4000.0, math.nan])
moments = st.integers(0, 12)  # half seconds
any_readings = st.lists(
    st.builds(lambda at, speed: SpeedReading(stamp(at / 2), speed), moments, likely)
    | st.builds(lambda at, *of: battery(*of, at / 2), moments, tense, drawn)
    | st.builds(lambda at, celsius: TemperatureReading(stamp(at / 2), celsius), moments, likely)
)


@given(any_readings, st.integers(1, 50))
@example(speeds([0.0, 10.0, 20.0, 0.0, 0.0], step=0.9), 5)  # far from the last, near the first
def test_blocks_are_admitted_as_their_readings_are_one_by_one(readings, size):
    """Two ways to the one rule: nodes ask of a reading, files of thousands."""
    alone, refused = admitted(readings)
    in_blocks = Admission(LIMITS)
    together = [
        reading
        for part in Block.of(readings).parts(size)
        for reading in in_blocks.admit(part).readings()
    ]
    assert list(map(repr, together)) == list(map(repr, alone))
    assert in_blocks.refused == refused
