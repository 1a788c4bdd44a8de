"""Readings beyond what can be are named."""

import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from evpinn_ros.core.signals.block import FIELDS, KINDS, Block, impossible
from evpinn_ros.core.signals.readings import (
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    GradeReading,
    MotorReading,
    PressureReading,
    SpeedReading,
    TemperatureReading,
    WindReading,
    sensor_sigma,
    why_impossible,
)

NAN, INF = math.nan, math.inf
BEYOND = st.floats() | st.sampled_from([-100.0, 100.0, 0.3, 50e3, 2000.0, -5000.0, NAN])


@given(st.data(), st.sampled_from(KINDS))
def test_a_block_judges_as_each_of_its_readings(data, kind):
    rows = st.tuples(*(BEYOND for _ in FIELDS[kind]))
    readings = [kind(0, *row) for row in data.draw(st.lists(rows, max_size=8))]
    reasons: list[str | None] = [None] * len(readings)
    block = Block.of(readings)
    for reason, which in impossible(kind, block.of_kind(kind)):
        for place in which.nonzero()[0].tolist():
            reasons[place] = reason
    assert reasons == [*map(why_impossible, readings)]
    assert repr([*block.readings()]) == repr(readings)


@pytest.mark.parametrize(
    ("kind", "what", "possible", "refused"),
    [
        (SpeedReading, "speed", [-100.0, 0.0, 100.0], [-100.1, 100.1]),
        (GradeReading, "grade", [-0.3, 0.3], [-0.31, 0.31]),
        (AltitudeReading, "altitude", [-500.0, 9000.0], [-501.0, 9001.0]),
        (TemperatureReading, "temperature", [-70.0, 70.0], [-273.15, 71.0]),
        (PressureReading, "pressure", [30e3, 110e3], [0.1, 120e3]),
        (WindReading, "wind", [-60.0, 60.0], [-61.0, 61.0]),
        (AuxiliaryReading, "auxiliary", [0.0, 50e3], [-1.0, 50_001.0]),
        (MotorReading, "motor_torque", [-20e3, 20e3], [-20_001.0, 20_001.0]),
    ],
)
def test_what_cannot_be_is_named(kind, what, possible, refused):
    assert [why_impossible(kind(0, value)) for value in possible] == [None] * len(possible)
    for value in (*refused, NAN, INF, -INF, 1e9, -1e9):
        assert why_impossible(kind(0, value)) == f"{what}_out_of_range"


def test_what_consists_of_two_is_possible_where_both_are():
    """Voltage, current and the motor's speed may be unknown."""
    for voltage, current in ((10.0, -5000.0), (2000.0, 5000.0), (350.0, NAN), (NAN, 1.0)):
        assert why_impossible(BatteryReading(0, voltage, current)) is None
    wrong = [(350.0, INF), (NAN, 5001.0), (5.0, NAN), (0.0, -20.0), (-1.0, 1.0), (2001.0, 1.0)]
    for voltage, current in (*wrong, (350.0, -5001.0)):
        assert why_impossible(BatteryReading(0, voltage, current)) == "battery_out_of_range"
    assert why_impossible(MotorReading(0, 100.0, NAN)) is None
    for speed in (INF, 5000.0, -5000.0):
        assert why_impossible(MotorReading(0, 100.0, speed)) == "motor_torque_out_of_range"
    assert why_impossible(AuxiliaryReading(0, 30e3, 20e3)) is None
    assert why_impossible(AuxiliaryReading(0, 30e3, 21e3)) == "auxiliary_out_of_range"
    assert why_impossible(AuxiliaryReading(0, -1.0, 2.0)) == "auxiliary_out_of_range"


def test_measured_power_is_unsure_by_its_sensor_and_its_resolution():
    """30 W and one part in a hundred, in whichever direction it flows."""
    assert sensor_sigma(0.0, NAN) == pytest.approx(30.0)
    assert sensor_sigma(-4000.0, NAN) == sensor_sigma(4000.0, NAN) == pytest.approx(50.0)
    assert sensor_sigma(4000.0, 120.0) == pytest.approx(130.0)
