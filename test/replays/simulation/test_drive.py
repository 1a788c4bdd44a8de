import numpy as np
import pytest

from evpinn_ros.common.units import KMH
from evpinn_ros.replays.simulation.drive import SAMPLE_RATE, DriveKind, drive_speed
from evpinn_ros.replays.simulation.road import hilly_road


def speed_of(kind: DriveKind, seed: int, duration_s: float = 600.0) -> np.ndarray:
    return drive_speed(kind, duration_s, np.random.default_rng(seed))


@pytest.mark.parametrize("kind", DriveKind)
@pytest.mark.parametrize("seed", range(5))
def test_people_could_sit_in_the_car(kind, seed):
    speed = speed_of(kind, seed)
    acceleration = np.diff(speed) * SAMPLE_RATE
    jerk = np.diff(acceleration) * SAMPLE_RATE
    assert speed.size == 600 * SAMPLE_RATE + 1
    assert speed[0] == 0 and speed.min() >= 0 and speed.max() < 150 * KMH
    assert acceleration.min() > -6 and acceleration.max() < 3
    assert np.abs(jerk).max() < 25  # the very last of a stop; within traffic it is 2
    assert np.abs(jerk[speed[1:-1] > 3]).max() < 8


def test_the_kinds_differ_as_their_names_say():
    urban, highway = (speed_of(kind, 3) for kind in (DriveKind.URBAN, DriveKind.HIGHWAY))
    mixed = speed_of(DriveKind.MIXED, 3)
    stops = np.sum((urban[1:] == 0) & (urban[:-1] > 0))
    assert stops >= 5 and 0.05 < np.mean(urban == 0) < 0.5 and urban.max() < 70 * KMH
    assert np.mean(highway > 25) > 0.5 and highway.max() > 100 * KMH
    assert 0.1 < np.mean(mixed > 22) < 0.8 and np.mean(mixed < 17) > 0.2


def test_slope_times_distance_is_the_climb_also_when_standing():
    road = hilly_road(0.02, np.random.default_rng(4))
    start = np.array([0.0, 10.0, 500.0, 2000.0])
    end = np.array([0.0, 40.0, 500.0, 3000.0])
    climb = road.elevation(end) - road.elevation(start)
    np.testing.assert_allclose(road.mean_slope(start, end) * (end - start), climb, atol=1e-12)
    beside = road.mean_slope(start - 1e-3, start + 1e-3)
    np.testing.assert_allclose(road.mean_slope(start, start), beside, atol=1e-7)


@pytest.mark.parametrize("rms", [0.005, 0.02])
def test_hills_are_as_steep_as_asked_and_start_at_zero(rms):
    road = hilly_road(rms, np.random.default_rng(5))
    along = np.linspace(0, 200_000, 200_001)
    slope = road.mean_slope(along, along)
    assert np.sqrt(np.mean(slope**2)) == pytest.approx(rms, rel=0.05)
    assert np.abs(slope).max() < 5 * rms and road.elevation(np.zeros(1))[0] == 0
