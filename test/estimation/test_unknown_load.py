import math

import pytest

from evpinn_ros.estimation.unknown_load import LOAD_STD, LOAD_TIME, UnknownLoad
from evpinn_ros.signals.readings import NANOSECONDS

SPEED, STD, STEP = 15.0, 1500.0, 0.1


def taught(force: float, seconds: float) -> UnknownLoad:
    """A load after this force was met for so long."""
    load = UnknownLoad()
    for k in range(round(seconds / STEP)):
        load.advance(k * NANOSECONDS // 10)
        load.update(SPEED, force * SPEED, STD, STEP)
    return load


def test_it_starts_without_any():
    assert UnknownLoad().power(SPEED) == (0.0, LOAD_STD * SPEED)


def test_a_force_is_found_in_seconds_and_with_less_doubt():
    power, std = taught(250.0, 10.0).power(SPEED)
    assert 0.75 * 250.0 * SPEED < power < 250.0 * SPEED
    assert std < 0.5 * LOAD_STD * SPEED


def test_one_sample_moves_it_little():
    """It is no last value held: of a jump of 300 N not an eighth is believed at once."""
    load = taught(0.0, 5.0)
    load.advance(5 * NANOSECONDS)
    load.update(SPEED, 300.0 * SPEED, STD, STEP)
    assert 0.0 < load.power(SPEED)[0] < 0.125 * 300.0 * SPEED


def test_an_outlier_moves_it_less_than_its_size():
    def after(force):
        load = taught(0.0, 5.0)
        load.update(SPEED, force * SPEED, STD, STEP)
        return load.power(SPEED)[0]

    assert after(3000.0) < 3.0 * after(300.0)


def test_it_fades_while_the_battery_is_silent():
    load = taught(250.0, 10.0)
    before, _ = load.power(SPEED)
    load.advance(round((9.9 + LOAD_TIME) * NANOSECONDS))
    assert load.power(SPEED)[0] == pytest.approx(before / math.e)
    load.advance(round((9.9 + 30 * LOAD_TIME) * NANOSECONDS))
    assert load.power(SPEED) == pytest.approx((0.0, LOAD_STD * SPEED), abs=1e-6)


def test_a_standing_car_teaches_nothing():
    load = taught(250.0, 10.0)
    before = load.power(SPEED)
    load.update(0.0, 5000.0, 60.0, STEP)
    assert load.power(SPEED) == before and load.power(0.0) == (0.0, 0.0)


def test_forgetting():
    load = taught(250.0, 10.0)
    load.forget()
    load.advance(0)  # whatever the time is now
    assert load.power(SPEED) == (0.0, LOAD_STD * SPEED)
