"""Estimators that start on a busy machine get data: one once had none until it was restarted."""

from contextlib import ExitStack
import os
import signal
import sys

import pytest

from evpinn_ros import topics
from evpinn_ros.core.estimation.estimator import Activity
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.nodes.factory import advertise, message_class, new_message
from evpinn_ros.topics.readings import READING_TOPICS, reading_message
from test.nodes.processes import node, started, stopped

AT_ONCE = 5
BUSY = (sys.executable, "-c", "while True: pass")


@pytest.mark.nightly
@pytest.mark.parametrize(("starts", "end"), [(200, signal.SIGINT), (100, signal.SIGKILL)])
@pytest.mark.timeout(3600)
def test_each_start_under_load_gets_data(bench, starts, end):
    """Those before are stopped in order, or killed: then the network holds them for 20 s more."""
    car, working = bench.node, set()
    publishers = {
        kind: advertise(car, READING_TOPICS[kind]) for kind in (SpeedReading, BatteryReading)
    }

    def send():
        stamp = car.get_clock().now().nanoseconds
        for reading in (SpeedReading(stamp, 15.0), BatteryReading(stamp, 350.0, -30.0, 0.8)):
            publishers[type(reading)].publish(reading_message(new_message, reading))

    def take(report):
        for status in report.status:
            values = {pair.key: pair.value for pair in status.values}
            if values.get("activity", Activity.WAITING.value) != Activity.WAITING.value:
                working.add(status.name.partition(":")[0])

    car.create_subscription(message_class(topics.DIAGNOSTICS.type_name), "/diagnostics", take, 100)
    car.create_timer(0.1, send)
    with ExitStack() as load:
        for _ in range(os.cpu_count() or 1):
            load.enter_context(started(*BUSY))
        for first in range(0, starts, AT_ONCE):
            names = [f"start{number}" for number in range(first, first + AT_ONCE)]
            with ExitStack() as wave:
                processes = [
                    wave.enter_context(started(*node("estimator"), "-r", f"__node:={name}"))
                    for name in names
                ]
                bench.pump(lambda names=names: working >= {f"/ev/{name}" for name in names})
                for process in processes if end is signal.SIGINT else ():
                    stopped(process)
