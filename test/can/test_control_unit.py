"""One control unit frame by frame, with a clock of our own: every way an answer can go wrong."""

import math

from hypothesis import example, given, settings
from hypothesis import strategies as st
import pytest

from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.control_unit import (
    ANSWER_TIMEOUT_S,
    LONGEST_WAIT_S,
    PENDING_TIMEOUT_S,
    REFUSALS,
    ControlUnit,
)
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.read_only import ReadOnlyGate
from evpinn_ros.can.request import Address, RequestRule
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from test.can.conftest import ASKING

ADDRESS = Address(0x7E4, 0x7EC, False, None, None)
FIRST = RequestRule("first", ADDRESS, b"\x22\x01\x01", 3, 0.2)
SECOND = RequestRule("second", ADDRESS, b"\x22\x01\x05", 1, 0.2)
ALL = ("first", "second", "voltage")


class Desk:
    """A control unit as the car's side sees it: what was sent, and what to send back."""

    def __init__(self, *requests, address=ADDRESS):
        self.sent, self.address, self.now = [], address, 0.0
        self.unit = ControlUnit(address, requests, self._send)

    def _send(self, frame):
        self.sent.append(frame.data)
        return True

    def advance(self, seconds=0.0):
        self.now += seconds
        return self.unit.step(self.now, may_ask=ALL)

    def frame(self, data, stamp=0):
        frame = CanFrame(stamp, self.address.rx_id, bytes.fromhex(data), self.address.extended)
        return self.unit.receive(frame, self.now)


@pytest.fixture
def desk():
    return Desk(FIRST)


def test_question_and_single_frame(desk):
    assert desk.advance() == ANSWER_TIMEOUT_S
    assert desk.sent == [bytes.fromhex("0322010100000000")]
    answer = desk.frame("06620101AABBCC00", stamp=42)
    assert (answer.stamp_ns, answer.request, answer.data) == (42, FIRST, b"\xaa\xbb\xcc")
    assert desk.advance() == pytest.approx(0.2)
    assert len(desk.sent) == 1
    desk.advance(0.2)
    assert len(desk.sent) == 2
    assert desk.unit.counters == {"asked": 2, "answered": 1}


def test_extended_addressing():
    address = Address(0x6F1, 0x607, False, 0x07, 0xF1)
    desk = Desk(RequestRule("voltage", address, b"\x22\xdd\x68", 2, 0.2), address=address)
    desk.advance()
    assert desk.sent == [bytes.fromhex("070322DD68000000")]
    assert desk.frame("F10562DD688CA000").data == bytes.fromhex("8CA0")
    desk.advance(0.2)
    assert desk.frame("F1100762DD680001", stamp=3) is None
    assert desk.sent[2] == bytes.fromhex("0730000000000000")
    answer = desk.frame("F1210203AAAAAAAA")
    assert answer.data == bytes(range(4)) and answer.stamp_ns == 3


def test_silence_is_waited_for_and_counted(desk):
    desk.advance()
    desk.advance(ANSWER_TIMEOUT_S - 0.01)
    assert len(desk.sent) == 1 and not desk.unit.counters["silent"]
    desk.advance(0.01)
    assert len(desk.sent) == 2 and desk.unit.counters["silent"] == 1


def test_pending_is_waited_for_but_not_for_ever(desk):
    desk.advance()
    assert desk.frame("037F227800000000") is None
    assert desk.advance(ANSWER_TIMEOUT_S) == PENDING_TIMEOUT_S
    assert desk.frame("06620101AABBCC00") is not None
    assert desk.unit.counters == {"asked": 1, "pending": 1, "answered": 1}
    desk.advance(1.0)
    begun = desk.now
    while desk.unit.counters["silent"] == 0:
        desk.frame("037F227800000000")
        desk.advance(0.5)
        assert desk.now - begun <= LONGEST_WAIT_S


def test_busy_is_no_refusal(desk):
    for _ in range(2 * REFUSALS):
        desk.advance(0.2)
        desk.frame("037F222100000000")
    assert not desk.unit.retired
    assert desk.unit.counters == {"asked": 2 * REFUSALS, "busy": 2 * REFUSALS}


def test_refusals_retire_the_request_alone():
    desk = Desk(FIRST, SECOND)
    for _ in range(20):
        desk.advance(0.2)
        refused = desk.sent[-1][3] == 1
        desk.frame("037F223100000000" if refused else "0462010501000000")
    assert desk.unit.retired == {"first": "RequestOutOfRange"}
    counters = desk.unit.counters
    assert (counters["refused"], counters["answered"]) == (REFUSALS, 20 - REFUSALS)
    desk.unit.revive()
    desk.advance(1.0)
    assert not desk.unit.retired and desk.sent[-1][3] == 1


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        (["0662010BAABBCC00"], "unexpected_answer"),  # another identifier
        (["037F2E3100000000"], "unexpected_answer"),  # refuses what nobody asked
        (["05620101AABB0000"], "short_answer"),
        (["FF00000000000000"], "garbled"),
        (["100A620101000102", "2203040506AAAAAA"], "garbled"),  # the first continuation is lost
    ],
)
def test_wrong_answers_are_counted_and_never_read(desk, capfd, frames, reason):
    desk.advance()
    assert [desk.frame(data) for data in frames] == [None] * len(frames)
    assert desk.unit.counters[reason] == 1 and capfd.readouterr().err == ""
    desk.advance(ANSWER_TIMEOUT_S)
    assert desk.frame("06620101AABBCC00") is not None


def test_answers_for_another_tester_are_read_without_a_word(desk):
    desk.unit.step(0.0, may_ask=())
    assert desk.frame("100A620101000102") is None
    assert desk.frame("2103040506AAAAAA").data == bytes(range(7))
    assert not desk.sent


@st.composite
def conversations(draw):
    """A profile and a row of frames with the ids of its answers, half of them well-formed."""
    profile = ASKING[draw(st.sampled_from(sorted(ASKING)))]
    frames = []
    for _ in range(draw(st.integers(1, 6))):
        request = draw(st.sampled_from(profile.requests))
        source = b"" if request.address.source is None else bytes((request.address.source,))
        if draw(st.booleans()):
            data = [draw(st.binary(max_size=12))]
        else:
            length = draw(st.integers(0, request.min_length + 3))
            payload = request.echo + draw(st.binary(min_size=length, max_size=length))
            data = [source + part for part in segments(payload, 8 - len(source))]
        frames += [(request.address, part) for part in data]
    return profile, frames


def segments(payload, room):
    """The ISO-TP frames of a payload, by ISO 15765-2."""
    if len(payload) < room:
        return [bytes((len(payload),)) + payload]
    first = bytes((0x10 | len(payload) >> 8, len(payload) & 0xFF)) + payload[: room - 2]
    rest = payload[room - 2 :]
    parts = [rest[start : start + room - 1] for start in range(0, len(rest), room - 1)]
    return [first, *(bytes((0x20 | (i + 1) & 0xF,)) + part for i, part in enumerate(parts))]


def bounds(profile, quantity, index=0):
    signal = profile.asked[quantity][index].signal
    return signal.lower, signal.upper


@pytest.mark.slow
@given(conversations(), st.booleans())
@example((ASKING["obd2_speed"], [(ASKING["obd2_speed"].requests[0].address, b"")]), True)
@settings(max_examples=150, deadline=None)
def test_whatever_comes_is_a_plausible_reading_or_none(case, asking):
    profile, frames = case
    sent = []
    gate = ReadOnlyGate(profile.requests, lambda frame: sent.append(frame) or True)
    bridge = CanBridge(profile, gate if asking else None)
    for address, data in frames:
        for reading in bridge.decode(CanFrame(5, address.rx_id, data, address.extended)):
            if isinstance(reading, SpeedReading):
                lower, upper = bounds(profile, "speed")
                assert lower <= reading.speed <= upper and 0 < reading.variance < 1
            else:
                assert isinstance(reading, BatteryReading)
                for index, value in enumerate((reading.voltage, reading.current)):
                    lower, upper = bounds(profile, "battery", index)
                    assert lower <= value <= upper or math.isnan(value)  # of an answer of its own
                assert not (math.isnan(reading.voltage) and math.isnan(reading.current))
                assert not reading.state_of_charge > 1.05
    assert bool(sent) <= asking
