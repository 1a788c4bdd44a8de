"""The bus reader against real drivers: UDP multicast from another process, a serial adapter."""

from contextlib import contextmanager
import errno
import math
import os
from pathlib import Path
import socket
import struct
import tty

import can
import pytest

from evpinn_ros.can import bus as bus_module
from evpinn_ros.can.bus import BusCondition, BusReader
from evpinn_ros.common.errors import InputError
from test.can.conftest import running
from test.waiting import pause, wait_until

GROUP = "239.74.163.77"
NOW = 1_700_000_000_000_000_000


@contextmanager
def reading(reader):
    with running(reader):
        yield
    assert reader.status().condition is BusCondition.CLOSED


class Adapter:
    """A serial CAN adapter: the far end of a pseudo terminal, behind a name that stays."""

    def __init__(self, link):
        self.link = link
        self.plug()

    def plug(self):
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self.slave))

    def unplug(self):
        os.close(self.slave)
        os.close(self.master)

    def send(self, line=b"t13260098946700000000\r"):
        os.write(self.master, line)


def serial_reader(link, callback, clock=lambda: NOW):
    return BusReader(
        "slcan", str(link), callback, clock, bitrate=500_000, sleep_after_open=0.0, timeout=0.02
    )


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(bus_module, "FIRST_BACKOFF_S", 0.05)
    monkeypatch.setattr(bus_module, "SILENT_AFTER_S", 0.2)


def test_adapter_unplugged_in_the_stream_and_plugged_again(tmp_path, quick):
    adapter = Adapter(tmp_path / "adapter")
    received = []
    reader = serial_reader(adapter.link, received.append)

    def stream(count):
        wanted = len(received) + count
        for _ in range(count):
            adapter.send(b"t1326989467000000\r")
        wait_until(lambda: len(received) == wanted)

    with reading(reader):
        wait_until(lambda: reader.status().counters.get("opened") == 1)
        stream(100)
        adapter.unplug()
        wait_until(lambda: reader.status().condition is BusCondition.LOST)
        assert "adapter" in reader.status().problem and "\n" not in reader.status().problem

        adapter.plug()
        wait_until(lambda: reader.status().counters.get("opened") == 2)
        stream(100)
        wait_until(lambda: reader.status().condition is BusCondition.SILENT)
    counters = reader.status().counters
    assert counters["opened"] == 2 and counters["lost"] == 1
    assert counters["frames"] == len(received) == 200
    assert {frame.data for frame in received} == {bytes.fromhex("989467000000")}
    adapter.unplug()


def test_opening_again_and_again_keeps_no_file_open(tmp_path, quick):
    adapter = Adapter(tmp_path / "adapter")
    before = len(list(Path("/proc/self/fd").iterdir()))
    for _ in range(5):
        reader = serial_reader(adapter.link, print)
        reader.open()
        reader.stop()
        reader.run()  # closes
    assert len(list(Path("/proc/self/fd").iterdir())) == before
    adapter.unplug()


def test_a_socket_is_given_a_deep_queue():
    reader = BusReader("udp_multicast", GROUP, print, lambda: NOW, port=20_001, hop_limit=0)
    try:
        reader.open()
    except InputError as error:
        pytest.skip(f"no multicast here: {error}")
    allowed = int(Path("/proc/sys/net/core/rmem_max").read_text())
    with socket.socket(fileno=os.dup(reader._bus.fileno())) as own:
        deep = own.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    reader.stop()
    reader.run()
    assert deep >= min(allowed, bus_module.SOCKET_QUEUE)


def test_garbled_serial_line_is_no_loss(tmp_path, quick):
    adapter = Adapter(tmp_path / "adapter")
    received = []
    reader = serial_reader(adapter.link, received.append)
    with reading(reader):
        wait_until(lambda: reader.status().counters.get("opened") == 1)
        adapter.send(b"tXYZ\r")
        adapter.send(b"t1326989467000000\r")
        wait_until(lambda: len(received) == 1)
    assert reader.status().counters == {"opened": 1, "garbled": 1, "frames": 1}
    adapter.unplug()


class FakeBus:
    """Answers `recv` from a list; an exception in it is raised, an empty list is silence."""

    state = can.BusState.ACTIVE

    def fileno(self):
        raise NotImplementedError

    def __init__(self, script):
        self.script = list(script)

    def recv(self, timeout):
        if not self.script:
            pause()
            return None
        answer = self.script.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def shutdown(self):
        raise can.CanOperationError("gone")


@pytest.fixture
def scripted(monkeypatch, quick):
    def make(*scripts):
        buses = [FakeBus(script) for script in scripts]
        waiting = iter(buses)
        monkeypatch.setattr(can, "Bus", lambda **_: next(waiting))
        return buses

    return make


def message(timestamp, **kwargs):
    return can.Message(timestamp=timestamp, arbitration_id=1, is_extended_id=False, **kwargs)


def stamps(interface, clock):
    """What a reader stamps the frames with, one for each time of the clock."""
    clock, received = list(clock), []
    times = iter(clock)
    reader = BusReader(interface, "x", received.append, lambda: next(times))
    with reading(reader):
        wait_until(lambda: len(received) == len(clock))
    return [frame.stamp_ns for frame in received]


def test_stamps_of_an_adapter_with_its_own_zero(scripted):
    scripted(
        [message(5.0), message(5.25), can.CanOperationError("unplugged", errno.ENODEV)],
        [message(0.5), message(0.75)],
    )
    clock = [NOW, NOW + 250_000_000, NOW + 10**10, NOW + 10**10 + 250_000_000]
    assert stamps("virtual", clock) == clock


def test_stamps_of_the_epoch_are_used(scripted):
    scripted([message(1549819403.028902)])
    assert stamps("virtual", [NOW]) == [1549819403028902000]


def test_failing_callback_is_no_failing_bus(scripted):
    scripted([message(0.0), message(0.1)])

    def fail(frame):
        raise ZeroDivisionError("mine")

    reader = BusReader("virtual", "x", fail, lambda: NOW)
    with reading(reader):
        wait_until(lambda: reader.status().counters.get("callback_errors") == 2)
        assert reader.status().condition is not BusCondition.LOST
    counters = reader.status().counters
    assert counters == {"opened": 1, "frames": 2, "callback_errors": 2, "close_errors": 1}
    assert "ZeroDivisionError('mine')" in reader.status().problem


def test_error_frames_alone_are_told_until_a_frame_comes(monkeypatch):
    monkeypatch.setattr(bus_module, "SILENT_AFTER_S", math.inf)
    reader = BusReader("virtual", "errors", print, lambda: NOW)
    reader.open()
    with can.Bus("errors", interface="virtual") as bus, reading(reader):
        for _ in range(bus_module.MANY_ERRORS):
            bus.send(can.Message(is_error_frame=True))
        wait_until(lambda: reader.status().condition is BusCondition.ERRORS)
        bus.send(can.Message())
        wait_until(lambda: reader.status().condition is BusCondition.OPEN)
    assert reader.status().counters["error_frames"] == bus_module.MANY_ERRORS


def test_bus_off_is_told_until_a_frame_comes(scripted):
    off = message(0.0, is_error_frame=True)
    off.arbitration_id = bus_module.SOCKETCAN_BUS_OFF
    _, reopened = scripted([message(0.0), off], [])
    reader = BusReader("socketcan", "can0", print, lambda: NOW)
    with reading(reader):
        wait_until(lambda: not reopened.script and reader.status().counters.get("opened") == 2)
        wait_until(lambda: reader.status().condition is BusCondition.OFF)
        assert "type can restart-ms 100" in reader.status().problem
        reopened.script.append(message(0.1))
        wait_until(lambda: reader.status().counters["frames"] == 2)
        wait_until(lambda: reader.status().condition is BusCondition.SILENT)
    assert reader.status().counters["bus_off"] == reader.status().counters["lost"] == 1


def test_driver_that_tells_bus_off_by_its_state(scripted, monkeypatch):
    monkeypatch.setattr(FakeBus, "state", can.BusState.ERROR)
    scripted([None], [None])
    reader = BusReader("ixxat", 0, print, lambda: NOW)
    with reading(reader):
        wait_until(lambda: reader.status().counters.get("bus_off") == 2)
        assert reader.status().condition is BusCondition.OFF
        assert "check bit rate and wiring" in reader.status().problem


def test_driver_that_only_stumbles_is_opened_again(scripted, monkeypatch):
    monkeypatch.setattr(bus_module, "GARBLED_PAUSE_S", 0.001)
    scripted([struct.error("short")] * bus_module.MANY_GARBLED, [message(0.0)])
    received = []
    reader = BusReader("virtual", "x", received.append, lambda: NOW)
    with reading(reader):
        wait_until(lambda: received)
    counters = reader.status().counters
    assert counters["garbled"] == bus_module.MANY_GARBLED and counters["lost"] == 1


def test_backoff_grows_until_a_frame_comes(scripted):
    lost = [can.CanOperationError("flaky")]
    scripted(lost, lost, lost, [message(0.0)])
    waits_s = []
    reader = BusReader("virtual", "x", lambda _: reader.stop(), lambda: NOW, waits_s.append)
    reader.run()
    assert waits_s == [0.05, 0.1, 0.2]
    assert reader.status().counters["lost"] == 3


def test_an_adapter_that_stays_away_is_looked_for_every_two_seconds():
    """Without a wait between two looks an outage would take a whole core."""
    waits_s = []

    def wait(seconds):
        waits_s.append(seconds)
        if len(waits_s) == 6:
            reader.stop()

    reader = BusReader("slcan", "/nowhere/adapter", print, lambda: NOW, wait)
    reader.run()
    assert waits_s == [0.5, 1.0, 2.0, 2.0, 2.0, 2.0]
    assert "opened" not in reader.status().counters


def test_stop_interrupts_the_wait(monkeypatch):
    monkeypatch.setattr(bus_module, "FIRST_BACKOFF_S", 3600.0)
    reader = BusReader("slcan", "/nowhere/adapter", print, lambda: NOW)
    with reading(reader):
        wait_until(lambda: reader.status().condition is BusCondition.LOST)


@pytest.mark.parametrize(
    ("interface", "channel", "options", "remedy"),
    [
        ("slcan", "/nowhere/adapter", {}, "is the adapter plugged in"),
        ("nonsense", "x", {}, "known interfaces are "),
        ("slcan", "", {}, "check channel, bitrate"),
        ("pcan", "PCAN_USBBUS1", {}, "PCAN-Basic installed"),
    ],
)
def test_open_says_what_to_do(interface, channel, options, remedy):
    with pytest.raises(InputError) as error:
        BusReader(interface, channel, print, lambda: NOW, **options).open()
    assert remedy in str(error.value) and "\n" not in str(error.value)
