"""Power that the battery readings measure, as they come."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np

from evpinn_ros.core.signals.arrived_power import NO_BATTERY, ArrivedPowerTrack
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.newest import NO_ARRIVALS
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.core.signals.reorder import ReorderBuffer
from evpinn_ros.core.signals.track import NEVER

MILLISECOND_NS = 10**6
amperes = st.sampled_from([-40.0, 0.0, 25.0, math.nan])
volts = st.sampled_from([350.0, 400.0, math.nan])
readings = st.lists(
    st.one_of(
        st.builds(SpeedReading, st.integers(0, 900), st.just(3.0)),
        st.builds(BatteryReading, st.integers(0, 900), volts, amperes),
    ),
    min_size=1,
    max_size=40,
)


def test_the_stamp_of_the_moment_itself_does_not_count():
    track = ArrivedPowerTrack()
    for stamp_ns, current in ((10, 1.0), (20, 2.0), (30, 3.0)):
        track.add_reading(BatteryReading(stamp_ns, 100.0, -current))
    assert [track.before(ns) for ns in (21, 20, 11)] == [(20, 200.0), (10, 100.0), (10, 100.0)]
    assert track.before(10)[0] == NEVER


@settings(deadline=None)
@given(readings, st.integers(0, 40))
def test_one_by_one_is_as_in_arrays(rows: list, cut: int):
    """Whatever comes late, doubled, without voltage or without current."""
    single, blocks = ArrivedPowerTrack(), ArrivedPowerTrack()
    buffers = ReorderBuffer(0.3), ReorderBuffer(0.3)
    expected, in_blocks = [], []
    rows = [type(r)(r.stamp_ns * MILLISECOND_NS, *_values(r)) for r in rows]
    for reading in rows:
        used, _ = buffers[0].add_reading(reading)
        if used and isinstance(reading, BatteryReading):
            single.add_reading(reading)
        elif used:
            expected.append(single.before(reading.stamp_ns))
    for part in (rows[:cut], rows[cut:]):
        _, arrived = buffers[1].add(Block.of(part))
        told = blocks.add(arrived.get(BatteryReading, NO_BATTERY))
        speeds = arrived.get(SpeedReading, NO_ARRIVALS)
        in_blocks += [*zip(*blocks.before_each(speeds, told), strict=True)]
    np.testing.assert_array_equal(in_blocks, expected)


def _values(reading: SpeedReading | BatteryReading) -> tuple[float, ...]:
    if isinstance(reading, SpeedReading):
        return (reading.speed,)
    return reading.voltage, reading.current
