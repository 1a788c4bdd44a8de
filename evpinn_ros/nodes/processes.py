"""Runs the three nodes as processes, plays a CAN log to them, and records their topics."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from evpinn_ros import topics
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.stopping import STOPS
from evpinn_ros.common.writer import Held
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.discovery import set_profile
from evpinn_ros.nodes.recorder import RecorderNode
from evpinn_ros.topics import NAMESPACE
from evpinn_ros.topics.messages import read_named_vector
from evpinn_ros.topics.node_parameters import Value, of_node

START_TIMEOUT = 60.0  # s for the nodes to start on a busy machine
OUTPUT_TIMEOUT = 15.0  # s without any prediction, after which a node counts as dead
STOP_TIMEOUT = 10.0  # s for a node to save and end
SPIN = 0.2  # s
DOMAINS = range(82, 102)
"""ROS domains of these runs; every platform allows them, and tests use lower ones."""


def record_through_nodes(
    parameters: Mapping[str, Value],
    end_ns: int,
    folder: Path,
    progress: Callable[[float], None],
    stopped: Callable[[], bool],
) -> None:
    """Play the CAN log in `parameters` through the executables, and record all their topics.

    `end_ns` is the stamp of the last frame of the log.

    Raises:
        InputError: before that frame, the run was stopped, or a node ended or fell silent.
    """
    own_network()
    # At a signal the caller stops the nodes; rclpy's handler would leave an error.
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    recorder = RecorderNode(folder, namespace=NAMESPACE)
    watch = _Watch(end_ns, progress)
    recorder.listen(topics.POWER_SMOOTHED, watch.take)
    executor = SingleThreadedExecutor()  # EventsExecutor removes the caller's handlers
    executor.add_node(recorder)

    def spin() -> None:
        executor.spin_once(timeout_sec=SPIN)
        if stopped():
            raise InputError("before the end of the drive")  # `Interruption` says "stopped: "

    try:
        with node_process("estimator", parameters), node_process("energy", parameters):
            _await_listeners(recorder, spin)
            with node_process("can_bridge", parameters) as bridge:
                watch.follow(spin, bridge)
    finally:
        recorder.close()
        rclpy.try_shutdown()


def own_network(domains: range = DOMAINS) -> None:
    """Isolate this process and its children, before ROS starts, from all other nodes.

    Raises:
        InputError: other processes have taken all these ROS domains.
    """
    set_profile()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = str(_own_domain(domains)[0])


@cache
def _own_domain(domains: range) -> tuple[int, Held]:
    """The first ROS domain that no other process here has, and its lock until this one ends."""
    taken = set(_domains_in_use())
    for domain in (domain for domain in domains if domain not in taken):
        lock = Path(tempfile.gettempdir(), f"evpinn_ros_domain_{domain}")
        with suppress(InputError, OSError):  # held, or another user's
            return domain, Held(lock, f"ROS domain {domain} is taken")
    raise InputError(f"no ROS domain of {domains.start} to {domains.stop - 1} is free")


def _domains_in_use() -> Iterator[int]:
    """ROS domains of running processes; a node may outlive the process that had the lock."""
    for path in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError, ValueError):  # ended, or another user's
            _, _, text = path.read_bytes().partition(b"ROS_DOMAIN_ID=")
            yield int(text.partition(b"\0")[0])


class _Watch:
    def __init__(self, end_ns: int, progress: Callable[[float], None]) -> None:
        self._end_ns, self._progress = end_ns, progress
        self._first_ns = self._newest_ns = 0

    def take(self, message: object) -> None:
        stamp_ns = read_named_vector(message).stamp_ns
        self._first_ns = self._first_ns or stamp_ns
        self._newest_ns = stamp_ns
        self._progress((stamp_ns - self._first_ns) / NANOSECONDS)

    def follow(self, spin: Callable[[], None], bridge: subprocess.Popen[bytes]) -> None:
        seen, since = self._newest_ns, time.monotonic()
        while self._newest_ns < self._end_ns - NANOSECONDS:
            spin()
            if self._newest_ns != seen:
                seen, since = self._newest_ns, time.monotonic()
            waited = time.monotonic() - since
            if bridge.poll() is not None or waited > (OUTPUT_TIMEOUT if seen else START_TIMEOUT):
                raise InputError("the nodes fell silent before the end of the drive")
        _spin_for(spin, 1.0)


def _await_listeners(recorder: RecorderNode, spin: Callable[[], None]) -> None:
    speed, power = (topic.under() for topic in (topics.SPEED, topics.POWER_SMOOTHED))
    given_up = time.monotonic() + START_TIMEOUT
    # The recorder subscribes to every topic, to power/smoothed twice; both nodes to speed.
    while recorder.count_subscribers(speed) < 3 or recorder.count_subscribers(power) < 3:
        if time.monotonic() > given_up:
            raise InputError(f"the nodes did not come up within {START_TIMEOUT:g} s")
        spin()
    _spin_for(spin, 1.0)


def _spin_for(spin: Callable[[], None], seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        spin()


def node_command(name: str, parameters: Mapping[str, Value]) -> list[str]:
    """The command that starts the executable of one node."""
    command = [sys.executable, "-m", "evpinn_ros.executables", name, "--ros-args"]
    command += ["-r", f"__ns:={NAMESPACE}", "--log-level", "warn"]
    for key, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        command += ["-p", f"{key}:={text}"]
    return command


@contextmanager
def node_process(name: str, parameters: Mapping[str, Value]) -> Iterator[subprocess.Popen[bytes]]:
    """Runs the executable of a node; on exit, interrupts it as a launch file does."""
    command = node_command(name, of_node(name, parameters))
    # Block signals until the process handles them: before that, Python prints a traceback.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    try:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    try:
        yield process
    finally:
        interrupt(process)


def interrupt(process: subprocess.Popen[bytes]) -> None:
    """Interrupt a process as Ctrl-C does; kill it after `STOP_TIMEOUT`."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(STOP_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
