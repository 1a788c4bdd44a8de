"""What drives and sensors do to the hybrid mode, from readings to parameters."""

import math

import numpy as np
import pytest

from benchmarks.truth import CarChain
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading

HELD = ("mass_over_eta", "regeneration")


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
    chain.add_readings((*town, *steady(later, 180, speed, power)))
    before, known = chain.car.state.mixture(), chain.parameters()
    chain.add_readings(steady(later + 180 * NANOSECONDS, seconds - 180, speed, power))
    moved_by = chain.car.state.mixture().mean - before.mean
    for state in (State.MASS_OVER_ETA, State.REGEN_DELTA):
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
