import pytest

from evpinn_ros.estimation.window import Observation, SlidingWindow, batch
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample


def seen(second, speed=10.0, acceleration=0.0) -> Observation:
    stamp = round(second * NANOSECONDS)
    return Observation(Sample(stamp, speed, acceleration, 0.01, 1.2, 300.0), 1000.0)


def test_a_window_drops_what_becomes_too_old():
    window = SlidingWindow(2.0)
    for k in range(5):
        window.add(seen(k))
    # 2 s are kept, both ends included.
    assert list(window) == [seen(2), seen(3), seen(4)] and len(window) == 3
    window.add(seen(100))
    assert list(window) == [seen(100)]
    window.clear()
    assert len(window) == 0


def test_columns():
    data = batch([seen(1.0, 10.0, 0.5), seen(3.0, 20.0, -0.5)], 3 * NANOSECONDS)
    assert data._asdict() == {
        "age": pytest.approx([2.0, 0.0]),
        "speed": pytest.approx([10.0, 20.0]),
        "acceleration": pytest.approx([0.5, -0.5]),
        "grade": pytest.approx([0.01, 0.01]),
        "air_density": pytest.approx([1.2, 1.2]),
        "known_auxiliary": pytest.approx([300.0, 300.0]),
        "power": pytest.approx([1000.0, 1000.0]),
        "head_wind": pytest.approx([0.0, 0.0]),
    }
    assert all(column.shape == (0,) for column in batch([], 0))
