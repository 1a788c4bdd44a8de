"""The full bus of the benchmark: what is on it, and that its readings can be separated."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from benchmarks.can_traffic import PROFILE, number_after, traffic, voltage
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.profile import load_profile
from evpinn_ros.signals.readings import BatteryReading, SpeedReading

pytestmark = pytest.mark.slow


def test_a_second_is_four_thousand_frames_some_of_them_ours():
    ticks = list(traffic(1.0))
    assert len(ticks) == 1000 and {len(tick) for tick in ticks} == {4}
    ids = Counter(frame.can_id for tick in ticks for frame in tick)
    assert ids[0x132] == 100 and ids[0x257] == 50 and ids[0x292] == 10
    assert len(ids) == 93 and all(frame.can_id < 0x800 for tick in ticks for frame in tick)
    decoder = Decoder(load_profile(PROFILE))
    readings = [reading for tick in ticks for frame in tick for reading in decoder.decode(frame)]
    assert sum(isinstance(each, BatteryReading) for each in readings) == 100
    assert sum(isinstance(each, SpeedReading) for each in readings) == 50
    assert not decoder.dropped


@given(number=st.integers(0, 200_000), missed=st.integers(0, 20_000))
def test_a_frame_is_known_by_its_voltage_also_as_a_float32(number, missed):
    heard = float(np.float32(voltage(number + missed)))
    assert number_after(number, heard) == number + missed
