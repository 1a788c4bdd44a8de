"""Nothing leaves for the car but reading, whatever makes the frame."""

import ast
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
import pytest

import evpinn_ros
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import load_profile, profile_names
from evpinn_ros.can.read_only import ReadOnlyGate
from evpinn_ros.can.request import READ_SERVICES, Address

PLAIN = Address(0x7E4, 0x7EC, False, None, None)
PREFIXED = Address(0x6F1, 0x607, False, 0x07, 0xF1)
WIDE = Address(0x17FC007B, 0x17FE007B, True, None, None)


@pytest.fixture
def passed():
    return []


@pytest.fixture
def gate(passed):
    return ReadOnlyGate([PLAIN, PREFIXED, WIDE], lambda frame: passed.append(frame) or True)


@pytest.mark.parametrize(
    ("can_id", "extended", "data"),
    [
        (0x7E4, False, "0322010100000000"),
        (0x7E4, False, "02210100"),
        (0x7E4, False, "02010D"),
        (0x7E4, False, "300000"),
        (0x6F1, False, "070322DD68000000"),
        (0x6F1, False, "0730000000000000"),
        (0x17FC007B, True, "03221E3D55555555"),
    ],
)
def test_reading_passes(gate, passed, can_id, extended, data):
    frame = CanFrame(0, can_id, bytes.fromhex(data), extended)
    assert gate(frame) and passed == [frame]


@pytest.mark.parametrize(
    ("can_id", "extended", "data"),
    [
        (0x7E4, False, "021003"),  # another session
        (0x7E4, False, "021101"),  # reset
        (0x7E4, False, "0104"),  # clear the fault memory
        (0x7E4, False, "042E010155"),  # write
        (0x7E4, False, "042F010103"),  # move an actuator
        (0x7E4, False, "0431010203"),  # start a routine
        (0x7E4, False, "023E00"),  # keep the session open
        (0x7E4, False, "0122"),
        (0x7E4, False, "05220101"),  # longer than its bytes
        (0x7E4, False, "0522010101020000"),  # two identifiers
        (0x7E4, False, "00032201010000"),  # an escaped length
        (0x7E4, False, "00102201010000"),
        (0x7E4, False, "100A220101010201"),  # the first of several frames
        (0x7E4, False, "2122010101020102"),
        (0x7E4, False, ""),
        (0x7E4, True, "0322010100000000"),
        (0x7E5, False, "0322010100000000"),
        (0x6F1, False, "0322DD6800000000"),  # lacks the control unit
        (0x6F1, False, "080322DD68000000"),  # another control unit
        (0x17FC007B, False, "03221E3D55555555"),
    ],
)
def test_all_else_is_held_back(gate, passed, can_id, extended, data):
    with pytest.raises(PermissionError):
        gate(CanFrame(0, can_id, bytes.fromhex(data), extended))
    assert not passed


@given(st.binary(max_size=8))
def test_only_services_that_read_ever_pass(data):
    passed = []
    gate = ReadOnlyGate([PLAIN], lambda frame: passed.append(frame) or True)
    try:
        gate(CanFrame(0, 0x7E4, data))
    except PermissionError:
        return
    assert data[0] >> 4 == 3 or data[1] in READ_SERVICES


def test_every_request_of_every_profile_passes():
    for profile in map(load_profile, profile_names()):
        for request in profile.requests:
            address, payload = request.address, request.payload
            data = address.prefix + bytes((len(payload),)) + payload
            sent = ReadOnlyGate([address], lambda frame: True)
            assert sent(CanFrame(0, address.tx_id, data.ljust(8, b"\0"), address.extended))


def test_a_bus_is_sent_to_in_one_place_alone():
    """Only the bus reader may call the `send` of python-can, and benchmarks on a bus of theirs."""
    package, callers = Path(evpinn_ros.__file__).parent, set()
    for path in set(package.rglob("*.py")) - set(package.glob("bench/*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "bus.send":
                callers.add(path.name)
            if isinstance(node, ast.Attribute) and node.attr in ("send_periodic", "Notifier"):
                callers.add(path.name)
    assert callers == {"bus.py"}
