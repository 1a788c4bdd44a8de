"""Cost of `evpinn mqtt`: of a car at 1 Hz over a real broker, of a day at speed without one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
import os
from pathlib import Path
import shutil
import socket
import subprocess
import sys
from tempfile import TemporaryDirectory
import threading
import time
from typing import Any, NamedTuple

import numpy as np
import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from benchmarks.published_topics import VEHICLE, as_teslamate
from evpinn_ros.bridges.car import BridgedCar
from evpinn_ros.bridges.layouts import read_layout
from evpinn_ros.bridges.snapshot import Snapshots
from evpinn_ros.common.errors import InputError
from evpinn_ros.estimation.estimator import EstimatorSettings
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.vehicle.files import load_vehicle

MOSQUITTO = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin")
BEGUN_S = 300.0  # longest wait until the bridge says that it is online, on a busy machine too
DOCUMENTS = 10  # s of driving from one set of documents to the next


class LiveCost(NamedTuple):
    """One car at 1 Hz: answers, their delay, ms, share of one core, %, and memory, MB."""

    answers: int
    median_ms: float
    p95_ms: float
    most_ms: float
    core_pct: float
    memory_mb: float


class DayCost(NamedTuple):
    """Driving at speed: hours so far, memory, MB, and processor time a second of driving, ms."""

    hours: float
    memory_mb: float
    cpu_ms: float


def live(seconds: int) -> LiveCost:
    """Publish a drive as TeslaMate does, second by second, to a bridge behind a mosquitto.

    Raises:
        InputError: there is no mosquitto.
    """
    if MOSQUITTO is None:
        raise InputError("no mosquitto here: apt-get install mosquitto, or --seconds 0")
    sent: list[float] = []
    came: dict[int, float] = {}
    online = threading.Event()

    def answered(_client: Any, _user: Any, message: Any) -> None:
        if message.topic == "evpinn/status" and message.payload == b"online":
            online.set()
        if message.topic == "evpinn/1/power":
            came.setdefault(len(sent) - 1, time.perf_counter())

    with ExitStack() as stack:
        port = stack.enter_context(_broker())
        command = [sys.executable, "-m", "evpinn_ros", "mqtt", "--vehicle", VEHICLE]
        bridge = stack.enter_context(_running([*command, "--broker", f"127.0.0.1:{port}"]))
        client = paho.Client(CallbackAPIVersion.VERSION2)
        client.on_message = answered
        client.connect("127.0.0.1", port)
        stack.callback(client.loop_stop)
        client.loop_start()
        client.subscribe("evpinn/#", 1)
        if not online.wait(BEGUN_S):
            raise InputError("the bridge did not begin")
        before, begin = _cpu_s(bridge.pid), time.perf_counter()
        for _, messages in as_teslamate(seconds=seconds):
            sent.append(time.perf_counter())
            for topic, text in messages.items():
                client.publish(topic, text, 1, True)
            time.sleep(1.0)
        share = (_cpu_s(bridge.pid) - before) / (time.perf_counter() - begin)
        memory = _memory_mb(bridge.pid)
    delays = np.array([1e3 * (came[i] - sent[i]) for i in sorted(came)[5:]])
    if not len(delays):
        raise InputError("the bridge gave no answer; --seconds of 20 and more")
    median, p95, most = np.quantile(delays, (0.5, 0.95, 1.0)).tolist()
    return LiveCost(len(delays), median, p95, most, 100 * share, memory)


def day(hours: float) -> Iterator[DayCost]:
    """A drive again and again through layout, moments, chain and documents; eight rows."""
    vehicle = load_vehicle(VEHICLE)
    car = BridgedCar("1", vehicle, EstimatorSettings())
    snapshots, layout = (
        Snapshots(vehicle.nominal_voltage, on_change=True),
        read_layout("teslamate"),
    )
    sets = [*as_teslamate()]
    length_ns = sets[-1][0] - sets[0][0] + NANOSECONDS
    turns = max(1, round(hours * 3600 * NANOSECONDS / length_ns))
    begin = time.process_time()
    for turn in range(turns):
        for second, (stamp_ns, messages) in enumerate(sets):
            for topic, text in messages.items():
                parsed = layout.parse(topic, text.encode())
                if parsed is None:
                    continue
                found = snapshots.add(parsed, stamp_ns + turn * length_ns, retained=False)
                car.add_readings(found)
            car.power()
            if second % DOCUMENTS == 0:
                car.documents()
        done = (turn + 1) * len(sets)
        if turn == 0 or (turn + 1) % max(turns // 8, 1) == 0:
            cpu_ms = 1e3 * (time.process_time() - begin) / done
            yield DayCost(done / 3600, _memory_mb(os.getpid()), cpu_ms)


@contextmanager
def _broker() -> Iterator[int]:
    """The port of a mosquitto of its own."""
    with closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = int(free.getsockname()[1])
    with TemporaryDirectory() as folder:
        config = Path(folder) / "mosquitto.conf"
        lines = (f"listener {port} 127.0.0.1", "allow_anonymous true", "set_tcp_nodelay true")
        config.write_text("\n".join(lines) + "\n")
        with _running([str(MOSQUITTO), "-c", str(config)]):
            time.sleep(1.0)
            yield port


@contextmanager
def _running(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    nowhere = subprocess.DEVNULL
    process = subprocess.Popen(command, stdout=nowhere, stderr=nowhere, env=environment)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
