"""Our reading of raw bits against cantools, for every profile and for layouts of any kind."""

import cantools
from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from evpinn_ros.can.decoder import unpacker
from test.can.conftest import ALL

MESSAGES = [rule.message for profile in ALL for rule in profile.messages.values()]

OVERLAPPING = """VERSION ""

BU_: X

BO_ 100 M: 4 X
 SG_ Whole : 7|16@0+ (1,0) [0|0] "" X
 SG_ Middle : 3|8@0- (1,0) [0|0] "" X
 SG_ Last : 23|16@0+ (1,0) [0|0] "" X
"""


def by_cantools(message, data):
    return message.decode(data, decode_choices=False, scaling=False, allow_truncated=True)


@given(message=st.sampled_from(MESSAGES), data=st.binary(max_size=12))
@settings(max_examples=300, deadline=None)
def test_every_payload_of_every_profile_reads_as_by_cantools(message, data):
    names = [signal.name for signal in message.signals]
    assert unpacker(message, names)(data) == by_cantools(message, data)


@st.composite
def layouts(draw):
    """A message of random size with one signal anywhere in it."""
    size = draw(st.integers(1, 8))
    first = draw(st.integers(0, 8 * size - 1))
    length = draw(st.integers(1, 8 * size - first))
    little, signed = draw(st.booleans()), draw(st.booleans())
    start = first if little else first ^ 7
    text = f'VERSION ""\n\nBU_: X\n\nBO_ 100 M: {size} X\n SG_ S : '
    text += f'{start}|{length}@{int(little)}{"-" if signed else "+"} (1,0) [0|0] "" X\n'
    return cantools.database.load_string(text, database_format="dbc").messages[0]


@pytest.mark.slow
@given(message=layouts(), data=st.binary(max_size=12))
@settings(max_examples=200, deadline=None)
def test_any_layout_reads_as_by_cantools(message, data):
    assert unpacker(message, ["S"])(data) == by_cantools(message, data)


def test_overlapping_signals_read_the_bits_they_name():
    """cantools, not strict as for users' files, loads such a message but cannot read it."""
    database = cantools.database.load_string(OVERLAPPING, database_format="dbc", strict=False)
    message, data = database.messages[0], bytes.fromhex("1A2B3C4D")
    raw = unpacker(message, ["Whole", "Middle", "Last"])(data)
    assert raw == {"Whole": 0x1A2B, "Middle": 0xA2 - 0x100, "Last": 0x3C4D}
    with pytest.raises(cantools.database.DecodeError):
        by_cantools(message, data)
