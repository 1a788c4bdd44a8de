import pytest

from evpinn_ros.can.restraint import (
    DRIVING_FOR_S,
    IDLE_FOR_S,
    LOW_FOR_S,
    QUIET_S,
    UNANSWERED_S,
    Restraint,
)
from evpinn_ros.signals.readings import BatteryReading, SpeedReading


@pytest.fixture
def restraint():
    return Restraint()


def test_silence_stops(restraint):
    restraint.asked(0.0, sent=True)
    restraint.asked(UNANSWERED_S - 1, sent=True)
    assert restraint.reason is None
    restraint.asked(UNANSWERED_S, sent=True)
    assert restraint.reason == "no answer for 30 s: the car sleeps, or is another one"


def test_an_answer_or_no_bus_starts_the_silence_anew(restraint):
    restraint.asked(0.0, sent=True)
    restraint.answered()
    restraint.asked(20.0, sent=True)
    restraint.asked(40.0, sent=True)
    assert restraint.reason is None
    restraint.asked(45.0, sent=False)
    restraint.asked(55.0, sent=True)
    assert restraint.reason is None


def test_only_a_bus_that_wakes_ends_a_stop(restraint):
    restraint.heard(0.0)
    restraint.asked(0.0, sent=True)
    restraint.asked(UNANSWERED_S, sent=True)
    for now in (9.0, 18.0, 27.0, 36.0, 45.0):  # the bus goes on: nothing says that the car woke
        assert not restraint.heard(now)
    assert restraint.heard(45.0 + QUIET_S) and restraint.reason is None
    restraint.asked(60.0, sent=True)
    assert restraint.reason is None


def test_the_first_frame_of_all_wakes(restraint):
    restraint.asked(0.0, sent=True)
    restraint.asked(UNANSWERED_S, sent=True)
    assert restraint.heard(1000.0) and restraint.reason is None


def test_low_12_v_stops_a_standing_car(restraint):
    restraint.auxiliary(11.9, 0.0)
    restraint.auxiliary(12.1, 5.0)
    restraint.auxiliary(11.9, 6.0)
    restraint.auxiliary(11.9, 5.0 + LOW_FOR_S)
    assert restraint.reason is None
    restraint.auxiliary(11.84, 6.0 + LOW_FOR_S)
    assert restraint.reason == "the 12 V battery is low: 11.8 V"


def test_low_12_v_of_a_driving_car_is_its_own_affair(restraint):
    for now in range(60):
        restraint.observe(SpeedReading(0, 10.0), now)
        restraint.auxiliary(11.5, now)
    assert restraint.reason is None
    for now in range(60, 60 + int(DRIVING_FOR_S + LOW_FOR_S) + 1):
        restraint.observe(SpeedReading(0, 0.0), now)
        restraint.auxiliary(11.5, now)
    assert restraint.reason is not None


def test_no_current_stops(restraint):
    restraint.observe(BatteryReading(0, 400.0, 0.1), 0.0)
    restraint.observe(BatteryReading(0, 400.0, -0.6), IDLE_FOR_S - 1)
    restraint.observe(BatteryReading(0, 400.0, 0.0), IDLE_FOR_S)
    assert restraint.reason is None
    restraint.observe(BatteryReading(0, 400.0, 0.0), 2 * IDLE_FOR_S)
    assert restraint.reason == "no current for 10 min: asking would keep it awake"
