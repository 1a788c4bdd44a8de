from itertools import pairwise

import pytest

from evpinn_ros.can.restraint import (
    AWAKE_FRAMES,
    DRIVING_FOR_S,
    FIRST_WAIT_S,
    IDLE_FOR_S,
    LONGEST_WAIT_S,
    LOW_FOR_S,
    QUIET_S,
    UNANSWERED_S,
    WOKEN_UNANSWERED_S,
    Leave,
    Restraint,
)
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading


@pytest.fixture
def restraint():
    return Restraint()


def asleep(restraint, now_s=0.0, patience_s=UNANSWERED_S):
    """Ask in vain from `now_s` on; gives when that ended."""
    restraint.asked(now_s, sent=True)
    restraint.asked(now_s + patience_s, sent=True)
    assert restraint.leave is Leave.NOTHING
    return now_s + patience_s


def traffic(restraint, now_s, ids=(0x100, 0x200, 0x300), frames=AWAKE_FRAMES, step_s=0.01):
    """Frames of a bus; True when any of them ends a stop."""
    times_s = [now_s + index * step_s for index in range(frames)]
    ends = [
        restraint.record_frame(ids[i % len(ids)], False, at_s) for i, at_s in enumerate(times_s)
    ]
    return any(ends)


def test_an_answer_or_no_bus_starts_the_silence_anew(restraint):
    restraint.asked(0.0, sent=True)
    restraint.answered()
    restraint.asked(20.0, sent=True)
    restraint.asked(40.0, sent=True)
    assert restraint.reason is None
    restraint.asked(45.0, sent=False)
    restraint.asked(55.0, sent=True)
    assert restraint.reason is None


def test_only_a_car_that_wakes_ends_a_stop(restraint):
    for second in range(600):  # the bus goes on: nothing says that the car woke
        assert not traffic(restraint, second, frames=30)
        if restraint.reason is None:
            restraint.asked(second, sent=True)
    assert restraint.leave is Leave.NOTHING
    now = 600.0 + QUIET_S
    assert traffic(restraint, now) and restraint.reason is None
    restraint.asked(now + 1, sent=True)
    assert restraint.leave is Leave.ALL


@pytest.mark.parametrize(
    "stray",
    [
        {"frames": 1},
        {"ids": (0x100,)},  # one control unit that is restless
        {"ids": (0x7E0, 0x7E4, 0x7DF)},  # a dongle that asks
        {"step_s": 1.0},
    ],
)
def test_stray_frames_are_no_car_that_wakes(restraint, stray):
    now = asleep(restraint)
    for turn in range(1, 100):
        assert not traffic(restraint, now + 30.0 * turn, **stray)


def test_what_woke_in_vain_is_accepted_later_each_time(restraint):
    now, woken = asleep(restraint), []
    while now < 24 * 3600.0:
        now += 12.0
        if traffic(restraint, now):
            woken.append(now)
            asleep(restraint, now + 1, WOKEN_UNANSWERED_S)
    gaps = [b - a for a, b in pairwise(woken)]
    for gap, wait in zip(gaps, (FIRST_WAIT_S * 2**n for n in range(6)), strict=False):
        assert wait <= gap <= wait + 12.0
    assert all(gap >= LONGEST_WAIT_S for gap in gaps[6:])
    assert len(woken) <= 7 + 24


def test_an_answer_ends_the_doubt(restraint):
    now = asleep(restraint)
    assert traffic(restraint, now + 20)
    restraint.asked(now + 21, sent=True)
    restraint.answered()
    end = asleep(restraint, now + 100)
    assert traffic(restraint, end + 20)


def test_low_12_v_stops_a_standing_car(restraint):
    restraint.auxiliary(11.9, 0.0)
    restraint.auxiliary(12.1, 5.0)
    restraint.auxiliary(11.9, 6.0)
    restraint.auxiliary(11.9, 5.0 + LOW_FOR_S)
    assert restraint.reason is None
    restraint.auxiliary(11.84, 6.0 + LOW_FOR_S)
    assert restraint.reason.endswith("11.8 V")


def test_low_12_v_stays_until_a_higher_voltage_is_seen(restraint):
    restraint.auxiliary(11.8, 0.0)
    restraint.auxiliary(11.8, LOW_FOR_S)
    now, asked = LOW_FOR_S, 0
    while now < 3600.0:  # every awakening may ask for the voltage, once, and later each time
        now += 12.0
        traffic(restraint, now)
        if restraint.leave is Leave.AUXILIARY:
            asked += 1
            restraint.asked(now + 0.3, sent=True)
            restraint.answered()
            restraint.auxiliary(12.2, now + 0.4)
        assert restraint.leave is Leave.NOTHING
        assert restraint.reason.endswith("11.8 V")
    assert asked <= 7
    restraint.auxiliary(13.9, now)  # another tester asked for it, or we did
    assert restraint.reason is None and restraint.leave is Leave.ALL


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
    assert restraint.reason.startswith("no current for 10 min")
