"""L1 equals L0: the real nodes over real topics give the numbers of the cores, bit for bit."""

from collections import defaultdict
import time

import pytest

from evpinn_ros.energy.account import AccountSummary
from evpinn_ros.energy.meter import EnergyState
from evpinn_ros.estimation.estimator import EstimatorSettings
from evpinn_ros.estimation.worker import InlineWorker
from evpinn_ros.nodes import topics
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimate_messages import energy_messages, output_messages
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.reading_messages import to_reading
from evpinn_ros.replay.chain import Chain
from evpinn_ros.vehicle.files import load_vehicle

HEARD = (
    topics.PARAMETERS,
    topics.IDENTIFIABLE,
    topics.BOUNDS,
    *topics.PARAMETER_SCALARS,
    topics.POWER_MEASURED,
    topics.POWER_PREDICTED,
    topics.POWER_SMOOTHED,
    topics.ENERGY_STATE,
    topics.ENERGY_CONSUMED,
)
SECONDS = 150.0  # of each bag; one message in flight takes milliseconds
POWERS = (topics.POWER_MEASURED, topics.POWER_SMOOTHED)


def chain():
    vehicle = load_vehicle("tesla_model_3_lr")
    return Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter))


def messages_of(outputs):
    """The messages that outputs of the chain become, each with its topic."""
    for output in outputs:
        if isinstance(output, AccountSummary):
            continue  # rests on speed as well, which the node hears apart from power
        build = energy_messages if isinstance(output, EnergyState) else output_messages
        for topic, message in build(new_message, output):
            yield topic, [message]


@pytest.mark.parametrize("bag", ["urban", "highway"])
def test_nodes_over_topics_equal_the_cores(bench, bundled, bag):
    estimator = bench.start(EstimatorNode, wait_for_update=True)
    energy = bench.start(EnergyNode)
    bench.listen(*HEARD)
    core = chain()
    expected = defaultdict(list)
    for topic, bag_message, ros_message in bundled(bag, SECONDS):
        for name, messages in messages_of(core.push(to_reading(topic.type_name, bag_message))):
            expected[name] += messages
        bench.deliver(estimator, topic, ros_message)
        bench.pump(lambda: all(energy.received[t] == estimator.published[t] for t in POWERS))
    bench.settle()
    assert core.estimator.status().accepted > 10
    assert estimator.estimator.status().accepted == core.estimator.status().accepted
    for topic in HEARD:
        assert bench.heard[topic] == expected[topic], topic.name
        assert bench.heard[topic], topic.name
    assert repr(energy.meter.state) == repr(core.meter.state)  # NaN is no equal of itself
