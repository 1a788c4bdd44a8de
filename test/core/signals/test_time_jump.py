"""Time that jumps back, told from wrong stamps: the one rule, without nodes."""

from itertools import accumulate, pairwise
import random

from hypothesis import example, given
from hypothesis import strategies as st
import pytest

from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, SpeedReading, TemperatureReading
from evpinn_ros.core.signals.time_jump import DEFAULT_RULE, Jump, JumpPolicy, JumpRule, StampGuard

S = NANOSECONDS
START = 1_700_000_000 * S


def passed(guard, items, rule=DEFAULT_RULE):
    """What the guard makes of (source, seconds) pairs."""
    admitted = []
    for source, seconds in items:
        stamp = START + round(seconds * S)
        admitted += guard.admit(source, stamp, (source, seconds), rule)
    return admitted


def speeds(*seconds):
    return [("speed", second) for second in seconds]


def test_a_bag_that_starts_over_loses_nothing():
    first = [("battery", 0.0), *speeds(0.1), ("battery", 1.0), *speeds(1.1, 2.1, 200.0, 200.1)]
    admitted = passed(guard := StampGuard("speed"), [*first, *first])
    jump = next(item for item in admitted if isinstance(item, Jump))
    assert jump.seconds == pytest.approx(199.0)
    at = admitted.index(jump)
    assert admitted[:at] == admitted[at + 1 :] == first
    assert guard.jumps == 1 and not guard.dropped


@pytest.mark.parametrize("wrong", [-1e6, 0.0, 150.0, 1e6])
@pytest.mark.parametrize("source", ["speed", "battery"])
def test_one_wrong_stamp_is_no_jump(wrong, source):
    guard = StampGuard("speed")
    good = speeds(200.0, 200.1, 200.2)
    assert passed(guard, [*good[:2], (source, wrong), *good[2:]]) == good
    assert guard.jumps == 0 and guard.dropped == {"stamp_leaps": 1}


def test_two_wrong_stamps_of_another_source_confirm_nothing():
    """They lie weeks apart: no clock went on from one to the other."""
    guard = StampGuard("speed")
    wrong = [("battery", -100.0), ("battery", 2e6)]
    good = [item for s in range(1, 100) for item in (*speeds(float(s)), ("battery", float(s)))]
    assert passed(guard, [*speeds(0.0), *wrong, *good]) == [*speeds(0.0), *good]
    assert guard.jumps == 0 and guard.dropped == {"stamp_leaps": 2}


@pytest.mark.parametrize("begin", [-1000.0, 0.0, 1000.0])
def test_time_goes_on_after_a_jump_from_whichever_stamp(begin):
    guard = StampGuard("speed")
    seconds = [begin - START / S + s for s in range(10)]
    assert passed(guard, [*speeds(0.0, 1.0), *speeds(*seconds)])[3:] == speeds(*seconds)
    assert guard.jumps == 1 and not guard.dropped


NO_JUMP = {
    "late messages": [*speeds(10.0, 9.0, 10.1), ("battery", 8.5), *speeds(8.2)],
    "silence": [*speeds(0.0, 0.1), ("battery", 500.0), *speeds(500.1, 500.2), ("battery", 500.3)],
    "a battery without speed": [*speeds(0.0), *(("battery", 100.0 + s / 10) for s in range(100))],
    "a leader that is 30 s late at the end": [
        item for s in range(600) for item in (("battery", s / 10), *speeds(s / 20))
    ],
}


@pytest.mark.parametrize("items", NO_JUMP.values(), ids=NO_JUMP)
def test_what_is_no_jump_loses_nothing(items):
    guard = StampGuard("speed")
    assert passed(guard, items) == items and guard.jumps == 0


@pytest.mark.parametrize("lag", [0.5, 2.4, 10.0, 14.0])
@pytest.mark.parametrize("late", ["speed", "battery"])
@pytest.mark.parametrize("since", [0.0, 30.0])
def test_a_late_source_loses_nothing(late, lag, since):
    """From the start one reading may stay in doubt: nothing before it says which one is late."""
    both = [(source, s / 10) for s in range(600) for source in ("speed", "battery")]
    items = sorted(both, key=lambda i: i[1] + (lag if i[0] == late and i[1] >= since else 0.0))
    admitted = passed(guard := StampGuard("speed"), items)
    assert guard.jumps == 0
    lost = set(items) - set(admitted)
    assert len(lost) <= (1 if since == 0.0 else 0)
    assert sorted(admitted, key=items.index) == admitted


@given(st.integers(0, 2**32))
def test_messages_that_are_late_at_random_are_no_jump(seed):
    """By up to 3 s, beyond the threshold of 2 s; those that are lost are counted."""
    late = random.Random(seed).uniform
    items = sorted(speeds(*(s / 10 for s in range(300))), key=lambda item: item[1] + late(0, 3))
    admitted = passed(guard := StampGuard("speed"), items)
    assert guard.jumps == 0
    assert len(admitted) + guard.dropped["stamp_leaps"] + guard.held == len(items)


@pytest.mark.parametrize("offset", [-50.0, 50.0, 3600.0])
def test_a_battery_whose_clock_is_wrong_cannot_reset_the_rest(offset):
    guard = StampGuard("speed")
    items = [item for s in range(20) for item in speeds(s) + 5 * [("battery", s + offset)]]
    assert passed(guard, items) == speeds(*range(20))
    assert guard.jumps == 0 and guard.dropped["stamp_leaps"] == 95


def test_the_clock_is_a_second_witness():
    guard = StampGuard("speed")
    guard.clock_went_back()
    passed(guard, speeds(100.0))
    guard.clock_went_back()
    admitted = passed(guard, speeds(1.0))
    assert admitted == [Jump(99.0), ("speed", 1.0)]


def two_publishers(apart, bursts=40, burst=3):
    """Two speeds at 10 Hz whose stamps lie apart, by turns of a few messages."""
    for turn in range(bursts):
        for offset in (0.0, apart):
            yield from speeds(*(1e4 + offset + (turn * burst + i) / 10 for i in range(burst)))


@pytest.mark.parametrize("apart", [3600.0, -3600.0, 20.0])
def test_of_two_publishers_an_hour_apart_one_is_ignored(apart):
    """By turns of three, where two stamps in a row used to be a jump every time."""
    guard, items = StampGuard("speed"), list(two_publishers(apart))
    admitted = passed(guard, items)
    assert guard.jumps <= 1
    assert guard.dropped["stamps_of_a_second_publisher"] == len(items) // 2 - 3
    followed = [item for item in admitted if not isinstance(item, Jump)]
    leaps = [b[1] - a[1] for a, b in pairwise(followed) if abs(b[1] - a[1]) > 1.0]
    assert len(followed) == len(items) // 2 + 3 and len(leaps) == 2  # there, and back for good


@pytest.mark.parametrize("pause", [2.5, 3.0, 3.5, 30.0])
def test_a_clock_that_is_set_to_and_fro_makes_no_second_publisher(pause):
    """It is 3 s ahead for a while and is set right; later the only publisher rests."""
    times = [s / 10 for s in range(600)]
    stamps = [t + 3.0 * (20.0 <= t < 30.0) + pause * (t >= 50.0) for t in times]
    guard = StampGuard("speed")
    admitted = [item for item in passed(guard, speeds(*stamps)) if not isinstance(item, Jump)]
    assert len(admitted) == len(stamps) and not guard.dropped


def test_a_third_publisher_is_ignored_too():
    guard, items = StampGuard("speed"), []
    for turn in range(30):
        for offset in (0.0, -3600.0, -7200.0):
            items += speeds(*(1e4 + offset + (turn * 3 + i) / 10 for i in range(3)))
    passed(guard, items)
    assert guard.jumps <= 3


def test_when_the_publisher_that_is_followed_ends_the_other_takes_over():
    guard = StampGuard("speed")
    both = list(two_publishers(-3600.0, bursts=4))
    alone = speeds(*(1e4 + 1.2 + i / 10 for i in range(100)))
    admitted = passed(guard, [*both, *alone])
    assert admitted[-75:] == alone[-75:]


def test_a_bag_that_is_started_over_again_and_again_is_no_second_publisher():
    guard = StampGuard("speed")
    for lengths in (300, 120, 200, 50):
        items = speeds(*(i / 10 for i in range(lengths)))
        assert [item for item in passed(guard, items) if not isinstance(item, Jump)] == items
    assert guard.jumps == 3 and not guard.dropped


@pytest.mark.parametrize("step", [5.0, 60.0, 300.0])
def test_a_slow_log_is_not_held_back(step):
    """Phones log speed at such steps: but for the first, each comes at once."""
    guard = StampGuard("speed")
    assert passed(guard, [*speeds(0.0, step), ("battery", step)]) == speeds(0.0)
    assert passed(guard, speeds(2 * step)) == [*speeds(step), ("battery", step), *speeds(2 * step)]
    for turn in range(3, 10):
        items = speeds(turn * step)
        assert passed(guard, items) == items
    assert not guard.dropped


def test_to_ignore_is_to_go_on_where_time_was():
    rule, guard = JumpRule(JumpPolicy.IGNORE), StampGuard("speed")
    first, again = speeds(*range(0, 100)), speeds(*range(0, 97))
    assert passed(guard, [*first, *again], rule) == first
    assert guard.dropped == {"stamp_leaps": 97} and guard.jumps == 0
    assert passed(guard, speeds(1e9, 100.0), rule) == speeds(100.0)  # nor is the future believed


def test_what_is_held_has_a_limit():
    guard = StampGuard("speed")
    passed(guard, [*speeds(1000.0), *[("battery", 1.0)] * 1100])
    assert guard.dropped["stamp_held_too_long"] == 100


@given(st.lists(st.tuples(st.sampled_from(["speed", "battery"]), st.floats(0, 1e4)), max_size=60))
def test_nothing_is_doubled_and_all_is_accounted_for(items):
    guard = StampGuard("speed")
    admitted = [item for item in passed(guard, items) if not isinstance(item, Jump)]
    assert len(admitted) + guard.dropped.total() + len(guard._held) == len(items)
    assert all(admitted.count(item) <= items.count(item) for item in admitted)


steps = st.lists(
    st.tuples(
        st.sampled_from([SpeedReading, TemperatureReading]),
        st.sampled_from([0.0, 0.1, 0.1, 0.1, 0.1, -0.1, 1.9, 2.1, -1.9, -2.1, 7.0, 40.0, -40.0]),
    ),
    max_size=60,
)


@example([(SpeedReading, step) for step in (1.9, 1.9, 1.9, 5.0)], 3, DEFAULT_RULE)  # a usual step
@given(steps, st.integers(1, 30), st.sampled_from([DEFAULT_RULE, JumpRule(JumpPolicy.IGNORE)]))
def test_a_block_passes_as_its_readings_do_one_by_one(steps, size, rule):
    """Where nothing speaks against the stamps of a block they are judged at once."""
    ends = accumulate(step for _, step in steps)
    readings = [
        kind(START + round(at * S), 1.0) for (kind, _), at in zip(steps, ends, strict=True)
    ]
    alone, together = StampGuard(SpeedReading), StampGuard(SpeedReading)
    passed_alone = [
        item
        for reading in readings
        for item in alone.admit(type(reading), reading.stamp_ns, reading, rule)
    ]
    passed_together = []
    for part in Block.of(readings).parts(size):
        for item in together.follow(part, rule):
            passed_together += [item] if isinstance(item, Jump) else item.readings()
    assert list(map(repr, passed_together)) == list(map(repr, passed_alone))
    assert (together.dropped, together.jumps, together.held) == (
        alone.dropped,
        alone.jumps,
        alone.held,
    )
