"""L1 equals L0: the real nodes over real topics give the numbers of the cores."""

from collections import defaultdict
import time

import pytest

from evpinn_ros import topics
from evpinn_ros.core.energy.account import AccountSummary
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.signals.time_jump import DEFAULT_RULE, JumpPolicy, JumpRule
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.energy import EnergyNode
from evpinn_ros.nodes.estimator import EstimatorNode
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.replays.chain import Chain
from evpinn_ros.topics.energies import output_messages
from evpinn_ros.topics.readings import to_reading

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


def chain(rule=DEFAULT_RULE):
    vehicle = load_vehicle("tesla_model_3_lr")
    return Chain(vehicle, EstimatorSettings(), InlineWorker(time.perf_counter), rule)


def parts(message):
    """Names, stamps and numbers of a message."""
    if isinstance(message, str):
        yield message
    elif isinstance(message, int):
        yield str(message)  # exactly
    elif isinstance(message, float):
        yield message
    elif hasattr(message, "get_fields_and_field_types"):
        for name in message.get_fields_and_field_types():
            yield from parts(getattr(message, name))
    else:
        for part in message:
            yield from parts(part)


def messages_of(outputs):
    """The messages that outputs of the chain become, each with its topic."""
    for output in outputs:
        if isinstance(output, AccountSummary):
            continue  # rests on speed as well, which the node hears apart from power
        for topic, message in output_messages(new_message, output):
            yield topic, [message]


OTHERS = (JumpPolicy.RESET, JumpPolicy.HOLD, JumpPolicy.IGNORE)
POLICIES = [JumpPolicy.AUTO, *(pytest.param(other, marks=pytest.mark.nightly) for other in OTHERS)]


@pytest.mark.parametrize("policy", POLICIES)
def test_of_a_bag_in_a_loop_too(bench, urban, policy):
    """It starts over in the middle, and a few readings of the future and the past are in it."""
    once = list(urban(35.0))
    turns = [*once[:100], once[200], *once[100:], *once[:90], once[-1], *once[90:200]]
    core = equal(bench, turns, policy)
    assert core.account.trip.total.distance > 0.0
    newest = max(stamp_of(message) for message in once[:200])
    at_the_end = core.estimator.status().newest_ns > newest + NANOSECONDS
    assert at_the_end == (policy is JumpPolicy.IGNORE)


def stamp_of(sent):
    return to_reading(sent[0].type_name, sent[1]).stamp_ns


def equal(bench, drive, policy):
    """Play messages to nodes and to the cores; gives the cores."""
    estimator = bench.start(EstimatorNode, time_jump_policy=policy.value)
    energy = bench.start(EnergyNode, time_jump_policy=policy.value)
    bench.listen(*HEARD)
    core = chain(JumpRule(policy))
    expected = defaultdict(list)
    for topic, bag_message, ros_message in drive:
        reading = to_reading(topic.type_name, bag_message)
        for name, messages in messages_of(core.add_readings([reading])):
            expected[name] += messages
        bench.drive([(topic, ros_message)])
    bench.settle()
    assert core.estimator.status().accepted > 1
    assert estimator.estimator.status().accepted == core.estimator.status().accepted
    for topic in HEARD:
        heard, told = bench.heard[topic], expected[topic]
        assert len(heard) == len(told) > 0, topic.name
        for message, same in zip(heard, told, strict=True):
            # Two predictions of one reading are counted together by the cores.
            for part, expected_part in zip(parts(message), parts(same), strict=True):
                if isinstance(part, float):
                    expected_part = pytest.approx(expected_part, rel=1e-9, nan_ok=True)
                assert part == expected_part, topic.name
    state, same = (counted.account.state for counted in (energy, core))
    assert state.consumed == pytest.approx(same.consumed, rel=1e-9)
    assert state.rknn.energy == pytest.approx(same.rknn.energy, rel=1e-9)
    return core
