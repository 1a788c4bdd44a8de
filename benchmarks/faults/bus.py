"""Faults of the CAN bus: an adapter unplugged, another car, a quiet bus, noise, two bridges."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
import math
import os
from pathlib import Path
import random
import time
import tty

from benchmarks.faults.chain import ChainFault, NodeChain, Process, running, start_node
from benchmarks.faults.drive import RATE, readings
from benchmarks.faults.fault import RECOVERY, Fault, FaultEffect
from benchmarks.faults.rig import LONGEST, SLACK, Rig, Sent, nothing
from evpinn_ros import topics
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import load_profile
from evpinn_ros.nodes import factory
from evpinn_ros.topics.node_parameters import Value

PROFILE, OTHER_PROFILE = "tesla_model_3", "tesla_model_3_2019"
INTERFACE, GROUP, FIRST_PORT = "udp_multicast", "239.74.163.5", 20_000
"""The one kind of bus of python-can that crosses processes on any machine."""


def bus_options() -> dict[str, int]:
    """Options of python-can for a bus that stays on this machine, of this process alone."""
    return {"port": FIRST_PORT + os.getpid() % FIRST_PORT, "hop_limit": 0}


def bus_arguments() -> tuple[str, ...]:
    """Arguments of `evpinn run`: a bus of this machine, on which nothing happens."""
    options = " ".join(f"{name}={value}" for name, value in bus_options().items())
    fixed = ("--can-interface", INTERFACE, "--can-channel", GROUP, "--bitrate", "0")
    return (*fixed, "--bus-options", options, "--can-profile", PROFILE)


def bus_faults(chain: NodeChain) -> Iterator[Fault]:
    """The faults of this module; one is done to a chain."""
    yield Fault("unplug", "the adapter is unplugged and plugged in", "meanwhile", _unplug)
    yield Fault("bus_silent", "no frame on the bus", "meanwhile", _silent)
    yield Fault("bus_garbage", "bytes that are no frames", "meanwhile", _garbage)
    yield Fault("bus_frames_noise", "frames of right ids, wrong content", "meanwhile", _noise)
    yield Fault("wrong_profile", "the profile of another car", "everything", _wrong_profile)
    yield Fault("no_adapter", "the adapter is not there at the start", "meanwhile", _no_adapter)
    yield Fault("two_bridges", "two publishers of vehicle/speed", "nothing", _Two(chain))


class _Adapter:
    """A serial CAN adapter (slcan) behind a link, which a person may unplug."""

    def __init__(self, folder: Path) -> None:
        self.link = folder / "adapter"
        self._encoder = Encoder(load_profile(PROFILE))
        self._master: int | None = None
        self._slave = 0

    def plug(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        if self._master is not None:
            os.close(self._slave)
            os.close(self._master)
            self._master = None

    def write(self, data: bytes) -> None:
        """As much as the far end takes."""
        if self._master is not None:
            try:
                os.write(self._master, data)
                os.read(self._master, 1 << 16)  # what the driver says
            except BlockingIOError:
                pass

    def send_moment(self) -> None:
        speed, battery = readings(time.time_ns())
        for frame in (self._encoder.speed(speed), self._encoder.battery(battery)):
            self.write(line(frame))

    def drive(self, rig: Rig, seconds: float, until: str = "") -> float:
        """Send frames, until the bridge says a word; gives the seconds it took."""
        begin = number = time.monotonic()
        while number - begin < seconds and not (until and rig.status("can_bridge", until, begin)):
            self.send_moment()
            number += 1 / RATE
            rig.spin_to(number)
        return time.monotonic() - begin


def line(frame: CanFrame) -> bytes:
    """A frame as slcan writes it."""
    return f"t{frame.can_id:03X}{len(frame.data)}{frame.data.hex().upper()}\r".encode()


class _SpeedArrivals:
    """Speeds that a bridge publishes."""

    def __init__(self, rig: Rig) -> None:
        self.times: list[float] = []
        rig.subscribe(topics.SPEED, lambda _: self.times.append(time.monotonic()))

    def since(self, begin: float) -> float:
        """Seconds until the first after a time."""
        return next((each - begin for each in self.times if each > begin), math.inf)


def _bridge(rig: Rig, adapter: _Adapter, **parameters: Value) -> Process:
    fixed = {"interface": "slcan", "channel": str(adapter.link), "bus_options": "timeout=0.02"}
    return start_node(rig, "can_bridge", **{"can_profile": PROFILE, **fixed, **parameters})


def _finding(
    arrivals: _SpeedArrivals, end: float, status: str | None, lost: str = "what was sent meanwhile"
) -> FaultEffect:
    took = arrivals.since(end)
    return FaultEffect(lost, took < math.inf, took, status)


def _await_receiving(rig: Rig, adapter: _Adapter, arrivals: _SpeedArrivals) -> None:
    begin = time.monotonic()
    while time.monotonic() - begin < LONGEST and not arrivals.since(begin) < math.inf:
        adapter.drive(rig, 1.0)


def _drive_again(rig: Rig, adapter: _Adapter, arrivals: _SpeedArrivals) -> float:
    """Plug the adapter in and drive until that is received; gives when it was plugged in."""
    adapter.plug()
    end = time.monotonic()
    while time.monotonic() - end < 2 * RECOVERY and not arrivals.since(end) < math.inf:
        adapter.drive(rig, 0.2)
    adapter.unplug()
    return end


@contextmanager
def _receiving(rig: Rig) -> Iterator[tuple[_Adapter, _SpeedArrivals]]:
    """A bridge on an adapter whose frames it receives, and what it publishes."""
    adapter, arrivals = _Adapter(rig.folder), _SpeedArrivals(rig)
    adapter.plug()
    bridge = _bridge(rig, adapter)
    with running(bridge):
        bridge.await_ready(change=nothing)
        _await_receiving(rig, adapter, arrivals)
        yield adapter, arrivals


def _unplug(rig: Rig) -> FaultEffect:
    with _receiving(rig) as (adapter, arrivals):
        begin = time.monotonic()
        adapter.unplug()
        rig.rest(3.0)
        status = rig.status("can_bridge", "plugged in", begin)
        end = _drive_again(rig, adapter, arrivals)
    return _finding(arrivals, end, status)


def _no_adapter(rig: Rig) -> FaultEffect:
    adapter, arrivals = _Adapter(rig.folder), _SpeedArrivals(rig)
    adapter.link.unlink(missing_ok=True)
    begin = time.monotonic()
    bridge = _bridge(rig, adapter)
    with running(bridge):
        bridge.await_ready(change=nothing)
        rig.rest(1.0)
        status = rig.status("can_bridge", "plugged in", begin)
        end = _drive_again(rig, adapter, arrivals)
    return _finding(arrivals, end, status)


def _silent(rig: Rig) -> FaultEffect:
    return _while(rig, lambda _: None, "silent")


def _garbage(rig: Rig) -> FaultEffect:
    chance = random.Random(0)
    return _while(
        rig,
        lambda adapter: adapter.write(chance.randbytes(200) + b"\r"),
        "Could not read",
        "no speed",
    )


def _noise(rig: Rig) -> FaultEffect:
    chance, profile = random.Random(0), load_profile(PROFILE)
    ids = [rule.message.frame_id for rule in profile.messages.values()]

    def send(adapter: _Adapter) -> None:
        for each in ids:
            adapter.write(line(CanFrame(0, each, chance.randbytes(8))))

    return _while(rig, send, "no speed", "contradicts", "held back")


def _while(rig: Rig, send: Callable[[_Adapter], None], *words: str) -> FaultEffect:
    """A good bus, then something else on it until it is named, then a good bus."""
    with _receiving(rig) as (adapter, arrivals):
        begin, status = time.monotonic(), None
        while status is None and time.monotonic() - begin < LONGEST:
            send(adapter)
            rig.rest(1 / RATE)
            status = rig.status_of("can_bridge", words, begin)
        end = time.monotonic()
        while time.monotonic() - end < 4 * RECOVERY and not arrivals.since(end) < math.inf:
            adapter.drive(rig, 0.2)
        adapter.unplug()
    return _finding(arrivals, end, status)


def _wrong_profile(rig: Rig) -> FaultEffect:
    """A person who set another car's profile, reads why nothing comes, and sets the right one."""
    adapter, arrivals = _Adapter(rig.folder), _SpeedArrivals(rig)
    adapter.plug()
    begin = time.monotonic()
    wrong = _bridge(rig, adapter, can_profile=OTHER_PROFILE)
    with running(wrong):
        wrong.await_ready(change=nothing)
        adapter.drive(rig, LONGEST, until="contradicts")
        adapter.drive(rig, 1.0)
        status = rig.status("can_bridge", "contradicts", begin)
    let_out = len(arrivals.times)
    right = _bridge(rig, adapter)
    with running(right):
        right.await_ready(change=nothing)
        ready = time.monotonic()
        _await_receiving(rig, adapter, arrivals)
        adapter.unplug()
    finding = _finding(arrivals, ready, status, f"everything; {let_out} wrong readings let out")
    return finding if not let_out else replace(finding, kept=False)


class _Two(ChainFault):
    """A second driver of the same topic, as a bag played beside the car."""

    def inject(self, rig: Rig) -> FaultEffect:
        watch = rig.watch()
        second = factory.advertise(rig.node, topics.SPEED)

        def doubled(messages: Iterable[Sent]) -> Iterator[Sent]:
            for topic, message in messages:
                if topic is topics.SPEED:
                    second.publish(message)
                yield topic, message

        word = "2 publishers"
        rig.drive(LONGEST, doubled, until=lambda: bool(rig.status("estimator", word, watch.begin)))
        rig.node.destroy_publisher(second)
        took = rig.drive_until_recovered(time.monotonic(), most=RECOVERY)
        kept = watch.missing <= SLACK and rig.faulty(watch.begin) is None
        return FaultEffect(watch.lost, kept, took, rig.status("estimator", word, watch.begin))
