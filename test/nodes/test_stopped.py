"""A node that gets no processor for a while misses nothing of the other nodes."""

import signal

import pytest

from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.factory import message_class, new_message
from evpinn_ros.nodes.processes import node_process
from evpinn_ros.topics.messages import named_vector, stamp_ns

START, PERIOD_NS = 1_700_000_000 * NANOSECONDS, NANOSECONDS // 10
STOPPED, AFTER = 40, 10  # powers


@pytest.mark.nightly
def test_four_seconds_without_the_processor_lose_no_power(bench):
    """Powers of four seconds lie there when the node goes on."""
    counted: list[int] = []
    bench.node.create_subscription(
        message_class(topics.ENERGY_STATE.type_name),
        topics.ENERGY_STATE.under(),
        lambda message: counted.append(stamp_ns(message)),
        1000,  # this process may rest as well
    )
    sent = 0

    def send():
        nonlocal sent
        power = named_vector(new_message, START + sent * PERIOD_NS, ["power"], [9e3], [90.0])
        bench.send(topics.POWER_SMOOTHED, power)
        sent += 1

    with node_process("energy", {"vehicle": "tesla_model_3_lr"}) as energy:
        bench.pump(lambda: counted or send())
        energy.send_signal(signal.SIGSTOP)
        for _ in range(STOPPED):
            send()
        energy.send_signal(signal.SIGCONT)
        for _ in range(AFTER):
            send()
        last = START + (sent - 1) * PERIOD_NS
        bench.pump(lambda: counted[-1] == last)
    assert counted == list(range(counted[0], last + 1, PERIOD_NS))
