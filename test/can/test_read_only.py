"""Nothing leaves for the car but reading, whatever makes the frame."""

import ast
from pathlib import Path

import pytest

import evpinn_ros
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import load_profile, profile_names
from evpinn_ros.can.read_only import FRAMES_PER_S, ReadOnlyGate
from evpinn_ros.can.request import Address, RequestRule


def request(tx, rx, payload, target=None, source=None):
    return RequestRule("one", Address(tx, rx, tx > 0x7FF, target, source), payload, 1, 0.2)


PLAIN = request(0x7E4, 0x7EC, b"\x22\x01\x01")
PREFIXED = request(0x6F1, 0x607, b"\x22\xdd\x68", 0x07, 0xF1)
WIDE = request(0x17FC007B, 0x17FE007B, b"\x22\x1e\x3d")
TO_ALL = request(0x7DF, 0x7E8, b"\x01\x0d")
REQUESTS = [PLAIN, PREFIXED, WIDE, TO_ALL]
ALLOWED = {
    (can_id, can_id > 0x7FF, bytes.fromhex(data))
    for can_id, data in [
        *((0x7E4, "0322010100000000"), (0x7E4, "3000000000000000"), (0x7DF, "02010D0000000000")),
        *((0x6F1, "070322DD68000000"), (0x6F1, "0730000000000000")),
        *((0x17FC007B, "03221E3D00000000"), (0x17FC007B, "3000000000000000")),
    ]
}
QUESTION = CanFrame(0, 0x7E4, bytes.fromhex("0322010100000000"))
FLOW_CONTROL = CanFrame(0, 0x7E4, bytes.fromhex("3000000000000000"))


@pytest.fixture
def passed():
    return []


@pytest.fixture
def now():
    return [0.0]


@pytest.fixture
def gate(passed, now):
    return ReadOnlyGate(REQUESTS, lambda frame: passed.append(frame) or True, lambda: now[0])


@pytest.mark.parametrize(
    ("can_id", "question", "flow_control"),
    [
        (0x7E4, "0322010100000000", "3000000000000000"),
        (0x6F1, "070322DD68000000", "0730000000000000"),
        (0x17FC007B, "03221E3D00000000", "3000000000000000"),
    ],
)
def test_a_question_passes_and_the_flow_control_of_its_answer(
    gate, passed, can_id, question, flow_control
):
    frames = [
        CanFrame(0, can_id, bytes.fromhex(data), can_id > 0x7FF)
        for data in (question, flow_control)
    ]
    with pytest.raises(PermissionError):
        gate(frames[1])
    assert all(map(gate, frames)) and passed == frames
    with pytest.raises(PermissionError):  # first frames that nobody asked for
        gate(frames[1])


def test_no_flow_control_goes_to_all(gate):
    assert gate(CanFrame(0, 0x7DF, bytes.fromhex("02010D0000000000")))
    with pytest.raises(PermissionError):
        gate(CanFrame(0, 0x7DF, FLOW_CONTROL.data))


def test_all_else_is_held_back(gate, passed):
    """Another id or kind of id, a frame cut or longer, and every other value of every byte."""
    gate(QUESTION)
    for can_id, extended, data in ALLOWED:
        others = {(can_id ^ 1, extended, data), (can_id, not extended, data)}
        others |= {(can_id, extended, data[:size]) for size in range(8)}
        others |= {(can_id, extended, data + bytes(more)) for more in (1, 4, 56)}
        for place in range(8):
            changed = (data[:place] + bytes((value,)) + data[place + 1 :] for value in range(256))
            others |= {(can_id, extended, other) for other in changed}
        for other_id, is_extended, other in others - ALLOWED:
            with pytest.raises(PermissionError):
                gate(CanFrame(0, other_id, other, is_extended))
    assert passed == [QUESTION]


@pytest.mark.parametrize(
    "bad",
    [
        request(0x000, 0x008, b"\x22\x01\x01"),
        request(0x1D4, 0x1DC, b"\x22\x01\x01"),
        request(0x7E4, 0x7ED, b"\x22\x01\x01"),
        request(0x7E4, 0x7EC, b"\x2e\x01\x01"),
        request(0x7E4, 0x7EC, b"\x22\x01\x01\x55"),
    ],
)
def test_the_gate_of_a_request_that_does_more_than_read_never_opens(bad):
    with pytest.raises(PermissionError):
        ReadOnlyGate([bad], lambda frame: True)


def test_the_pace_is_bounded(gate, passed, now):
    """A question loops, or first frames pour in: 50 frames a second leave, and no more."""
    refused = 0
    for _ in range(10_000):
        now[0] += 0.001
        try:
            gate(QUESTION)
        except PermissionError:
            refused += 1
    assert len(passed) == pytest.approx(10 * FRAMES_PER_S, abs=FRAMES_PER_S)
    assert refused == 10_000 - len(passed)


def test_every_request_of_every_profile_passes():
    for profile in map(load_profile, profile_names()):
        for request in profile.requests:
            address, payload = request.address, request.payload
            data = address.prefix + bytes((len(payload),)) + payload
            sent = ReadOnlyGate([request], lambda frame: True)
            assert sent(CanFrame(0, address.tx_id, data.ljust(8, b"\0"), address.extended))


@pytest.mark.slow
def test_a_bus_is_sent_to_in_one_place_alone():
    """Only the bus reader may call the `send` of python-can."""
    package, callers = Path(evpinn_ros.__file__).parent, set()
    for path in package.rglob("*.py"):
        text = path.read_text()
        if "bus.send" not in text and "send_periodic" not in text and "Notifier" not in text:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "bus.send":
                callers.add(path.name)
            if isinstance(node, ast.Attribute) and node.attr in ("send_periodic", "Notifier"):
                callers.add(path.name)
    assert callers == {"bus.py"}
