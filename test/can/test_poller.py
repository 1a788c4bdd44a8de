"""Asking over a real python-can bus, with control units made by can-isotp at its other end."""

from contextlib import contextmanager
import itertools
import time

import can
import pytest

from evpinn_ros.can import poller as poller_module
from evpinn_ros.can import restraint as restraint_module
from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.poller import Poller
from evpinn_ros.can.profile import load_profile
from evpinn_ros.signals.readings import BatteryReading, SpeedReading
from test.can.conftest import LiveBridge, running
from test.waiting import wait_until

CHANNELS = (f"poller-{number}" for number in itertools.count())
KONA = load_profile("hyundai_kia")
DRIVE, PACK = KONA.requests
I3 = load_profile("bmw_i3")


@pytest.fixture
def channel():
    return next(CHANNELS)


@pytest.fixture
def unit(channel, simulated_unit, monkeypatch):
    monkeypatch.setattr(poller_module, "LISTEN_FIRST_S", 0.05)

    def make(address, replies):
        return simulated_unit(can.Bus(channel, interface="virtual"), address, replies)

    return make


@contextmanager
def live(channel, profile, *, poll=True):
    with LiveBridge("virtual", channel, profile, poll=poll) as bridge:
        yield bridge
        begun = time.monotonic()
    assert time.monotonic() - begun < 1.0
    assert not bridge.reader.status().counters.get("callback_errors")


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
    before, begun = time.time_ns(), time.monotonic()
    with live(channel, KONA) as car:
        wait_until(lambda: len(car.of(BatteryReading)) >= 3 and len(car.of(SpeedReading)) >= 3)
        status = car.bridge.poller.status()
    assert status.ok and status.text == "asking"
    battery, speed = car.of(BatteryReading)[-1], car.of(SpeedReading)[-1]
    assert (battery.voltage, battery.current, battery.state_of_charge) == (360.0, -25.0, 0.75)
    assert speed.speed == pytest.approx(25.0)
    stamps = [reading.stamp_ns for reading in car.of(BatteryReading)]
    assert before < stamps[0] and stamps == sorted(stamps)
    most = 1 + (time.monotonic() - begun) / PACK.period_s
    assert all(len(unit.asked) <= most for unit in units)
    assert [set(unit.asked) for unit in units] == [{PACK.payload}, {DRIVE.payload}]
    assert car.bridge.status(stamps[-1]).ok


def test_voltage_and_current_of_two_answers_are_of_one_moment(channel, unit):
    speed, voltage, current = I3.requests
    unit(speed.address, {speed.payload: lambda: [speed.echo + b"\x01\xf4"]})
    unit(
        voltage.address,
        {
            voltage.payload: lambda: [voltage.echo + b"\x8c\xa0"],
            current.payload: lambda: [current.echo + (-5000).to_bytes(4, "big", signed=True)],
        },
    )
    with live(channel, I3) as car:
        wait_until(lambda: len(car.of(BatteryReading)) >= 3 and car.of(SpeedReading))
    assert {(r.voltage, r.current) for r in car.of(BatteryReading)} == {(360.0, -50.0)}
    assert car.of(SpeedReading)[0].speed == pytest.approx(50 / 3.6)
    assert not car.bridge.status(0).dropped


def test_without_leave_nothing_is_ever_sent(channel, unit):
    units = kona(unit, lambda: [pack_answer(0, 4000)])
    with can.Bus(channel, interface="virtual") as listener, live(channel, KONA, poll=False) as car:
        for can_id in (0x7EC, 0x7BB, 0x100):  # also a first frame, which asks for flow control
            data = bytes.fromhex("103E620101FFF7E7")
            listener.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
        wait_until(lambda: car.bridge.status(0).unknown_frames == 1)
        assert listener.recv(0.5) is None
        status = car.bridge.poller.status()
    assert not any(unit.asked for unit in units)
    assert not status.ok and "hyundai_kia" in status.text and "poll:=true" in status.text


def test_only_read_requests_and_flow_control_are_on_the_wire(channel, unit):
    kona(unit, lambda: [pack_answer(250, 3600)])
    with can.Bus(channel, interface="virtual") as listener, live(channel, KONA) as car:
        wait_until(lambda: len(car.of(BatteryReading)) >= 5)
        frames = iter(lambda: listener.recv(0), None)
        sent = {bytes(m.data) for m in frames if m.arbitration_id in (0x7E4, 0x7B3)}
    wanted = ("0322010100000000", "0322010000000000", "3000000000000000")
    assert sent == set(map(bytes.fromhex, wanted))


def test_a_refusal_retires_its_request_and_says_so(channel, unit):
    pack, _ = kona(unit, lambda: [bytes.fromhex("7F2231")])
    with live(channel, KONA) as car:
        wait_until(lambda: not car.bridge.poller.status().ok)
        speeds = len(car.of(SpeedReading))
        wait_until(lambda: len(car.of(SpeedReading)) > speeds + 3)
        status = car.bridge.poller.status()
    assert status.text == "battery refused: RequestOutOfRange"
    assert len(pack.asked) == 3 and status.counters["refused"] == 3


def test_a_silent_unit_does_not_hold_up_another(channel, unit):
    kona(unit, list)
    with live(channel, KONA) as car:
        wait_until(lambda: len(car.of(SpeedReading)) >= 10)
        assert not car.of(BatteryReading)
        wait_until(lambda: car.counters.get("silent"))
        assert car.bridge.poller.status().ok


@pytest.mark.nightly
def test_a_sleeping_car_is_left_alone_until_its_bus_wakes(channel, unit, monkeypatch):
    monkeypatch.setattr(restraint_module, "UNANSWERED_S", 1.5)
    monkeypatch.setattr(restraint_module, "QUIET_S", 1.0)
    awake = False
    kona(
        unit,
        lambda: [pack_answer(250, 3600)] if awake else [],
        lambda: [drive_answer(0)] if awake else [],
    )
    with can.Bus(channel, interface="virtual") as other, live(channel, KONA) as car:

        def wake():
            for index in range(restraint_module.AWAKE_FRAMES):
                can_id = 0x100 + index % restraint_module.AWAKE_IDS
                other.send(can.Message(arbitration_id=can_id, is_extended_id=False))

        wake()
        wait_until(lambda: not car.bridge.poller.status().ok)
        text = car.bridge.poller.status().text
        assert text.startswith("stopped: no answer for 2 s: the car sleeps")
        asked = car.counters["asked"]
        time.sleep(1.2)
        assert car.counters["asked"] == asked
        awake = True
        wake()
        wait_until(lambda: car.of(BatteryReading))
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


def test_a_low_12_v_battery_ends_the_asking(channel, unit, monkeypatch):
    monkeypatch.setattr(restraint_module, "LOW_FOR_S", 0.3)
    kona(unit, lambda: [pack_answer(0, 3600, auxiliary=117)], lambda: [drive_answer(0)])
    with live(channel, KONA) as car:
        wait_until(lambda: not car.bridge.poller.status().ok)
        asked = car.counters["asked"]
        time.sleep(0.5)
        assert car.counters["asked"] - asked in (0, 1)  # one more look at its voltage
        text = car.bridge.poller.status().text
    assert text.startswith("stopped: the 12 V battery is low: 11.7 V; goes on when")


def test_a_driver_that_fails_is_no_end(monkeypatch):
    monkeypatch.setattr(poller_module, "LISTEN_FIRST_S", 0.05)

    def fail(frame):
        raise can.CanOperationError("transmit buffer full")

    poller = Poller(KONA, fail)
    with running(poller, within_s=1.0):
        wait_until(lambda: poller.status().counters.get("send_errors", 0) >= 4)


def test_no_bus_is_waited_for_without_a_stop(monkeypatch):
    now = [0.0]
    poller = Poller(KONA, lambda frame: False, clock=lambda: now[0])
    with running(poller, within_s=1.0):
        for _ in range(20):
            now[0] += 10.0
            time.sleep(0.01)
        assert poller.status().ok and not poller.status().counters


def test_a_log_of_a_polled_drive_decodes_like_the_live_bus(channel, unit):
    kona(unit, lambda: [pack_answer(250, 3600)])
    with can.Bus(channel, interface="virtual") as log:
        with live(channel, KONA) as car:
            wait_until(lambda: len(car.of(BatteryReading)) >= 3)
        offline, readings = CanBridge(KONA), []
        for message in iter(lambda: log.recv(0), None):
            readings += offline.decode(CanFrame(0, message.arbitration_id, bytes(message.data)))

    def values(readings):
        return [repr(reading).partition(",")[2] for reading in readings]

    assert values(readings)[: len(car.readings)] == values(car.readings)


def test_a_car_that_is_another_is_not_asked(monkeypatch):
    monkeypatch.setattr(poller_module, "LISTEN_FIRST_S", 0.05)
    bolt, sent = load_profile("chevrolet_bolt"), []

    def send(frame):
        sent.append(frame)
        return True

    bridge = CanBridge(bolt, send, guard=FitGuard(bolt, ()))
    with running(bridge.poller, within_s=1.0):
        wait_until(lambda: sent)
        for index in range(100):  # more than 600 mph, for a second
            speed = (60_000 + index).to_bytes(2, "big") + bytes(6)
            bridge.decode(CanFrame(index * 10_000_000, 0x3E9, speed))
        assert bridge.refusal is not None
        sent.clear()
        time.sleep(1.3)  # after a second without an answer the next question would be due
    assert not sent
    assert bridge.poller.status().text.endswith("contradicts the profile")
