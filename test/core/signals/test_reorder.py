"""Readings in any order in, columns in order of stamps out."""

from collections.abc import Iterable, Sequence
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    BatteryReading,
    GradeReading,
    MotorReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.core.signals.reorder import CELL_NS, ReorderBuffer, in_order
from test.core.signals.conftest import START
from test.core.signals.conftest import stamp_at as at

LATENESS = 0.3  # s
MILLI = NANOSECONDS // 1000


def columns(blocks: Iterable[Block]) -> dict[type[Reading], np.ndarray]:
    """Stamps since the start and values of what is handed on, shape (1 + fields, n)."""
    handed: dict[type[Reading], list[np.ndarray]] = {}
    for block in blocks:
        for kind, rows in block.rows.items():
            handed.setdefault(kind, []).append(np.vstack((rows.stamps - START, rows.values)))
    return {kind: np.concatenate(parts, axis=1) for kind, parts in handed.items()}


def one_by_one(readings: Sequence[Reading]) -> tuple[ReorderBuffer, list[Block]]:
    buffer = ReorderBuffer(LATENESS)
    blocks = [block for reading in readings if (block := buffer.add_reading(reading)[1])]
    return buffer, [*blocks, buffer.flush()]


def in_blocks(readings: Sequence[Reading], size: int) -> tuple[ReorderBuffer, list[Block]]:
    buffer = ReorderBuffer(LATENESS)
    parts = Block.of(readings).parts(size)
    return buffer, [*(buffer.add(part)[0] for part in parts), buffer.flush()]


def reading_of(kind: type[Reading], tick: int, late: int, value: int) -> tuple[int, Reading]:
    """A reading at some ticks of 10 ms, and when it comes, ms."""
    stamp_ns = START + tick * 10 * MILLI
    if kind is BatteryReading:
        parts = ((300.0 + value, math.nan), (math.nan, -value), (350.0, -value), (math.nan,) * 2)
        return tick * 10 + late, BatteryReading(stamp_ns, *parts[value % 4])
    return tick * 10 + late, kind(stamp_ns, float(value))


KINDS = (SpeedReading, BatteryReading, MotorReading, AltitudeReading, TemperatureReading,
         GradeReading)  # fmt: skip
drives = st.lists(
    st.builds(
        reading_of, st.sampled_from(KINDS), st.integers(0, 300), st.integers(0, 3000),
        st.integers(0, 40),
    ),
    max_size=60,
).map(lambda rows: [reading for _, reading in sorted(rows, key=lambda row: row[0])])  # fmt: skip


@given(drives, st.integers(1, 20))
def test_one_by_one_and_in_blocks_are_the_same(readings, size):
    """With late, doubled and impossible readings; nothing is lost that is not counted."""
    (alone, first), (together, second) = one_by_one(readings), in_blocks(readings, size)
    assert alone.dropped == together.dropped
    expected, handed = columns(first), columns(second)
    assert expected.keys() == handed.keys()
    for kind, rows in expected.items():
        np.testing.assert_array_equal(handed[kind], rows)
        assert (np.diff(rows[0]) > 0).all()
    speeds = sum(isinstance(reading, SpeedReading) for reading in readings)
    refused = alone.dropped["speed_late"] + alone.dropped["speed_doubled"]
    assert speeds - refused == expected.get(SpeedReading, np.empty((1, 0))).shape[1]


@given(st.lists(st.integers(0, 289), min_size=60, max_size=60), st.integers(1, 70))
def test_what_comes_within_the_lateness_is_handed_on_in_order(delays, size):
    """Nothing is dropped, whatever came first."""
    readings = [
        (SpeedReading if k % 2 else BatteryReading)(at(k / 10), 10.0 * (1 + k), -5.0)
        if k % 2 == 0
        else SpeedReading(at(k / 10), float(k))
        for k in range(60)
    ]
    order = np.argsort([100 * k + delay for k, delay in enumerate(delays)], kind="stable")
    buffer, blocks = in_blocks([readings[k] for k in order], size)
    expected = columns([in_order(Block.of(readings))])
    assert not buffer.dropped
    for kind, rows in columns(blocks).items():
        np.testing.assert_array_equal(rows, expected[kind])


def test_the_watermark_is_the_newest_speed_less_the_lateness_in_steps():
    buffer, passed = ReorderBuffer(LATENESS), []
    for k in range(40):
        _, block = buffer.add_reading(SpeedReading(at(k / 10), 1.0))
        if block:
            newest_ns = int(block.of_kind(SpeedReading).stamps[-1])
            passed.append((k / 10, buffer.watermark_ns, newest_ns))
    assert 15 < len(passed) <= 4.0 * NANOSECONDS / CELL_NS
    for second, watermark_ns, newest_ns in passed:
        assert at(second - LATENESS - 0.2) < watermark_ns <= at(second - LATENESS + 0.02)
        assert watermark_ns - 100 * MILLI <= newest_ns <= watermark_ns


def test_the_battery_moves_it_where_speed_is_silent():
    buffer = ReorderBuffer(LATENESS)
    readings = [BatteryReading(at(k / 10), 350.0, -1.0) for k in range(40)]
    block, _ = buffer.add(Block.of(readings))
    newest = block.of_kind(BatteryReading).stamps[-1]
    assert at(2.3) <= newest <= at(2.7)  # a second behind it, where it waits for speed
    assert buffer.flush().of_kind(BatteryReading).stamps[-1] == at(3.9)


def test_voltage_and_current_of_one_stamp_are_one_reading_and_the_first_counts():
    readings = [
        BatteryReading(at(0), 350.0, math.nan),
        BatteryReading(at(0), math.nan, -10.0),
        BatteryReading(at(0), 999.0, math.nan),
    ]
    buffer = ReorderBuffer(LATENESS)
    buffer.add(Block.of(readings))
    (reading,) = buffer.flush().readings()
    assert (reading.voltage, reading.current) == (350.0, -10.0)
    assert buffer.dropped == {"battery_doubled": 1}


def test_late_surroundings_count_from_now_on_the_last_of_them():
    buffer = ReorderBuffer(LATENESS)
    buffer.add(Block.of([SpeedReading(at(10.0), 1.0)]))
    late = [TemperatureReading(at(1.0), 5.0), TemperatureReading(at(2.0), 6.0)]
    buffer.add(Block.of(late))
    (speed, temperature) = sorted(buffer.flush().readings(), key=lambda r: -r.stamp_ns)
    assert speed.stamp_ns == at(10.0)
    assert temperature.stamp_ns == at(9.6) + 1 and temperature.celsius == 6.0
    assert not buffer.dropped


@pytest.mark.parametrize(("second", "counts"), [(8.5, True), (7.0, False)])
def test_an_altitude_may_be_two_seconds_late(second, counts):
    buffer = ReorderBuffer(LATENESS)
    buffer.add(Block.of([SpeedReading(at(10.0), 1.0)]))
    buffer.add(Block.of([AltitudeReading(at(second), 100.0)]))
    assert (AltitudeReading in buffer.flush().rows) == counts
    assert buffer.dropped["altitude_late"] == (not counts)


def test_after_a_flush_what_is_older_is_late_and_the_watermark_does_not_fall():
    buffer = ReorderBuffer(LATENESS)
    buffer.add(Block.of([SpeedReading(at(1.03), 1.0)]))
    buffer.flush()
    flushed_ns = buffer.watermark_ns
    for late in (SpeedReading(at(1.0), 2.0), SpeedReading(at(1.1), 2.0)):
        assert buffer.add_reading(late) == (False, None)
        assert not len(buffer.add(Block.of([late]))[0])
    assert buffer.watermark_ns == flushed_ns and buffer.dropped == {"speed_late": 4}


def test_what_waits_is_bounded_while_nothing_moves_the_watermark():
    buffer = ReorderBuffer(LATENESS, most_waiting=100)
    for k in range(1000):
        buffer.add_reading(GradeReading(at(k / 100), 0.01))
    assert len(buffer.flush()) <= 200
