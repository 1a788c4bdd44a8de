"""Whatever the bus sends, the decoder answers with readings a car can show, or with nothing."""

import json
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.current_sign import CurrentSign
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.inspection import Inspection
from evpinn_ros.cli.can import as_json
from evpinn_ros.common.json_text import json_text
from evpinn_ros.core.signals.readings import BatteryReading, MotorReading, SpeedReading
from test.can.conftest import PROFILES

pytestmark = pytest.mark.slow

WHOLE = sorted(key for key in PROFILES if {"speed", "battery"} <= PROFILES[key].messages.keys())


@st.composite
def frames(draw):
    """A profile and a frame of one of its ids, its checksum right or random."""
    profile = PROFILES[draw(st.sampled_from(sorted(PROFILES)))]
    rule = profile.messages[draw(st.sampled_from(sorted(profile.messages)))]
    data = bytearray(draw(st.binary(max_size=64)))
    if rule.checksum and len(data) > rule.checksum_byte and draw(st.booleans()):
        rest = bytes(data[: rule.checksum_byte] + data[rule.checksum_byte + 1 :])
        data[rule.checksum_byte] = rule.checksum(rule.message.frame_id, rest)
    stamp_ns, extended = draw(st.integers(0, 2**62)), rule.message.is_extended_frame
    return profile, CanFrame(stamp_ns, rule.message.frame_id, bytes(data), extended)


@given(st.lists(frames(), min_size=1, max_size=8))
@settings(max_examples=200, deadline=None)
def test_every_payload_gives_a_plausible_reading_or_a_reason(cases):
    for profile, frame in cases:
        decoder = Decoder(profile)
        readings = decoder.decode(frame)
        held = ("state_of_charge", "motor", "second_motor")  # wait for what completes them
        silent = frame.can_id in (
            profile.messages[name].message.frame_id for name in held if name in profile.messages
        )
        assert silent or bool(readings) != bool(decoder.dropped)
        for reading in readings:
            assert reading.stamp_ns == frame.stamp_ns
            assert_within(profile, reading)


def assert_within(profile, reading):
    """Within what the car can show, and so finite; a step of rounding aside."""
    if isinstance(reading, SpeedReading):
        values = [(profile.messages["speed"].signals[0], reading.speed)]
        assert 0 < reading.variance < 1
    elif isinstance(reading, MotorReading):
        pair = (reading.torque, reading.speed)
        values = list(zip(profile.messages["motor"].signals, pair, strict=False))
    else:
        values = list(
            zip(
                profile.messages["battery"].signals,
                (reading.voltage, reading.current),
                strict=True,
            )
        )
        if not math.isnan(reading.state_of_charge):
            values.append(
                (profile.messages["state_of_charge"].signals[0], reading.state_of_charge)
            )
    for signal, value in values:
        assert signal.lower <= value <= signal.upper


@given(st.lists(frames(), max_size=30), st.booleans())
@settings(max_examples=60, deadline=None)
def test_guard_and_inspection_take_whatever_comes(cases, patient):
    profile = cases[0][0] if cases else PROFILES["nissan_leaf"]
    guard = FitGuard(profile, PROFILES.values(), patient=patient)
    bridge = CanBridge(profile, guard=guard, sign=CurrentSign())
    inspection = Inspection(PROFILES.values(), 500_000)
    for _, frame in cases:
        for reading in bridge.decode(frame):
            assert_within(profile, reading)
        inspection.add_frame(frame)
    for reading in bridge.finish():
        assert_within(profile, reading)
    assert bridge.status(0).text
    report = inspection.report()
    assert report.frames == len(cases)
    assert json.loads(json_text(as_json(report)))["frames"] == len(cases)


@given(
    name=st.sampled_from(WHOLE),
    speed=st.floats(0, 55),
    voltage=st.floats(200, 460),
    current=st.floats(-500, 400),
    charge=st.floats(0, 1),
)
@settings(max_examples=100, deadline=None)
def test_round_trip_within_half_a_step(name, speed, voltage, current, charge):
    profile = PROFILES[name]
    encoder, decoder = Encoder(profile), Decoder(profile)
    written = BatteryReading(7, voltage, current, charge)
    has_charge = "state_of_charge" in profile.messages
    if has_charge:
        decoder.decode(encoder.state_of_charge(written))
    (speed_back,) = decoder.decode(encoder.speed(SpeedReading(6, speed)))
    (battery_back,) = decoder.decode(encoder.battery(written))
    assert (speed_back.stamp_ns, battery_back.stamp_ns) == (6, 7)

    def step(quantity, index=0):
        return profile.messages[quantity].signals[index].resolution

    def near(a, b, resolution):
        return abs(a - b) <= resolution * (0.5 + 1e-9)

    assert near(speed_back.speed, speed, step("speed"))
    assert near(battery_back.voltage, voltage, step("battery", 0))
    assert near(battery_back.current, current, step("battery", 1))
    if has_charge:
        assert near(battery_back.state_of_charge, charge, step("state_of_charge"))
