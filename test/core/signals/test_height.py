import numpy as np
import pytest

from evpinn_ros.core.signals.detector import ALTITUDE_STUCK, ONE_ALTITUDE
from evpinn_ros.core.signals.height import LEAP, REACH, AltitudeDetector, HeightProfile


def means(profile: HeightProfile, *places: float):
    """Means around places by all heights that are known."""
    return profile.means_around(np.array(places), profile.seen)


def driven(height, places) -> HeightProfile:
    profile = HeightProfile()
    for place in places:
        profile.add(float(place), float(height(place)))
    return profile


def test_a_height_is_the_average_around_a_place():
    slope = driven(lambda x: 100.0 + 0.05 * x, np.arange(0.0, 1000.0, 5.0))
    assert means(slope, 400.0, 500.0) == pytest.approx([120.0, 125.0])
    rng = np.random.default_rng(0)
    noisy = driven(lambda x: rng.standard_normal(), np.arange(0.0, 1000.0, 10.0))
    # Fifteen readings within 150 m.
    errors = means(noisy, *np.arange(100.0, 900.0, 10.0))
    assert np.std(errors) == pytest.approx(15**-0.5, rel=0.5)


def test_near_the_ends_it_is_of_what_is_known_and_beyond_unknown():
    slope = driven(lambda x: x, np.arange(0.0, 501.0, 5.0))
    ends = means(slope, 0.0, 500.0)
    assert ends == pytest.approx([REACH / 2, 500.0 - REACH / 2])
    for beyond in (500.0 + REACH + 1, -REACH - 1):
        assert means(slope, 250.0, beyond) is None
    assert slope.seen == 500.0


def test_a_standing_car_tells_nothing_new():
    parked = driven(lambda x: 7.0, [0.0])
    for _ in range(100):
        parked.add(0.2, 99.0)
    assert means(parked, 0.0) == [7.0]


def test_the_road_behind_is_forgotten_and_no_average_changes():
    slope = driven(lambda x: 0.1 * x, np.arange(0.0, 20_000.0, 5.0))
    slope.forget_before(18_000.0)
    assert means(slope, 18_000.0, 19_000.0) == pytest.approx([1800.0, 1900.0])
    assert means(slope, 10_000.0) is None


def rises(*altitudes) -> list:
    """Rises between (odometer, altitude), m, and the fault that is seen at the end."""
    detector, seen = AltitudeDetector(), []
    for place in altitudes:
        detector = detector.after(*place)
        seen.append(detector.rise)
    return [*seen, detector.detected]


def test_an_altitude_counts_once_it_has_moved_and_until_it_is_stuck():
    moved, long = [(0.0, 0.0), (50.0, 0.0), (100.0, 2.0)], 100.0 + ONE_ALTITUDE.on
    assert rises(*moved) == [None, None, (50.0, 2.0), None]
    stuck = [*moved, (long, 2.0), (long + 1.0, 2.0)]
    assert rises(*stuck)[3:] == [(100.0, 0.0), None, ALTITUDE_STUCK]
    assert rises(*stuck, (long + 50.0, 5.0))[-2:] == [(long + 1.0, 3.0), None]


def test_a_leap_is_no_rise():
    seen = rises((0.0, 0.0), (10.0, LEAP), (20.0, 1000.0), (30.0, 1001.0))
    assert [rise.height for rise in seen[1:4]] == [LEAP, 0.0, 1.0]
    assert rises((0.0, 0.0), (10.0, 1.0), (210.0, 61.0))[2].height == 60.0  # a street of 30 %
