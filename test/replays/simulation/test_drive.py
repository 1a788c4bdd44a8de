import numpy as np
import pytest

from evpinn_ros.common.units import KMH
from evpinn_ros.replays.simulation.drive import SAMPLE_RATE, DriveKind, drive_speed, hilly_road


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


def test_slope_times_distance_is_the_climb_also_when_standing():
    road = hilly_road(0.02, np.random.default_rng(4))
    start = np.array([0.0, 10.0, 500.0, 2000.0])
    end = np.array([0.0, 40.0, 500.0, 3000.0])
    climb = road.elevation(end) - road.elevation(start)
    np.testing.assert_allclose(road.mean_slope(start, end) * (end - start), climb, atol=1e-12)
    beside = road.mean_slope(start - 1e-3, start + 1e-3)
    np.testing.assert_allclose(road.mean_slope(start, start), beside, atol=1e-7)
