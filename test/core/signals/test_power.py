"""Voltage and current, each with its own stamps, and the power of the motor."""

import math

import numpy as np
import pytest

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.kinematics import SpeedTrack
from evpinn_ros.core.signals.power import NOMINAL_RATIO, UNMEASURED, BatteryTrack, MotorTrack
from evpinn_ros.core.signals.readings import BatteryReading, MotorReading
from evpinn_ros.core.signals.track import LATER, NEVER
from test.core.signals.conftest import now
from test.core.signals.conftest import stamp_at as at


def voltage(t):
    return 380.0 - 0.5 * t


def current(t):
    return -40.0 - 30.0 * np.sin(t / 4.0)


def track(step=0.1, shift=0.0, paired=True, seconds=40.0) -> BatteryTrack:
    """Readings each `step`, all in one row or the current `shift` later on its own."""
    battery = BatteryTrack(2.5)
    for t in np.arange(0.0, seconds, step).tolist():
        if paired:
            add(battery, BatteryReading(at(t), voltage(t), float(current(t))))
        else:
            add(battery, BatteryReading(at(t), voltage(t), math.nan))
            add(battery, BatteryReading(at(t + shift), math.nan, float(current(t + shift))))
    return battery


def add(battery: BatteryTrack, *readings: BatteryReading) -> None:
    """Take readings in order of stamps."""
    battery.extend(Block.of(readings).rows[BatteryReading])


def drawn(start: float, end: float) -> float:
    t = np.linspace(start, end, 20_001)
    return float(np.trapezoid(-voltage(t) * current(t), t))


def test_power_is_positive_when_drawn_from_the_battery():
    """`sensor_msgs/BatteryState`: a discharging current is negative. P = -V I."""
    assert BatteryReading(0, 350.0, -20.0).power == 7000.0
    assert BatteryReading(0, 350.0, 20.0).power == -7000.0
    battery = BatteryTrack(2.5)
    add(battery, BatteryReading(at(0.0), 350.0, 20.0))
    assert battery.at(now(at(0.0))) == [-7000.0]


def test_energy_of_separate_rows_is_that_of_pairs():
    paired, apart = track(), track(shift=0.05, paired=False)
    expected = drawn(5.0, 11.0)
    for battery in (paired, apart):
        assert battery.energy(at(5.0), at(11.0)).energy == pytest.approx(expected, rel=1e-4)
    expected = -voltage(5.02) * current(5.02)
    assert apart.at(now(at(5.02))) == pytest.approx([expected], rel=1e-3)
    assert apart.newest_ns == at(39.9)


def test_the_slower_the_less_certain_and_the_error_is_within():
    """Also with the ends between readings: their interpolation is part of it."""
    variances, deviates = [], []
    for step in (0.1, 0.5, 1.2, 3.0):
        battery = track(step=step, shift=step / 2, paired=False)
        parts = [battery.energy(at(b), at(b + 6.0)) for b in np.arange(5.3, 25.0, 1.7)]
        variances.append(np.mean([part.variance for part in parts]))
        truth = [drawn(b, b + 6.0) for b in np.arange(5.3, 25.0, 1.7)]
        deviates += [
            (part.energy - true) / math.sqrt(part.variance)
            for part, true in zip(parts, truth, strict=True)
        ]
    assert variances == sorted(variances) and variances[-1] > 100 * variances[0]
    assert np.abs(deviates).max() < 2.0


def test_what_was_not_measured_has_no_energy():
    battery = track(seconds=20.0)
    assert battery.energy(at(-1.0), at(5.0)) is UNMEASURED is battery.energy(at(18.0), at(24.0))
    add(battery, BatteryReading(at(30.0), 380.0, -1.0))
    assert battery.energy(at(18.0), at(24.0)) is UNMEASURED, "across a gap nothing is joined"
    only_voltage = BatteryTrack(2.5)
    add(only_voltage, BatteryReading(at(0.0), 380.0, math.nan))
    after = only_voltage.first_after(np.array([at(0.0)]))
    assert only_voltage.newest_ns == NEVER and after == [LATER]


def test_whole_kilowatts_are_as_unsure_as_their_energies_are_off():
    """Intervals of ten seconds at 1 Hz; where power rests, its readings have one error."""
    random, std = np.random.default_rng(1), 1000.0 / math.sqrt(12.0)
    deviates, shares = [], []
    for _ in range(200):
        power = (
            8e3
            + 6e3 * random.normal()
            + 500.0 * random.choice([0.0, 3.0]) * np.cumsum(random.normal(size=11))
        )
        exact, coarse, plain = BatteryTrack(2.5), BatteryTrack(2.5), BatteryTrack(2.5)
        for second, watts in enumerate(power.tolist()):
            add(exact, BatteryReading(at(second), 400.0, -watts / 400.0))
            whole = -1000.0 * round(watts / 1000.0) / 400.0
            add(coarse, BatteryReading(at(second), 400.0, whole, power_std=std))
            add(plain, BatteryReading(at(second), 400.0, whole))
        rounded, without_std = coarse.energy(at(0), at(10)), plain.energy(at(0), at(10))
        own = rounded.variance - without_std.variance
        deviates.append((rounded.energy - exact.energy(at(0), at(10)).energy) / math.sqrt(own))
        shares.append(math.sqrt(own) / (std * 10.0))
    assert 0.8 < np.std(deviates) < 1.2
    assert min(shares) < 0.4 and max(shares) == pytest.approx(1.0)


def insert(motor: MotorTrack, reading: MotorReading, car_speed: float) -> None:
    """Take a reading at a speed of the car."""
    speed = SpeedTrack(2.5)
    speed.extend(np.array([reading.stamp_ns]), np.array([car_speed]))
    motor.extend(Block.of([reading]).rows[MotorReading], speed)


def torque(t):
    return 100.0 * np.sin(t)


def energies(motor: MotorTrack, *seconds: float) -> np.ndarray:
    """Energy of driving and braking, J, between moments, once all readings have come."""
    ends = np.array([at(float(t)) for t in seconds])
    return motor.energies(ends)


def test_energy_of_driving_and_braking_stand_apart():
    """A torque that changes its sign, at 200 rad/s: 2 s of either sign, 100 N m at most."""
    motor = MotorTrack(2.5, math.nan)
    for t in np.arange(0.0, 2 * math.pi + 0.02, 0.01).tolist():
        insert(motor, MotorReading(at(t), float(torque(t)), 200.0), math.nan)
    whole = energies(motor, 0.0, 2 * math.pi)
    assert whole[:, 0] == pytest.approx([200.0 * 200.0] * 2, rel=1e-4)
    halves = energies(motor, 0.0, math.pi, 2 * math.pi)
    assert halves[1, 0] == pytest.approx(0.0, abs=1.0) == halves[0, 1]
    steps = energies(motor, *np.linspace(0.0, 2 * math.pi, 8))
    assert steps.sum(axis=1) == pytest.approx(whole[:, 0], rel=1e-9)


def test_only_steps_across_a_gap_have_no_motor_energy():
    motor = MotorTrack(2.5, math.nan)
    for t in (*np.arange(0.0, 5.0, 0.5), *np.arange(9.0, 12.0, 0.5)):
        insert(motor, MotorReading(at(float(t)), 100.0, 20.0), math.nan)
    drive, brake = energies(motor, -1.0, 1.0, 2.2, 4.0, 9.5, 11.5, 12.5)
    unknown = [True, False, False, True, False, True]
    assert np.isnan(drive).tolist() == unknown == np.isnan(brake).tolist()
    assert drive[[1, 2, 4]] == pytest.approx([2400.0, 3600.0, 4000.0])


@pytest.mark.parametrize(("ratio", "taken"), [(27.0, 27.0), (math.nan, NOMINAL_RATIO)])
def test_turning_comes_from_the_car_where_the_motor_is_silent(ratio, taken):
    motor = MotorTrack(2.5, ratio)
    for t in (0.0, 0.5, 1.0):
        insert(motor, MotorReading(at(t), 100.0), 15.0)
    assert bool(motor.scaled(at(0.7))) != math.isnan(ratio)
    assert motor.at(now(at(0.7)), now(at(1.0))) == pytest.approx([100.0 * taken * 15.0])


def test_the_last_reading_holds_for_a_while_and_no_longer():
    motor = MotorTrack(2.5, math.nan)
    insert(motor, MotorReading(at(0.0), 50.0, 100.0), math.nan)
    held, late, early = motor.at(now(at(2.0), at(3.0), at(-1.0)), now(at(4.0)))
    assert held == 5000.0 and math.isnan(late) and math.isnan(early)
    assert np.isnan(energies(motor, 0.0, 1.0)).all()
