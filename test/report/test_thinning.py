"""Thinning keeps peaks and gaps; packing keeps values to half a level."""

import base64

from hypothesis import given
from hypothesis import strategies as st
import numpy as np

from evpinn_ros.report.thinning import LEVELS, NO_VALUE, Grid, packed, thinned


def unpacked(series: dict) -> np.ndarray:
    levels = np.frombuffer(base64.b64decode(series["levels"]), dtype="<i2").astype(float)
    values = series["low"] + (levels + LEVELS // 2) * series["step"]
    return np.where(levels == NO_VALUE, np.nan, values)


@given(
    st.lists(
        st.tuples(st.floats(0.0, 100.0), st.floats(-1e6, 1e6)),
        min_size=1,
        max_size=80,
        unique_by=lambda row: row[0],
    ),
    st.integers(1, 30),
)
def test_peaks_of_every_bucket_stay(rows, buckets):
    time, values = np.array(rows).T
    grid = Grid(100.0 / buckets, buckets)
    extremes = thinned(time, values, grid).reshape(buckets, 2)
    bucket = np.minimum(np.floor(time / grid.width).astype(int), buckets - 1)
    for index in np.unique(bucket):
        inside = values[bucket == index]
        assert (extremes[index].min(), extremes[index].max()) == (inside.min(), inside.max())


def test_a_gap_stays_and_a_missing_reading_is_bridged():
    time = np.array([0.5, 1.5, 3.5, 20.5])
    extremes = thinned(time, np.array([0.0, 1.0, 3.0, 20.0]), Grid(1.0, 21)).reshape(21, 2)
    assert extremes[2].tolist() == [2.0, 2.0]
    assert np.isnan(extremes[4:20]).all() and extremes[20, 0] == 20.0


def test_what_is_not_finite_or_not_of_the_drive_is_left_out():
    time = np.array([-5.0, 0.5, 0.6, 0.7, 99.0])
    values = np.array([9.0, np.nan, 1.0, np.inf, 9.0])
    assert thinned(time, values, Grid(1.0, 1)).tolist() == [1.0, 1.0]
    assert np.isnan(thinned(np.empty(0), np.empty(0), Grid(1.0, 3))).all()


@given(st.lists(st.floats(allow_nan=True, allow_infinity=False), max_size=50))
def test_packing_is_within_half_a_level(values):
    values = np.clip(np.array(values, float), -1e12, 1e12)
    packing = packed(values)
    after = unpacked(packing)
    assert np.array_equal(np.isnan(after), np.isnan(values))
    known = ~np.isnan(values)
    rounding = 1e-9 * np.abs(values[known]).max(initial=0.0)
    assert (np.abs(after - values)[known] <= packing["step"] * 0.5001 + rounding).all()
