from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.estimation.window import (
    ACCELERATION_EDGES,
    BUCKET_SIZE,
    SPEED_EDGES,
    Observation,
    SampleStore,
    SlidingWindow,
    batch,
)
from evpinn_ros.signals.kinematics import COURSE
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample


def seen(second, speed=10.0, acceleration=0.0) -> Observation:
    stamp = round(second * NANOSECONDS)
    return Observation(Sample(stamp, speed, acceleration, 0.01, 1.2, 300.0), 1000.0, 0.002)


def test_a_window_gives_what_becomes_too_old():
    window = SlidingWindow(2.0)
    left = [window.add(seen(k)) for k in range(5)]
    # 2 s are kept, both ends included: at 3 s the one of 0 s leaves.
    assert left == [[], [], [], [seen(0)], [seen(1)]]
    assert list(window) == [seen(2), seen(3), seen(4)] and len(window) == 3
    assert window.add(seen(100)) == [seen(2), seen(3), seen(4)]
    window.clear()
    assert len(window) == 0 and window.add(seen(0)) == []


def test_a_store_keeps_the_newest_of_each_bucket_half_a_second_apart():
    store = SampleStore()
    for tick in range(200):
        store.add(seen(tick / 10))
    kept = [observation.sample.stamp_ns / NANOSECONDS for observation in store]
    assert len(kept) == BUCKET_SIZE and kept[-1] == 19.5
    assert np.diff(kept) == pytest.approx([0.5] * (BUCKET_SIZE - 1))


def test_town_is_not_forgotten_on_the_motorway():
    store = SampleStore()
    for second in range(60):
        store.add(seen(second, speed=8.0))
    for second in range(60, 4000):
        store.add(seen(second, speed=33.0))
    speeds = [observation.sample.speed for observation in store]
    assert speeds.count(8.0) == speeds.count(33.0) == BUCKET_SIZE


def test_a_standing_car_is_not_stored():
    store = SampleStore()
    store.add(seen(0, speed=0.49))
    store.add(seen(0, speed=-3.0))
    assert list(store) == [] and store.coverage() == 0.0


def test_samples_after_time_went_back_are_stored():
    store = SampleStore()
    store.add(seen(1000))
    store.add(seen(0.0))
    assert len(list(store)) == 2


@given(
    st.lists(
        st.tuples(
            st.one_of(st.floats(-20.0, 60.0), st.sampled_from(SPEED_EDGES)),
            st.one_of(st.floats(-9.0, 9.0), st.sampled_from(ACCELERATION_EDGES)),
        ),
        max_size=300,
    )
)
def test_a_store_is_bounded_and_coverage_is_a_share(rows):
    store = SampleStore()
    for second, (speed, acceleration) in enumerate(rows):
        store.add(seen(second, speed, acceleration))
    assert len(list(store)) <= min(len(rows), 10 * 7 * BUCKET_SIZE)
    assert 0.0 <= store.coverage() <= 1.0
    assert (store.coverage() > 0) == any(speed >= SPEED_EDGES[0] for speed, _ in rows)


def test_full_coverage_is_one():
    store = SampleStore()
    for i, speed in enumerate(SPEED_EDGES):
        for j, acceleration in enumerate((-9.0, *ACCELERATION_EDGES)):
            store.add(seen(10 * i + j, speed + 0.1, acceleration + 0.1))
    assert store.coverage() == 1.0


def test_columns():
    course = tuple(0.1 * k for k in range(COURSE))
    one, other = seen(1.0, 10.0, 0.5), seen(3.0, 20.0, -0.5)
    data = batch(
        [one, other._replace(sample=replace(other.sample, course=course))], 3 * NANOSECONDS
    )
    assert data.course.tolist() == [[0.0] * COURSE, list(course)]
    assert [column.tolist() for column in data[:-1]] == [
        [2.0, 0.0],  # age
        [10.0, 20.0],
        [0.5, -0.5],
        [0.01, 0.01],
        [1.2, 1.2],
        [300.0, 300.0],
        [1000.0, 1000.0],
        [0.002, 0.002],
        [0.0, 0.0],  # head wind
    ]
    nothing = batch([], 0)
    assert all(column.shape == (0,) for column in nothing[:-1])
    assert nothing.course.shape == (0, COURSE)
