"""Too much at once, too slow a far end, a busy network, and how soon a prediction comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import os
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from benchmarks.faults.chain import ChainFault, NodeChain, Process, running, start_node
from benchmarks.faults.drive import RATE, learned_state, vehicle
from benchmarks.faults.fault import RECOVERY, Fault, FaultEffect
from benchmarks.faults.rig import LONGEST, OUTPUTS, SLACK, Rig
from benchmarks.processes import processor_seconds
from evpinn_ros import topics
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes import factory
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.nodes.processes import node_command
from evpinn_ros.topics.messages import stamp_ns

BACKLOG = 20.0  # s
FULL_RATE = 1000.0  # Hz
LATENCY_RATE, LATENCY_SECONDS, LATENCY_GOAL = 100.0, 30.0, 0.010  # Hz, s, s (p99)
WARM_UP = 5.0  # s

NOISE = """
import rclpy, sys, time
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("noise")
talkers = [node.create_publisher(String, f"noise_{n}", 10) for n in range(20)]
listeners = [node.create_subscription(String, f"noise_{n}", print, 10) for n in range(20)]
while True:
    for talker in talkers:
        talker.publish(String(data=200 * "x"))
    time.sleep(0.02)
"""

SLOW_UPDATES = """
import sys, time
from evpinn_ros import executables
from evpinn_ros.core.estimation import worker
quick = worker.ThreadWorker.submit
worker.ThreadWorker.submit = lambda self, work: quick(self, lambda: (time.sleep(1.6), work())[1])
raise SystemExit(executables.estimator())
"""


def load_faults(chain: NodeChain) -> Iterator[Fault]:
    """The faults of this module; most are done to a chain."""
    none, oldest = "nothing", "the oldest, counted"
    yield Fault("rate_1000", "speed and battery at 1000 Hz", oldest, _FullRate(chain))
    yield Fault("backlog", "20 s delivered at once", oldest, _Backlog(chain))
    yield Fault("slow_consumer", "a subscriber that never reads", none, _Quiet(chain, _slow))
    yield Fault("noise_here", "20 other topics in this domain", none, _Quiet(chain, _noise(0)))
    yield Fault("noise_elsewhere", "the same in another domain", none, _Quiet(chain, _noise(-1)))
    yield Fault("bad_plans", "plans that cannot be driven, 100 Hz", none, _BadPlans(chain))
    yield Fault("qos_of_input", "an input that asks for reliable", "that input", _qos_input)
    yield Fault("qos_of_output", "a subscriber that asks for latched", "his", _QosOutput(chain))
    yield Fault("stall", "the estimator stopped for 8 s", "those 8 s", _Stall(chain))
    yield Fault("overrun", "updates that take 1.6 s", "updates, counted", _overrun)
    yield Fault(
        "latency",
        f"p99 of power/predicted at {LATENCY_RATE:g} Hz, estimator on one core",
        none,
        _latency,
        LATENCY_GOAL,
    )


def _finding(
    rig: Rig, begin: float, end: float, lost: str, kept: bool, *words: str
) -> FaultEffect:
    """Drive until recovered, and look."""
    took = rig.drive_until_recovered(end)
    rig.drive(1.5, until=lambda: rig.status_of("e", words, begin) is not None)
    harm = rig.faulty(begin)
    return FaultEffect(harm or lost, kept and harm is None, took, rig.status_of("e", words, begin))


class _FullRate(ChainFault):
    def inject(self, rig: Rig) -> FaultEffect:
        watch = rig.watch()
        rig.drive(5.0, rate=FULL_RATE)
        end = time.monotonic()
        newest = rig.received[topics.POWER_PREDICTED][-1]
        age = (rig.clock() - stamp_ns(newest[1])) / NANOSECONDS
        rate = watch.sent / (end - watch.begin)
        rig.drive(1.5)
        lost = watch.missing
        text = f"{lost} of {watch.sent} at {rate:.0f} Hz, the newest {age:.2f} s old"
        found = _finding(rig, watch.begin, end, text, age < RECOVERY, "lost")
        return found if lost > SLACK else FaultEffect(text, found.kept, found.seconds, "none lost")


class _Backlog(ChainFault):
    def inject(self, rig: Rig) -> FaultEffect:
        rig.rest(BACKLOG)
        begin, now_ns, number = time.monotonic(), rig.clock(), round(BACKLOG * RATE)
        for back in range(number, 0, -1):
            for each in rig.moment(now_ns - round(back * NANOSECONDS / RATE)):
                rig.send(*each)
        end = time.monotonic()
        rig.drive(2.0)
        received = rig.count(topics.POWER_PREDICTED, begin) - round(2.0 * RATE)
        lost = f"{number - received} of {number} readings"
        return _finding(rig, begin, end, lost, True, "lost")


@dataclass(frozen=True)
class _Quiet(ChainFault):
    """Something that no node may notice."""

    during: Callable[[Rig], Any]

    def inject(self, rig: Rig) -> FaultEffect:
        rig.drive(11.0, until=lambda: False)
        watch = rig.watch()
        with self.during(rig):
            rig.drive(6.0)
        took = rig.drive_until_recovered(time.monotonic())
        wolf = rig.complaints(watch.begin)
        status = "rightly nothing" if not wolf else None
        lost = watch.lost + "; ".join(["", *wolf])
        return FaultEffect(lost, watch.missing <= SLACK, took, status)


@contextmanager
def _slow(_: Rig) -> Iterator[None]:
    """A node of no executor, whose reader stays full."""
    node = rclpy.create_node("slow")
    for topic in OUTPUTS:
        kind = factory.message_class(topic.type_name)
        node.create_subscription(kind, topic.under(), print, 10)
    yield
    node.destroy_node()


def _noise(domains_away: int) -> Callable[[Rig], Any]:
    @contextmanager
    def noise(rig: Rig) -> Iterator[None]:
        domain = int(os.environ["ROS_DOMAIN_ID"]) + domains_away
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        with (rig.folder / "noise.log").open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-c", NOISE], env=environment, stdout=log, stderr=log
            )
        try:
            yield
        finally:
            process.kill()
            process.wait()

    return noise


class _BadPlans(ChainFault):
    def inject(self, rig: Rig) -> FaultEffect:
        plan = new_message(topics.PATH_TYPE)
        begin = time.monotonic()

        def with_plans(messages: Any) -> Any:
            yield from messages
            for _ in range(5):
                yield topics.PLAN, plan

        rig.drive(5.0, with_plans)
        end = time.monotonic()
        rig.drive(1.0)
        asked = rig.count(topics.POWER_SMOOTHED, begin)
        missing = asked - rig.count(topics.ENERGY_STATE, begin)
        lost = f"{max(missing, 0)} of {asked} energies"
        return _finding(rig, begin, end, lost, missing <= SLACK, "plan refused")


def _qos_input(rig: Rig) -> FaultEffect:
    name = f"qos_overrides.{topics.SPEED.under()}.subscription.reliability"
    strict = factory.qos_profile(topics.SPEED.subscriber_qos)
    strict.reliability = ReliabilityPolicy.BEST_EFFORT
    begin = time.monotonic()
    estimator = start_node(rig, "estimator", **{name: "reliable"})
    rig.replace_publisher(topics.SPEED, strict)
    try:
        with running(estimator):
            estimator.await_ready()
            rig.drive(3.0)
            rig.replace_publisher(topics.SPEED, factory.qos_profile(topics.SPEED.publisher_qos))
            took = rig.drive_until_recovered(time.monotonic(), OUTPUTS)
    finally:
        rig.replace_publisher(topics.SPEED, factory.qos_profile(topics.SPEED.publisher_qos))
    harm, status = rig.faulty(begin), rig.status("estimator", "QoS", begin)
    return FaultEffect(harm or "speed, until mended", harm is None, took, status)


class _QosOutput(ChainFault):
    def inject(self, rig: Rig) -> FaultEffect:
        watch = rig.watch()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        topic = topics.POWER_PREDICTED
        kind = factory.message_class(topic.type_name)
        listener = rig.node.create_subscription(kind, topic.under(), lambda _: None, latched)
        rig.drive_until_named("estimator", "QoS", watch.begin)
        rig.node.destroy_subscription(listener)
        lost, kept = "what he asked for; nothing of others", watch.missing <= SLACK
        return _finding(rig, watch.begin, time.monotonic(), lost, kept, "QoS")


class _Stall(ChainFault):
    """As a computer that swaps, or a debugger."""

    def inject(self, rig: Rig) -> FaultEffect:
        process = self.chain.processes["estimator"]
        watch = rig.watch()
        process.signal(signal.SIGSTOP)
        rig.drive(8.0)
        process.signal(signal.SIGCONT)
        end = time.monotonic()
        found = _finding(rig, watch.begin, end, "", True, "lost", "no power/smoothed")
        kept = watch.missing <= 8.0 * RATE + SLACK
        return FaultEffect(watch.lost, kept, found.seconds, found.said)


def _overrun(rig: Rig) -> FaultEffect:
    """Updates made slow by hand: no load of a test machine is sure to."""
    parameters = {"vehicle": vehicle().key, "state_file": str(learned_state(rig.folder))}
    command = node_command("estimator", parameters)
    estimator = Process(rig, "estimator", [sys.executable, "-c", SLOW_UPDATES, *command[3:]])
    with running(estimator):
        estimator.await_ready()
        watch = rig.watch()
        rig.drive_until_named("estimator", "longer than", watch.begin, 4 * LONGEST)
        rig.drive(0.5)
        status = rig.status("estimator", "longer than", watch.begin)
        lost, missing = watch.lost, watch.missing
    return FaultEffect(f"updates; {lost}", missing <= SLACK, 0.0, status)


def _latency(rig: Rig) -> FaultEffect:
    """From publishing a speed to hearing what it predicts, with the 1 Hz learning going on."""
    estimator = start_node(rig, "estimator", state_file=str(learned_state(rig.folder)))
    with running(estimator):
        os.sched_setaffinity(estimator.pid, {min(os.sched_getaffinity(0))})
        estimator.await_ready()
        rig.drive(WARM_UP, rate=LATENCY_RATE)
        begin, sent, cpu = time.time_ns(), rig.sent, processor_seconds(estimator.pid)
        arrived: list[tuple[int, int]] = []
        listener = rig.subscribe(
            topics.POWER_PREDICTED, lambda m: arrived.append((stamp_ns(m), time.time_ns()))
        )
        rig.drive(LATENCY_SECONDS, rate=LATENCY_RATE)
        share = (processor_seconds(estimator.pid) - cpu) / LATENCY_SECONDS
        rig.rest(0.5)
        rig.node.destroy_subscription(listener)
        sent = rig.sent - sent
    delays = [(at - stamp) / NANOSECONDS for stamp, at in arrived if stamp >= begin]
    p50, p99, largest = np.quantile(delays, (0.5, 0.99, 1.0)).tolist()
    times = f"p50 {1e3 * p50:.1f}, p99 {1e3 * p99:.1f}, largest {1e3 * largest:.0f} ms"
    lost = f"{sent - len(delays)} of {sent}; {times}; {share:.0%} of the core"
    return FaultEffect(lost, sent - len(delays) <= SLACK, p99, "nothing to name")
