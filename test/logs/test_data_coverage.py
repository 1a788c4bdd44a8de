"""What a recording holds, and which part of it the estimator can use."""

import math
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.bags.types import FRAMES_TOPIC, encode_frame, new_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.can.logs import LogFile
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.logs import data_coverage as module
from evpinn_ros.logs.bag_source import BagSource
from evpinn_ros.logs.contents import contents
from evpinn_ros.logs.data_coverage import ReadingFlow, data_coverage
from evpinn_ros.logs.source import STRAGGLING_NS
from evpinn_ros.replays.run import span
from evpinn_ros.topics import FRAME_TYPE
from evpinn_ros.topics.readings import reading_messages

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
START = 1_700_000_000 * NANOSECONDS


def drive(speed_times, battery_times, speed=10.0):
    stamped = [(t, SpeedReading(START + int(t * 1e9), speed)) for t in speed_times]
    stamped += [(t, BatteryReading(START + int(t * 1e9), 400.0, -20.0)) for t in battery_times]
    return [reading for _, reading in sorted(stamped, key=lambda pair: pair[0])]


def seconds(coverage):
    return [((a - START) / 1e9, (b - START) / 1e9) for a, b in coverage.spans]


def test_spans_need_speed_and_battery_without_long_gaps():
    tenths = [0.1 * i for i in range(1000)]
    speeds = [t for t in tenths if not 20 < t < 25]
    batteries = [t for t in tenths if t < 60]
    coverage = data_coverage([Block.of(drive(speeds, batteries))])
    assert seconds(coverage) == [(0.0, 20.0), pytest.approx((25.0, 59.9))]
    assert coverage.moving == pytest.approx(54.9) and coverage.voltage == 400.0
    assert coverage.flows["speed"].gaps == 1
    assert coverage.flows["speed"].longest_gap == pytest.approx(5.0)
    assert coverage.distance == pytest.approx(949.0)
    assert "55 s can be used" in coverage.verdict


VERDICTS = [
    (drive([], [1, 2]), "no speed"),
    (drive([1, 2], []), "no voltage"),
    ([BatteryReading(START, math.nan, math.nan), SpeedReading(START, 1.0)], "no voltage"),
    (
        drive(range(0, 900, 40), range(900)),
        "speed comes 0.025 times a second with gaps of up to 40 s",
    ),
    (drive(range(5), range(5)), "no 10 s with both"),
    (drive(range(50), range(50), speed=0.0), "never moves"),
    ([], "no speed"),
]


@pytest.mark.parametrize(("readings", "words"), VERDICTS)
def test_why_nothing_can_be_learned(readings, words):
    assert words in data_coverage([Block.of(readings)]).verdict


@given(st.lists(st.integers(0, 10**12)), st.booleans())
def test_a_flow_takes_any_stamps(stamps, rising):
    stamps = sorted(stamps) if rising else stamps
    flow = ReadingFlow.of(np.array(stamps, np.int64))
    newest, breaks, gaps = None, [], [0]
    for stamp in stamps:
        if newest is not None:
            gaps.append(stamp - newest)
            if gaps[-1] > flow.limit_ns or gaps[-1] < -STRAGGLING_NS:
                breaks.append((newest, stamp))
        back = newest is None or stamp < newest - STRAGGLING_NS
        newest = stamp if back else max(newest, stamp)
    assert flow.count == len(stamps) and flow.longest_gap == max(gaps) / 1e9
    if stamps:
        befores, afters = zip(*breaks, strict=True) if breaks else ((), ())
        assert flow.runs == tuple(zip((stamps[0], *afters), (*befores, newest), strict=True))
        assert (flow.first_ns, flow.last_ns) == (min(stamps), max(stamps))


@given(st.lists(st.integers(-3 * 10**9, 4 * 10**9), min_size=1), st.integers(1, 5))
def test_how_many_stamps_are_looked_at_at_once_changes_no_flow(steps, at_once):
    stamps = 10**18 + np.cumsum(steps)
    with pytest.MonkeyPatch.context() as patch:
        whole = ReadingFlow.of(stamps)
        patch.setattr(module, "AT_ONCE", at_once)
        assert ReadingFlow.of(stamps) == whole


def test_voltage_and_current_have_stamps_of_their_own():
    """As a phone polls them: one after the other, each every 1.2 s."""
    steps = [1.2 * i for i in range(200)]
    polled = [(t, SpeedReading(START + int(t * 1e9), 8.0)) for t in steps]
    polled += [
        (t + 0.4, BatteryReading(START + int((t + 0.4) * 1e9), 390.0, math.nan)) for t in steps
    ]
    late = [t + 0.8 for t in steps if not 100 < t < 150]
    polled += [(t, BatteryReading(START + int(t * 1e9), math.nan, -20.0, 0.5)) for t in late]
    readings = [reading for _, reading in sorted(polled, key=lambda pair: pair[0])]
    coverage = data_coverage(Block.of(readings).parts(7))
    assert [flow.count for flow in coverage.flows.values()] == [200, 200, len(late), len(late)]
    assert len(coverage.spans) == 2 and coverage.seconds == pytest.approx(238 - 50, abs=3)
    assert coverage.charge == (0.5, 0.5)


def test_a_signal_every_five_seconds_is_bridged_over_its_own_steps():
    times = [5.0 * i for i in range(100) if i not in (40, 41) and not 60 <= i < 70]
    coverage = data_coverage([Block.of(drive(times, times))])
    assert seconds(coverage) == [(0.0, 295.0), (350.0, 495.0)]
    assert coverage.distance == pytest.approx(10 * (295 + 145))


def test_a_part_of_a_drive():
    whole = [0.5 * i for i in range(100)]

    def of(times, start, duration, size=7):
        """Times that are in the part of a drive."""
        blocks = Block.of(reading for at in times for reading in drive([at], [])).parts(size)
        readings = [r for block in span(blocks, start, duration) for r in block.readings()]
        return [(r.stamp_ns - START) / 1e9 for r in readings]

    assert of(whole, 10.0, 5.0) == [10.0 + 0.5 * i for i in range(10)]
    assert of(whole, 0.0, None) == whole
    assert of(whole, 49.0, None) == whole[98:]
    assert of(whole, 60.0, 1.0) == []
    assert of([*whole[:4], 100.0, 0.6], 0.0, 1.0, size=1) == whole[:2]  # ends behind the part


def test_a_bag_of_nothing_of_ours(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        for i in range(3):
            writer.write_raw("/odd", "std_msgs/msg/String", b"not even CDR", START + i)
    described = contents(tmp_path / "bag")
    assert [(topic.name, topic.flow.count) for topic in described.topics] == [("/odd", 3)]
    assert described.drive is None and "none of the topics" in described.notes[0]


def test_a_log_time_beyond_64_bits_is_a_time(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        for log_time_ns in (START, 2**63, 2**64 - 1):
            writer.write_raw("/odd", "std_msgs/msg/String", b"", log_time_ns)
    (topic,) = contents(tmp_path / "bag").topics
    assert topic.flow.count == 3 and topic.flow.first_ns == START


def test_a_block_of_which_nothing_is_left_is_none(tmp_path):
    """Zeros fill in between readings; from where the clock is set back there are zeros alone."""
    times = [(200 + i / 2, 0.0 if i % 2 else 20.0 + i % 7 / 10) for i in range(60)]
    times += [(50 + i / 2, 0.0) for i in range(5)]
    with BagWriter(tmp_path / "bag") as writer:
        for number, (time, speed) in enumerate(times):
            reading = SpeedReading(START + int(time * 1e9), speed)
            for topic, message in reading_messages(new_message, reading):
                writer.write(topic.under(), message, START + number * 10**8)
    source = BagSource(tmp_path / "bag")
    assert not all(map(len, source.read())) and all(map(len, source.blocks()))
    assert contents(tmp_path / "bag").drive.flows["speed"].count == 30


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="no shared data")
@pytest.mark.nightly
def test_a_can_log_and_a_bag_of_its_frames(tmp_path):
    log = DATA / "can" / "nissan_leaf_62kwh" / "EV-CANeplus2.candump.log"
    with BagWriter(tmp_path / "bag") as writer:
        for frame in LogFile(log).frames():
            if len(frame.data) <= 8:
                data = encode_frame(frame)
                writer.write_raw(f"/ev/{FRAMES_TOPIC}", FRAME_TYPE, data, frame.stamp_ns)
    for path in (log, tmp_path / "bag"):
        described = contents(path)
        leafs = ("nissan_leaf", "nissan_leaf_24_kwh", "nissan_leaf_30_kwh")
        assert (described.profile, described.vehicles) == ("nissan_leaf", leafs)
        assert described.drive.seconds == pytest.approx(19, abs=0.5)
