"""Time that jumps back: told from wrong stamps, and handled by policy."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
import pytest
from rosgraph_msgs.msg import Clock

from evpinn_ros.nodes import topics
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.messages import named_vector, speed_message
from evpinn_ros.nodes.time_jump import Jump, StampGuard
from evpinn_ros.signals.readings import NANOSECONDS, SpeedReading

S = NANOSECONDS
START = 1_700_000_000 * S
OUTPUTS = (
    topics.POWER_MEASURED,
    topics.POWER_PREDICTED,
    topics.POWER_SMOOTHED,
    topics.PARAMETERS,
    topics.ENERGY_CONSUMED,
    topics.ENERGY_STATE,
)
POWERS = (topics.POWER_MEASURED, topics.POWER_SMOOTHED)


def passed(guard, items):
    """What the guard makes of (source, seconds) pairs."""
    found = []
    for source, seconds in items:
        stamp = START + round(seconds * S)
        found += guard.push(source, stamp, (source, seconds), 2.0)
    return found


def speeds(*seconds):
    return [("speed", second) for second in seconds]


def test_a_bag_that_starts_over_loses_nothing():
    first = [("battery", 0.0), *speeds(0.1), ("battery", 1.0), *speeds(1.1, 2.1, 200.0, 200.1)]
    found = passed(guard := StampGuard("speed"), [*first, *first])
    jump = next(item for item in found if isinstance(item, Jump))
    assert jump.seconds == pytest.approx(199.0)
    at = found.index(jump)
    assert found[:at] == found[at + 1 :] == first
    assert guard.jumps == 1 and not guard.dropped


@pytest.mark.parametrize("wrong", [-1e6, 0.0, 150.0, 1e6])
@pytest.mark.parametrize("source", ["speed", "battery"])
def test_one_wrong_stamp_is_no_jump(wrong, source):
    guard = StampGuard("speed")
    good = speeds(200.0, 200.1, 200.2)
    assert passed(guard, [*good[:2], (source, wrong), *good[2:]]) == good
    assert guard.jumps == 0 and guard.dropped == {"stamp_leaps": 1}


def test_late_messages_pass():
    items = [*speeds(10.0, 9.0, 10.1), ("battery", 8.5), *speeds(8.2)]
    assert passed(StampGuard("speed"), items) == items


def test_a_silence_is_no_jump_and_loses_nothing():
    items = [*speeds(0.0, 0.1), ("battery", 500.0), *speeds(500.1, 500.2), ("battery", 500.3)]
    guard = StampGuard("speed")
    assert passed(guard, items) == items and guard.jumps == 0


def test_a_battery_goes_on_without_speed():
    items = [*speeds(0.0), *(("battery", 100.0 + s / 10) for s in range(100))]
    assert passed(StampGuard("speed"), items) == items


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
    found = passed(guard, speeds(1.0))
    assert found == [Jump(99.0), ("speed", 1.0)]


def two_publishers(apart, bursts=40, each=3):
    """Two speeds at 10 Hz whose stamps lie apart, by turns of a few messages."""
    for turn in range(bursts):
        for offset in (0.0, apart):
            yield from speeds(*(1e4 + offset + (turn * each + i) / 10 for i in range(each)))


@pytest.mark.parametrize("apart", [3600.0, -3600.0, 20.0])
def test_of_two_publishers_an_hour_apart_one_is_ignored(apart):
    """By turns of three, where two stamps in a row used to be a jump every time."""
    guard, items = StampGuard("speed"), list(two_publishers(apart))
    found = passed(guard, items)
    assert guard.jumps <= 1
    assert guard.dropped["stamps_of_a_second_publisher"] == len(items) // 2 - 3
    followed = [item for item in found if not isinstance(item, Jump)]
    leaps = [b[1] - a[1] for a, b in pairwise(followed) if abs(b[1] - a[1]) > 1.0]
    assert len(followed) == len(items) // 2 + 3 and len(leaps) == 2  # there, and back for good


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
    found = passed(guard, [*both, *alone])
    assert found[-75:] == alone[-75:]


def test_a_bag_that_is_started_over_again_and_again_is_no_second_publisher():
    guard = StampGuard("speed")
    for lengths in (300, 120, 200, 50):
        items = speeds(*(i / 10 for i in range(lengths)))
        assert [item for item in passed(guard, items) if not isinstance(item, Jump)] == items
    assert guard.jumps == 3 and not guard.dropped


def test_what_is_held_has_a_limit():
    guard = StampGuard("speed")
    passed(guard, [*speeds(1000.0), *[("battery", 1.0)] * 5000])
    assert guard.dropped["stamp_held_too_long"] == 4000


@given(st.lists(st.tuples(st.sampled_from(["speed", "battery"]), st.floats(0, 1e4)), max_size=60))
def test_nothing_is_doubled_and_all_is_accounted_for(items):
    guard = StampGuard("speed")
    found = [item for item in passed(guard, items) if not isinstance(item, Jump)]
    assert len(found) + guard.dropped.total() + len(guard._held) == len(items)
    assert all(found.count(item) <= items.count(item) for item in found)


def play(bench, estimator, energy, messages):
    for topic, message in messages:
        bench.deliver(estimator, topic, message)
        bench.pump(lambda: all(energy.received[t] == estimator.published[t] for t in POWERS))
    bench.settle()


def test_a_bag_in_a_loop_gives_the_same_numbers_again(bench, urban):
    estimator = bench.start(EstimatorNode, wait_for_update=True)
    energy = bench.start(EnergyNode)
    bench.listen(*OUTPUTS)
    drive = [(topic, message) for topic, _, message in urban(30.0)]
    play(bench, estimator, energy, drive * 2)
    assert estimator.estimator.status().accepted > 2
    for topic in OUTPUTS:
        heard = bench.heard[topic]
        half = len(heard) // 2
        assert half and heard[:half] == heard[half:], topic.name
    assert bench.diagnosis(estimator)["estimate"][2]["time_jumps"] == "1"
    assert bench.diagnosis(energy)["meter"][2]["time_jumps"] == "1"


def efficiency(node):
    return node.estimator.parameters().parameters["eta"].value


@pytest.mark.parametrize("policy", ["hold", "ignore"])
def test_other_policies_keep_what_was_learned(bench, urban, policy):
    estimator = bench.start(EstimatorNode, wait_for_update=True, time_jump_policy=policy)
    energy = bench.start(EnergyNode, time_jump_policy=policy)
    bench.listen(topics.POWER_SMOOTHED, topics.POWER_MEASURED)
    drive = [(topic, message) for topic, _, message in urban(12.0)]
    play(bench, estimator, energy, drive)
    learned, consumed = efficiency(estimator), energy.meter.state.consumed
    smoothed = len(bench.heard[topics.POWER_SMOOTHED])
    play(bench, estimator, energy, drive[:20])
    again = len(bench.heard[topics.POWER_SMOOTHED]) - smoothed
    assert (again > 0) == (policy == "hold")
    assert abs(energy.meter.state.consumed - consumed) < 0.2 * abs(consumed)
    assert efficiency(estimator) == pytest.approx(learned, rel=0.02)


def test_a_clock_that_goes_back_needs_one_stamp_only(bench):
    node = bench.start(EstimatorNode, use_sim_time=True)
    clock = bench.node.create_publisher(Clock, "/clock", 1)
    bench.pump(lambda: clock.get_subscription_count() > 0)

    def tick(seconds):
        message = Clock()
        message.clock.sec = seconds
        clock.publish(message)
        bench.pump(lambda: node.now_ns() == seconds * S)

    def drive(seconds):
        reading = SpeedReading(round(seconds * S), 10.0)
        bench.deliver(node, topics.SPEED, speed_message(new_message, reading))

    tick(1000)
    drive(1000.0)
    assert node.age(topics.SPEED) == 0.0
    tick(100)
    drive(100.0)
    assert node._guard.jumps == 1
    assert node.estimator.status().newest_ns == 100 * S


def test_energy_starts_again_at_zero(bench):
    node = bench.start(EnergyNode)
    for second in [*range(100, 160), *range(10, 12)]:
        message = named_vector(new_message, second * S, ["power"], [1000.0], [100.0])
        bench.deliver(node, topics.POWER_SMOOTHED, message)
    assert node.meter.state.consumed == pytest.approx(1000.0, rel=1e-3)
