"""One input that comes late, as on a machine that swaps: its stamps tell where it belongs."""

from collections import Counter, deque
import time

import pytest

from evpinn_ros import topics
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.replays.chain import Chain
from evpinn_ros.topics.messages import stamp_ns
from evpinn_ros.topics.readings import to_reading
from test.nodes.plans import NOW, VEHICLE, power

SECONDS, ON_TIME = 34.0, 8.0  # s of the drive, and of it without a delay
POWERS = (topics.POWER_MEASURED, topics.POWER_SMOOTHED)
JOINED = 2.0  # s of a late battery that is joined with speed all the same
LAGS = [2.4, *(pytest.param(lag, marks=pytest.mark.nightly) for lag in (0.5, 10.0))]  # s


def arrivals(drive, late, lag):
    """Messages in the order in which they come when one topic is late from `ON_TIME` on."""
    start = stamp_ns(drive[0][1])

    def arrival(sent):
        topic, message = sent
        since = (stamp_ns(message) - start) / NANOSECONDS
        return since + (lag if topic is late and since > ON_TIME else 0.0)

    return sorted(drive, key=arrival)


@pytest.fixture(scope="module")
def drive(urban):
    return [(topic, message) for topic, _, message in urban(SECONDS)]


@pytest.fixture(scope="module")
def in_time(drive):
    """The cores after the drive as it was; that they equal the nodes is tested elsewhere."""
    chain = Chain(VEHICLE, EstimatorSettings(), InlineWorker(time.perf_counter))
    for topic, message in drive:
        deque(chain.add_reading(to_reading(topic.type_name, message)), maxlen=0)
    return chain


@pytest.mark.parametrize("late", [topics.SPEED, topics.BATTERY], ids=lambda topic: topic.name)
@pytest.mark.parametrize("lag", LAGS)
def test_nothing_is_forgotten_when_one_topic_is_late(bench, drive, in_time, late, lag):
    estimator, energy = bench.start(EstimatorNode), bench.start(EnergyNode)
    bench.drive(arrivals(drive, late, lag))
    for node in (estimator, energy):
        assert node.kept.guard.jumps == 0 and not node.kept.guard.dropped
    trip, expected = energy.account.trip, in_time.account.trip
    assert trip.total.distance == pytest.approx(expected.total.distance, rel=1e-9)
    state, expected = energy.account.state, in_time.account.state
    if late is topics.SPEED:  # where the battery is late, what is learned of it is learned later
        assert repr(state) == repr(expected)
        learned = estimator.estimator.parameters(), in_time.estimator.parameters()
        assert repr(learned[0]) == repr(learned[1])
    assert state.consumed == pytest.approx(expected.consumed, rel=1e-6 if lag < JOINED else 0.05)
    assert estimator.estimator.status().accepted > 1


@pytest.mark.parametrize("late", POWERS, ids=lambda topic: topic.name)
@pytest.mark.parametrize("lag", LAGS)
def test_energy_is_counted_where_its_stamps_are(bench, late, lag):
    node = bench.start(EnergyNode)
    sent = [
        (topic, power(NOW + s * NANOSECONDS, 1e4, 10.0)) for s in range(60) for topic in POWERS
    ]
    for topic, message in arrivals(sent, late, lag):
        bench.deliver(node, topic, message)
    assert node.kept.guard.jumps == 0 and node.kept.guard.dropped == Counter()
    assert node.account.state.consumed == pytest.approx(59e4, rel=0.2 if lag > 2 else 0.05)
