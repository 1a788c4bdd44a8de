import numpy as np
import pytest

from evpinn_ros.signals.height import (
    KNOWN_WITHIN,
    LEAP,
    LENGTH,
    REACH,
    STUCK_AFTER,
    AltitudeCheck,
    HeightProfile,
)


def driven(height, places) -> HeightProfile:
    found = HeightProfile()
    for place in places:
        found.add(float(place), float(height(place)))
    return found


def test_a_height_is_the_average_around_a_place():
    found = driven(lambda x: 100.0 + 0.05 * x, np.arange(0.0, 1000.0, 5.0))
    assert found.mean_around(500.0) == pytest.approx(125.0)
    rng = np.random.default_rng(0)
    noisy = driven(lambda x: rng.standard_normal(), np.arange(0.0, 1000.0, 10.0))
    errors = [noisy.mean_around(place) for place in np.arange(100.0, 900.0, 10.0)]
    # Fifteen readings within 150 m.
    assert np.std(errors) == pytest.approx(15**-0.5, rel=0.5)


def test_near_the_ends_it_is_of_what_is_known_and_beyond_unknown():
    found = driven(lambda x: x, np.arange(0.0, 501.0, 5.0))
    assert found.mean_around(500.0) == pytest.approx(500.0 - REACH / 2)
    assert found.mean_around(0.0) == pytest.approx(REACH / 2)
    assert found.mean_around(500.0 + REACH + 1) is None and found.mean_around(-REACH - 1) is None
    assert found.known_at(500.0 + KNOWN_WITHIN - 1) and not found.known_at(500.0 + KNOWN_WITHIN)


def test_of_no_height_nothing_is_known():
    found = HeightProfile()
    assert found.mean_around(0.0) is None and not found.known_at(0.0)


def test_a_standing_car_tells_nothing_new():
    found = driven(lambda x: 7.0, [0.0])
    for _ in range(100):
        found.add(0.2, 99.0)
    assert found.mean_around(0.0) == 7.0


def test_only_so_much_road_is_kept():
    found = driven(lambda x: 0.1 * x, np.arange(0.0, 20_000.0, 5.0))
    assert found.mean_around(19_000.0) == pytest.approx(1900.0)
    assert found.mean_around(20_000.0 - 3 * LENGTH) is None


def test_an_altitude_counts_once_it_has_moved_and_until_it_is_stuck():
    check = AltitudeCheck()
    assert check.rise(0.0, 0.0) is None and check.rise(50.0, 0.0) is None
    assert check.rise(100.0, 2.0) == (50.0, 2.0) and check.moves
    assert check.rise(100.0 + STUCK_AFTER, 2.0) == (100.0, 0.0)
    assert check.rise(101.0 + STUCK_AFTER, 2.0) is None and not check.moves
    assert check.rise(150.0 + STUCK_AFTER, 5.0) == (101.0 + STUCK_AFTER, 3.0)


def test_a_leap_is_no_rise():
    check = AltitudeCheck()
    check.rise(0.0, 0.0)
    assert check.rise(10.0, LEAP).height == LEAP
    assert check.rise(20.0, 1000.0).height == 0.0
    assert check.rise(30.0, 1001.0).height == 1.0
