from copy import deepcopy
import math

import pytest

from evpinn_ros.core.energy.charge import CAPACITY_PRIOR, ChargeGauge, Uncertain

SECOND = 1_000_000_000
CAPACITY = 80e6  # J


def discharge(gauge, begin, end, *, capacity=CAPACITY, step=0.005, start=0, unmeasured_s=0.0):
    """From one state of charge to another, told in steps, one a second; the stamp of the last."""
    ticks = 2000
    for tick in range(ticks + 1):
        true = begin + (end - begin) * tick / ticks
        stamp = (start + tick) * SECOND
        taken = Uncertain((1.0 - true) * capacity, 1e4)
        gauge.update(stamp, round(true / step) * step, taken, unmeasured_s)
    return stamp


@pytest.mark.parametrize("prior", [CAPACITY, 0.75 * CAPACITY, math.nan])
@pytest.mark.parametrize("direction", [(0.9, 0.5), (0.4, 0.8)])
def test_capacity_is_learned_from_a_drive_and_from_a_charge(prior, direction):
    gauge = ChargeGauge(prior)
    discharge(gauge, *direction)
    assert gauge.learned >= 3
    assert gauge.capacity.value == pytest.approx(CAPACITY, rel=0.04)
    assert abs(gauge.capacity.value - CAPACITY) < 2 * gauge.capacity.sigma < 0.15 * CAPACITY


def test_a_small_change_or_coarse_steps_teach_nothing():
    gauge = ChargeGauge(CAPACITY)
    discharge(gauge, 0.9, 0.81, capacity=50e6)
    assert gauge.learned == 0 and gauge.capacity.value == CAPACITY
    coarse = ChargeGauge(CAPACITY)
    discharge(coarse, 0.9, 0.5, step=0.05, capacity=50e6)
    assert coarse.learned == 0


def test_a_trip_far_off_moves_a_known_capacity_little():
    """Trips of an i3 say 23 kWh, one in winter 29: what is farther off yet moves it less."""

    def told(gauge, kwh, start):
        gauge.begin_anew()
        gauge.update(start * SECOND, 0.75, Uncertain(0.0, 0.0), 0.0)
        gauge.update((start + 600) * SECOND, 0.5, Uncertain(0.25 * kwh * 3.6e6, 0.0), 0.0)
        return gauge.capacity.value / 3.6e6

    gauge = ChargeGauge(math.nan)
    told(gauge, 23.0, 0)
    # A spread of 5 %, and two readings that are rounded to 1 %, 25 % apart.
    assert gauge.capacity.sigma / 83e6 == pytest.approx(
        math.hypot(0.05, 0.04 / math.sqrt(6)), 0.01
    )
    for number in range(1, 101):
        told(gauge, 23.0, 1000 * number)
    assert gauge.capacity.sigma / gauge.capacity.value == pytest.approx(0.05 / 4)
    moved = [told(deepcopy(gauge), kwh, 200_000) - 23.0 for kwh in (29.0, 58.0)]
    assert 0.0 < moved[1] < moved[0] < 0.2


def test_a_change_that_was_not_measured_teaches_nothing():
    gauge = ChargeGauge(CAPACITY)
    for tick in range(200):
        unmeasured_s = float(tick) if tick < 100 else None
        gauge.update(tick * SECOND, 0.9 - tick / 400, Uncertain(tick * 1e5, 1e5), unmeasured_s)
    assert gauge.learned == 0


def test_a_reading_is_valid_for_a_minute_then_projected():
    gauge = ChargeGauge(CAPACITY)
    stamp = discharge(gauge, 0.9, 0.5)
    taken = Uncertain(0.5 * CAPACITY, 1e4)
    assert gauge.charge(stamp + 59 * SECOND, taken).value == pytest.approx(0.5)
    assert not gauge.projected(stamp + 59 * SECOND)
    later = Uncertain(taken.value + 0.1 * CAPACITY, 1e6)
    projected = gauge.charge(stamp + 600 * SECOND, later)
    assert gauge.projected(stamp + 600 * SECOND)
    assert projected.value == pytest.approx(0.4, abs=0.005)
    assert projected.sigma > gauge.rounding
    wider = gauge.charge(stamp + 600 * SECOND, later._replace(sigma=5e6))
    assert wider.sigma > 2 * projected.sigma
    assert gauge.charge(stamp + 600 * SECOND, Uncertain(9e9, 1e4)).value == 0.0


def test_energy_left_is_as_unsure_as_charge_and_capacity():
    usable = ChargeGauge(CAPACITY).usable(Uncertain(0.5, 0.01))
    assert usable.value == 0.5 * CAPACITY
    assert usable.sigma == pytest.approx(math.hypot(0.5 * CAPACITY_PRIOR, 0.01) * CAPACITY)
