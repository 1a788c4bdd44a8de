"""Asking over a real python-can bus, with control units made by can-isotp at its other end."""

from contextlib import contextmanager
import itertools
import time

import can
import pytest

from evpinn_ros.can import control_unit
from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.control_unit import ANSWERS
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.poller import Poller
from evpinn_ros.can.profile import load_profile
from evpinn_ros.can.restraint import AWAKE_FRAMES, AWAKE_IDS
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from test.can.conftest import LiveBridge, running
from test.waiting import pause, wait_until

CHANNELS = (f"poller-{number}" for number in itertools.count())
KONA = load_profile("hyundai_kia")
DRIVE, PACK = KONA.requests


@pytest.fixture
def channel():
    return next(CHANNELS)


@pytest.fixture
def unit(channel, simulated_unit, monkeypatch):
    monkeypatch.setitem(control_unit.LINK_OPTIONS, "rx_consecutive_frame_timeout", 60_000)

    def make(address, replies):
        return simulated_unit(can.Bus(channel, interface="virtual"), address, replies)

    return make


class Clock:
    """Seconds that pass when a test says so."""

    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s

    def advance(self, seconds):
        self.now_s += seconds


class Car(LiveBridge):
    """A bridge that polls the control units of a simulated car, by a clock of its own."""

    def __init__(self, channel, profile, units, *, poll=True):
        self.clock, self._units = Clock(), units
        super().__init__("virtual", channel, profile, poll=poll, clock=self.clock)

    def wait_until(self, condition):
        wait_until(condition, meanwhile=self._tick)

    def pass_time(self, seconds):
        end_s = self.clock.now_s + seconds
        self.wait_until(lambda: self.clock.now_s >= end_s)

    def _tick(self):
        """Lets time pass unless an answer is on its way, however long that takes."""
        asked = sum(len(unit.asked) for unit in self._units)
        answers = sum(unit.answers for unit in self._units)
        counters = self.counters
        read = sum(counters.get(kind, 0) for kind in ANSWERS)
        if (counters.get("asked", 0), read) == (asked, answers):
            self.clock.advance(0.2)
            self.bridge.poller.step()
        pause()


@contextmanager
def live(channel, profile, units, *, poll=True):
    with Car(channel, profile, units, poll=poll) as car:
        yield car
    assert not car.reader.status().counters.get("callback_errors")


def pack_answer(current, voltage, auxiliary=140):
    """62 bytes as a Kona sends them: discharge in 0.1 A, 0.1 V, 0.1 V."""
    data = bytearray(59)
    data[4] = 150
    data[10:12] = current.to_bytes(2, "big", signed=True)
    data[12:14] = voltage.to_bytes(2, "big")
    data[29] = auxiliary
    return PACK.echo + bytes(data)


def drive_answer(kmh):
    return DRIVE.echo + bytes(29) + bytes((kmh,)) + bytes(10)


def kona(unit, pack, drive=lambda: [drive_answer(90)]):
    return (unit(PACK.address, {PACK.payload: pack}), unit(DRIVE.address, {DRIVE.payload: drive}))


def test_a_kona_on_the_bus(channel, unit):
    units = kona(unit, lambda: [pack_answer(250, 3600)])
    before = time.time_ns()
    with live(channel, KONA, units) as car:
        car.wait_until(lambda: len(car.of(BatteryReading)) >= 3 and len(car.of(SpeedReading)) >= 3)
        status = car.bridge.poller.status()
    assert status.ok and status.text == "asking"
    battery, speed = car.of(BatteryReading)[-1], car.of(SpeedReading)[-1]
    assert (battery.voltage, battery.current, battery.state_of_charge) == (360.0, -25.0, 0.75)
    assert speed.speed == pytest.approx(25.0)
    stamps = [reading.stamp_ns for reading in car.of(BatteryReading)]
    assert before < stamps[0] and stamps == sorted(stamps)
    most = 1 + car.clock.now_s / PACK.period_s
    assert all(len(unit.asked) <= most for unit in units)
    assert [set(unit.asked) for unit in units] == [{PACK.payload}, {DRIVE.payload}]
    assert car.bridge.status(stamps[-1]).ok


def test_without_leave_nothing_is_ever_sent(channel, unit):
    units = kona(unit, lambda: [pack_answer(0, 4000)])
    with (
        can.Bus(channel, interface="virtual") as listener,
        live(channel, KONA, units, poll=False) as car,
    ):
        for can_id in (0x7EC, 0x7BB, 0x100):  # also a first frame, which asks for flow control
            data = bytes.fromhex("103E620101FFF7E7")
            listener.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
        wait_until(lambda: car.bridge.status(0).unknown_frames == 1)
        car.pass_time(20.0)
        assert listener.recv(0) is None
        status = car.bridge.poller.status()
    assert not any(unit.asked for unit in units)
    assert not status.ok and "hyundai_kia" in status.text and "poll:=true" in status.text


def test_a_silent_unit_does_not_hold_up_another(channel, unit):
    with live(channel, KONA, kona(unit, list)) as car:
        car.wait_until(lambda: len(car.of(SpeedReading)) >= 10)
        assert not car.of(BatteryReading)
        car.wait_until(lambda: car.counters.get("silent"))
        assert car.bridge.poller.status().ok


def test_a_sleeping_car_is_left_alone_until_its_bus_wakes(channel, unit):
    awake = False
    units = kona(
        unit,
        lambda: [pack_answer(250, 3600)] if awake else [],
        lambda: [drive_answer(0)] if awake else [],
    )
    with can.Bus(channel, interface="virtual") as other, live(channel, KONA, units) as car:

        def wake():
            before = car.bridge.status(0).unknown_frames
            for index in range(AWAKE_FRAMES):
                can_id = 0x100 + index % AWAKE_IDS
                other.send(can.Message(arbitration_id=can_id, is_extended_id=False))
            wait_until(lambda: car.bridge.status(0).unknown_frames == before + AWAKE_FRAMES)

        wake()
        car.wait_until(lambda: not car.bridge.poller.status().ok)
        text = car.bridge.poller.status().text
        assert text.startswith("stopped: no answer for 30 s: the car sleeps")
        asked = car.counters["asked"]
        car.pass_time(20.0)
        assert car.counters["asked"] == asked
        awake = True
        wake()
        car.wait_until(lambda: car.of(BatteryReading))
        assert car.bridge.poller.status().ok


@pytest.mark.parametrize(
    ("every_s", "frames"),
    [
        (12.0, [(0x555, b"")]),  # one foreign frame
        (12.0, [(0x7EC, b"\xff" * 8)]),  # noise on the id of the answers
        (12.0, [(0x100 + index % 5, b"") for index in range(50)]),  # a bus that wakes in vain
        (1.0, [(0x100 + index % 5, b"") for index in range(50)]),  # a bus that never sleeps
    ],
)
def test_a_dead_car_is_asked_a_hundred_times_and_no_more(every_s, frames):
    """An hour of foreign frames and no answer: the questions of half a minute, and few retries."""
    now, sent = [0.0], []
    poller = Poller(KONA, lambda frame: sent.append(frame) or True, clock=lambda: now[0])
    next_s = 0.0
    while now[0] < 3600.0:
        now[0] += 0.25
        poller.step()
        if now[0] >= next_s:
            next_s += every_s
            for can_id, data in frames:
                frame = CanFrame(0, can_id, data)
                poller.decode(frame) if poller.is_answer(frame) else poller.note(frame, ())
    assert 50 < len(sent) <= 140
    assert poller.status().text.startswith("stopped: no answer")


@pytest.mark.parametrize("seconds", [0.5, 20.0])
def test_an_id_on_which_somebody_else_sends_is_left_alone(seconds):
    """Before the first question and later: two senders of one id destroy each other's frames."""
    now, sent = [0.0], []
    poller = Poller(KONA, lambda frame: sent.append(frame) or True, clock=lambda: now[0])

    def ask(until_s):
        while now[0] < until_s:
            now[0] += 0.1
            poller.step()

    ask(seconds)
    for frame in sent:  # an adapter may echo what we sent
        poller.note(frame, ())
    ask(seconds + 0.4)
    assert poller.status().ok
    asked = len(sent)
    poller.note(CanFrame(0, 0x7E4, bytes.fromhex("8000000000000000")), ())
    ask(3600.0)
    assert len(sent) == asked
    assert poller.status().text.startswith("stopped: the car or another tester sends on 0x7E4")


def test_a_driver_that_fails_is_no_end():
    def fail(frame):
        raise can.CanOperationError("transmit buffer full")

    clock = Clock()
    poller = Poller(KONA, fail, clock)
    with running(poller):
        wait_until(
            lambda: poller.status().counters.get("send_errors", 0) >= 4,
            meanwhile=lambda: (clock.advance(0.1), pause()),
        )


def test_no_bus_is_waited_for_without_a_stop():
    clock, tries = Clock(), []
    poller = Poller(KONA, tries.append, clock)  # gives None: not sent
    poller.step()  # listens first
    for _ in range(20):
        clock.advance(10.0)
        before = len(tries)
        poller.step()
        assert len(tries) > before
    assert poller.status().ok and not poller.status().counters


def test_a_car_that_is_another_is_not_asked():
    bolt, clock, sent = load_profile("chevrolet_bolt"), Clock(), []

    def send(frame):
        sent.append(frame)
        return True

    bridge = CanBridge(bolt, send, guard=FitGuard(bolt, ()), clock=clock)

    def ask():
        for _ in range(100):
            clock.advance(0.1)
            bridge.poller.step()

    ask()
    assert sent
    for index in range(100):  # more than 600 mph, for a second
        speed = (60_000 + index).to_bytes(2, "big") + bytes(6)
        bridge.decode(CanFrame(index * 10_000_000, 0x3E9, speed))
    assert bridge.refusal is not None
    sent.clear()
    ask()
    assert not sent
    assert bridge.poller.status().text.endswith("contradicts the profile")
