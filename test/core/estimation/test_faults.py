"""What drives and sensors do to the hybrid mode, from readings to parameters."""

from itertools import groupby
import math

import numpy as np
import pytest

from benchmarks.truth import CarChain
from evpinn_ros.core.estimation.estimate import ParameterSet, PowerKind
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate

HELD = ("mass_over_eta", "regeneration")


def dropouts(readings, rng):
    return [r for r in readings if rng.uniform() > 0.3]


def jumps(readings, rng):
    """Back by an hour and forth by a day in the middle of the drive."""
    third = len(readings) // 3
    shifts = np.repeat([0, -3600, 86_400], [third, third, len(readings) - 2 * third])
    return [moved(r, int(shift)) for r, shift in zip(readings, shifts, strict=True)]


def reverse(readings, rng):
    begin = readings[0].stamp_ns
    return [
        SpeedReading(r.stamp_ns, -r.speed)
        if isinstance(r, SpeedReading) and (r.stamp_ns - begin) // NANOSECONDS % 40 < 15
        else r
        for r in readings
    ]


def slip(readings, rng):
    """Half a second of wheels that spin or lock, every ten seconds."""
    return [
        SpeedReading(r.stamp_ns, r.speed * (1.5 if k % 2 else 0.0))
        if isinstance(r, SpeedReading) and (r.stamp_ns // 500_000_000) % 20 == 0
        else r
        for k, r in enumerate(readings)
    ]


def flipped(readings, rng):
    return [
        BatteryReading(r.stamp_ns, r.voltage, -r.current) if isinstance(r, BatteryReading) else r
        for r in readings
    ]


def shuffled(readings, rng):
    """Each second in an order of its own."""
    seconds = groupby(readings, key=lambda r: r.stamp_ns // NANOSECONDS)
    return [r for _, second in seconds for r in rng.permutation(np.array([*second], object))]


def moved(reading, seconds):
    fields = {name: getattr(reading, name) for name in reading.__slots__}
    return type(reading)(**{**fields, "stamp_ns": reading.stamp_ns + seconds * NANOSECONDS})


FAULTS = (dropouts, jumps, reverse, slip, flipped, shuffled)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
@pytest.mark.slow
def test_faults_of_a_window_end_in_nothing_that_is_not_finite(new_estimator, drive, fault):
    rng = np.random.default_rng(0)
    estimator = new_estimator()
    outputs = [o for r in fault(drive(3, 60.0).readings, rng) for o in estimator.add_reading(r)]
    assert any(isinstance(o, ParameterSet) for o in outputs)
    for output in outputs:
        if isinstance(output, ParameterSet):
            for estimate in output.parameters.values():
                assert estimate.lower <= estimate.value <= estimate.upper
                assert math.isfinite(estimate.value) and 0.0 < estimate.std < math.inf
        elif output.kind is not PowerKind.MEASURED:
            assert abs(output.power) < 1e6 and 0.0 < output.sigma < 1e6


def steady(begin_ns: int, seconds: int, speed: float, power: float):
    """Readings at 1 Hz, with a power that nothing but its noise moves."""
    noise = np.random.default_rng(0).normal(0.0, 0.02 * power, seconds)
    for k in range(seconds):
        stamp_ns = begin_ns + k * NANOSECONDS
        yield BatteryReading(stamp_ns, 350.0, -(power + noise[k]) / 350.0)
        yield SpeedReading(stamp_ns, speed)


@pytest.mark.parametrize(
    ("speed", "power", "seconds", "sigmas"),
    [pytest.param(25.0, 15e3, 5400, 0.8, marks=pytest.mark.slow), (0.0, 1e3, 1200, 0.05)],
)
def test_hours_without_excitation_move_nothing(vehicle, drive, speed, power, seconds, sigmas):
    """Ninety minutes at one speed, which show how even the road is, and twenty standing.

    What is published of eta is by energy, so hours of cruising do move it: the cruise is in it.
    """
    chain = CarChain(vehicle)
    town = drive(3, 240.0).readings
    later = town[-1].stamp_ns + 10 * NANOSECONDS
    for reading in (*town, *steady(later, 180, speed, power)):
        chain.add_reading(reading)
    before, known = chain.car.state.mixture(), chain.parameters()
    for reading in steady(later + 180 * NANOSECONDS, seconds - 180, speed, power):
        chain.add_reading(reading)
    moved_by = chain.car.state.mixture().mean - before.mean
    for state in (State.MASS, State.BACK):
        std = math.sqrt(before.covariance[state, state])
        assert abs(moved_by[state]) <= sigmas * std, state
    after = chain.parameters()
    if speed == 0.0:
        for name in HELD:
            change = getattr(after.identifiable, name) - getattr(known.identifiable, name)
            assert abs(change) <= sigmas * getattr(known.identifiable_std, name), name
    at_first = CarChain(vehicle).parameters().parameters
    for name, estimate in after.parameters.items():
        assert estimate.std <= 3.0 * at_first[name].std, name  # a network may do it too


@pytest.mark.slow
def test_battery_readings_within_the_allowed_lateness_change_nothing(new_estimator, play, drive):
    """What arrives in another order is predicted and learned to the same bits."""
    readings = drive(3, 40.0).readings
    rng = np.random.default_rng(0)
    late = [int(rng.integers(0, 280_000_000)) for _ in readings]
    arrives = [
        (r.stamp_ns + (d if isinstance(r, BatteryReading) else 0), k)
        for k, (r, d) in enumerate(zip(readings, late, strict=True))
    ]
    delayed = [readings[k] for _, k in sorted(arrives)]
    assert delayed != list(readings)

    def predictions(given):
        estimator = new_estimator()
        outputs = [
            o for o in play(estimator, given) if getattr(o, "kind", None) is not PowerKind.MEASURED
        ]
        assert not estimator.status().dropped
        return outputs

    assert predictions(delayed) == predictions(readings)


@pytest.mark.slow
def test_a_heavier_car_has_the_ratio_of_its_mass(vehicle):
    """One drive with a tenth more in the car: m/eta tells the ratio, whatever eta is."""
    first = simulate(DriveKind.URBAN, vehicle, 600.0, 5, car={"mass": 1750.0})
    heavier = simulate(DriveKind.URBAN, vehicle, 600.0, 5, car={"mass": 1925.0})
    found = []
    for driven in (first, heavier):
        chain = CarChain(vehicle)
        for reading in driven.readings:
            chain.add_reading(reading)
        found.append(chain.parameters().identifiable.mass_over_eta)
    true = heavier.truth.identifiable.mass_over_eta / first.truth.identifiable.mass_over_eta
    assert true == pytest.approx(1.1, rel=0.01)
    assert found[1] / found[0] == pytest.approx(true, rel=0.01)
