from itertools import pairwise
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.energy.trip import BUCKETS, WINDOWS, DistanceWindow, Stretch, TripLog

SECOND = 1_000_000_000
stretches = st.lists(
    st.builds(Stretch, st.floats(0.0, 300.0), st.floats(-1e5, 3e5)), min_size=1, max_size=300
)


def update(log, *row):
    """Give a log one stamp, speed and energy."""
    log.extend(*(np.array([value]) for value in row))


def drive(to, seconds, *, speed=20.0, cost=500.0, start=0.0, silent=range(0)):
    """10 Hz at constant speed, m/s, and cost, J/m; no speed in the seconds of `silent`."""
    for tick in range(round(seconds * 10) + 1):
        t = start + tick / 10
        if not silent.start < t < silent.stop:
            update(to, round(t * SECOND), speed, cost * speed * t)
    return to


@given(stretches, st.sampled_from(WINDOWS))
def test_a_window_holds_exactly_the_end_of_what_was_driven(driven, length):
    window = DistanceWindow(length)
    for step in driven:
        window.extend(*(np.array([part]) for part in step))
    total = window.total
    assert len(window.whole) <= BUCKETS
    longest = max(step.distance for step in driven)
    distance = math.fsum(step.distance for step in driven)
    assert total.distance <= length * (1 + 1 / BUCKETS) + 2 * longest
    assert total.distance >= min(distance, length) * (1 - 1e-12)
    # What it spans are the last stretches, whole.
    ends = [driven[begin:] for begin in range(len(driven))]
    sums = [tuple(math.fsum(column) for column in zip(*end, strict=True)) for end in ends]
    assert any(total == pytest.approx(end, rel=1e-9, abs=1e-6) for end in sums)


@given(st.lists(st.floats(1.0, 40.0), min_size=30, max_size=400), st.floats(-3e3, 3e3))
def test_windows_and_total_agree_while_nothing_is_forgotten(speeds, cost):
    log, energy, distance = TripLog(), 0.0, 0.0
    update(log, 0, speeds[0], 0.0)
    for second, (before, speed) in enumerate(pairwise(speeds), start=1):
        distance += (before + speed) / 2
        energy += cost * (before + speed) / 2
        update(log, second * SECOND, speed, energy)
    assert log.total == pytest.approx((distance, energy), rel=1e-9, abs=1e-6)
    assert log.windows[-1].total == pytest.approx(log.total, rel=1e-9, abs=1e-6)


def test_in_reverse_a_car_covers_distance_too():
    assert drive(TripLog(), 10.0, speed=-2.0, cost=-500.0).total.distance == pytest.approx(20.0)


def test_a_reset_of_the_trip_leaves_the_last_kilometres():
    log = drive(TripLog(), 100.0)
    log.reset_trip()
    assert log.total == (0.0, 0.0)
    assert log.windows[0].known
