"""Users' own DBC files: what works, and what each mistake is told as."""

import tracemalloc

import cantools
from hypothesis import given, settings
from hypothesis import strategies as st
import pytest
import yaml

from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.dbc import place_of
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from test.can.conftest import refusal

# As people's files are: overlapping and overhanging signals, values without a use, odd units.
DBC = """VERSION ""

BU_: Car

BO_ 256 MotorSpeed: 8 Car
 SG_ VehicleSpeed : 7|16@0+ (0.01,0) [0|0] "kph" Car
 SG_ SpeedAgain : 7|16@0+ (0.01,0) [0|0] "kph" Car
 SG_ MilesPerHour : 23|16@0+ (0.01,0) [0|0] "MPH" Car
 SG_ SpeedFloat : 32|32@1- (1,0) [0|0] "km/h" Car
 SG_ TooFar : 56|16@1+ (1,0) [0|0] "" Car

BO_ 512 Pack: 8 Car
 SG_ Page M : 0|8@1+ (1,0) [0|255] "" Car
 SG_ Voltage m1 : 8|16@1+ (0.1,0) [0|0] "V" Car
 SG_ Current m1 : 24|16@1- (0.1,0) [0|0] "A" Car
 SG_ Temperature m2 : 8|16@1- (0.1,0) [0|0] "" Car

BO_ 513 Headless: 8 Car
 SG_ Volts m1 : 8|16@1+ (0.1,0) [0|0] "V" Car
 SG_ Amps m1 : 24|16@1- (0.1,0) [0|0] "A" Car

BO_ 514 Overhang: 3 Car
 SG_ Which M : 0|8@1+ (1,0) [0|255] "" Car
 SG_ Volts m1 : 8|16@1+ (0.1,0) [0|0] "V" Car
 SG_ Amps m1 : 24|16@1- (0.1,0) [0|0] "A" Car

BO_ 516 Volts: 8 Car
 SG_ Count : 0|8@1+ (1,0) [0|255] "" Car
 SG_ Voltage : 8|16@1+ (0.1,0) [0|0] "V" Car

BO_ 517 Amps: 8 Car
 SG_ Current : 8|16@1- (0.1,0) [0|0] "A" Car

BO_ 515 Double: 8 Car
 SG_ Which M : 0|8@1+ (1,0) [0|255] "" Car
 SG_ Volts m1 : 8|16@1+ (0.1,0) [0|0] "V" Car
 SG_ Alarm m1 : 20|1@1+ (1,0) [0|1] "" Car

SIG_VALTYPE_ 256 SpeedFloat : 1;
VAL_ 256 VehicleSpeed 65535 "SNA" ;
VAL_ 256 SignalThatIsGone 0 "off" 1 "on" ;
VAL_ 1999 OfAnotherFile 0 "off" ;
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 10;
"""
SPEED = "speed: {message: MotorSpeed, signal: VehicleSpeed, unit: km/h, valid: [0, 250]}\n"
BATTERY = """battery:
  message: Pack
  voltage: {signal: Voltage, unit: V, valid: [200, 500]}
  current: {signal: Current, unit: A, positive_means: discharge, valid: [-500, 500]}
"""
APART = """battery:
  voltage: {message: Volts, signal: Voltage, unit: V, valid: [200, 500], counter: Count}
  current: {message: Amps, signal: Current, unit: A, positive_means: discharge, valid: [-500, 500]}
"""
HEAD = "name: My car\nsource: measured\nverified_by: a drive\ndbc: my.dbc\n"


@pytest.fixture(scope="session")
def write(tmp_path_factory):
    """Writes a profile beside its DBC file."""

    def make(text, dbc=DBC):
        folder = tmp_path_factory.mktemp("user")
        (folder / "my.dbc").write_text(dbc, encoding="cp1252")
        (folder / "my_car.yaml").write_text(text)
        return folder / "my_car.yaml"

    return make


@pytest.fixture(scope="session")
def profile(write):
    return load_profile(write(HEAD + SPEED + BATTERY))


def test_a_mapping_file_anywhere_reads_a_loose_dbc(profile):
    assert profile.key == "my_car"
    decoder = Decoder(profile)
    (speed,) = decoder.decode(CanFrame(1, 256, bytes.fromhex("2710")))
    assert speed == SpeedReading(1, pytest.approx(100 / 3.6), pytest.approx(0.01**2 / 3.6**2 / 12))
    # Page 1: 400.0 V, 20.0 A discharged.
    (battery,) = decoder.decode(CanFrame(2, 512, bytes.fromhex("01A00FC80000000000")))
    assert (battery.voltage, battery.current) == (pytest.approx(400.0), pytest.approx(-20.0))
    for another_page in ("02A00FC800000000", "02A0"):
        assert decoder.decode(CanFrame(3, 512, bytes.fromhex(another_page))) == ()
    assert not decoder.dropped
    assert decoder.decode(CanFrame(4, 512, bytes.fromhex("03A00FC800000000"))) == ()
    assert decoder.decode(CanFrame(5, 512, bytes.fromhex("01A0"))) == ()
    assert decoder.dropped == {"unknown_multiplexer": 1, "short_frame": 1}


@given(can_id=st.sampled_from([256, 512]), data=st.binary(max_size=64))
@settings(max_examples=100, deadline=None)
def test_no_payload_of_a_users_file_is_an_exception(profile, can_id, data):
    decoder = Decoder(profile)
    for reading in decoder.decode(CanFrame(0, can_id, data)):
        if isinstance(reading, BatteryReading):
            assert 200 <= reading.voltage <= 500 and -500 <= reading.current <= 500
        else:
            assert 0 <= reading.speed <= 250 / 3.6


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("message: MotorSpeed", "message: Motorspeed", "'Motorspeed'; did you mean MotorSpeed"),
        ("signal: VehicleSpeed", "signal: SpeedFloat", "is a floating-point signal"),
        ("signal: VehicleSpeed", "signal: MilesPerHour", "gives 'MilesPerHour' in MPH"),
        ("message: Pack", "message: Headless", "no signal of it is the multiplexer 'M'"),
        ("message: Pack", "message: Overhang", "'Amps' exceeds the 3 bytes"),
        ("message: Pack", "message: Double", "'Volts' and 'Alarm' overlap in message 'Double'"),
        (
            "valid: [0, 250]}",
            "valid: [0, 250], counter: SpeedAgain}",
            "'SpeedAgain' and 'VehicleSpeed' overlap in 'MotorSpeed'",
        ),
    ],
)
def test_a_mistake_is_told_with_its_line(write, old, new, reason):
    text = HEAD + SPEED + BATTERY
    assert old in text
    told = refusal(write(text.replace(old, new, 1)))
    assert reason in told and 0 < int(told.split(":")[1]) <= 9


def test_a_unit_that_the_dbc_file_has_wrong_can_be_overruled(write):
    text = (HEAD + SPEED).replace("VehicleSpeed, unit", "MilesPerHour, scale: 1, unit")
    (reading,) = Decoder(load_profile(write(text))).decode(
        CanFrame(0, 256, bytes.fromhex("00002710"))
    )
    assert reading.speed == pytest.approx(100 / 3.6)


def test_pages_of_one_message_may_share_bits(write):
    charge = "state_of_charge: {message: Pack, signal: Temperature, unit: '%', valid: [0, 100]}\n"
    assert "state_of_charge" in load_profile(write(HEAD + BATTERY + charge)).messages


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("7|16@", "7|100000@", "a signal lies beyond bit 20000"),
        ("7|16@", "7 | 100000 @", "a signal lies beyond bit 20000"),
        ("7|16@", "7// a comment\n|100000@", "a signal lies beyond bit 20000"),
        ("Speed: 8 ", "Speed: 100000 ", "is not read: it has more than 20000 bits"),
        ("BU_: Car", "BU_: Car\n\nSG_MUL_VAL_ 512 S Page 0-5000001;", "too many pages"),
    ],
)
def test_a_file_that_would_fill_the_memory_is_refused(write, old, new, reason):
    # Just beyond what is read: were such a file let in, the test would fail and not hang.
    assert old in DBC
    assert reason in refusal(write(HEAD + SPEED + BATTERY, DBC.replace(old, new, 1)))


@pytest.mark.parametrize("name", ["../my.dbc", "/etc/my.dbc", "a/../../my.dbc"])
def test_a_file_elsewhere_is_not_read(write, name):
    told = refusal(write(HEAD.replace("my.dbc", name)))
    assert "'dbc' must be a file beside this one" in told


def test_a_message_of_very_many_signals_is_refused(write):
    signal = ' SG_ S : 7|16@0+ (1,0) [0|0] "" Car\n'
    many = DBC + "\nBO_ 99 Many: 8 Car\n" + 2001 * signal
    assert load_profile(write(HEAD + SPEED, many)).messages
    told = refusal(write(HEAD + SPEED.replace("MotorSpeed", "Many"), many))
    assert "'Many' is not read: it has more than 2000 signals" in told


def test_what_no_profile_names_costs_next_to_nothing(write):
    names = " ".join(f"Node{i}" for i in range(200_000))
    path = write(HEAD + SPEED, DBC.replace("BU_: Car", f"BU_: Car {names}"))
    tracemalloc.start()
    try:
        load_profile(path)
        assert tracemalloc.get_traced_memory()[1] < 30_000_000
    finally:
        tracemalloc.stop()


def test_statements_in_strings_and_comments_are_none(write):
    other = "BO_ 9 MotorSpeed: 1 Car"
    remark = f'CM_ "a \\" b\n{other}";\n// "\n// {other}\n'
    for dbc in (f"{DBC}\n{remark}", DBC.replace("BU_: Car", f"BU_: Car\n\n{remark}")):
        rule = load_profile(write(HEAD + SPEED, dbc)).messages["speed"]
        assert (rule.message.frame_id, rule.message.length) == (256, 8)


@pytest.mark.parametrize(
    "path", [*(share_directory() / "config" / "can").glob("*.yaml")], ids=lambda path: path.stem
)
def test_a_message_is_what_cantools_finds_in_the_whole_file(path):
    rules = load_profile(path).messages.values()
    name = yaml.safe_load(path.read_text(encoding="utf-8")).get("dbc")
    assert bool(rules) == bool(name)
    whole = cantools.database.load_file(path.with_name(name), strict=False) if name else None
    for message in (rule.message for rule in rules):
        assert _layout(message) == _layout(whole.get_message_by_name(message.name))


def _layout(message):
    names = ("name", "is_signed", "is_float", "scale", "offset", "unit", "is_multiplexer")
    signals = [(place_of(s), *(getattr(s, name) for name in names)) for s in message.signals]
    return message.name, message.frame_id, message.is_extended_frame, message.length, signals


def frames_apart(moments):
    """Frames of an inverter: 350 V and 20 A drawn at moments in ms, by the message."""
    of_voltage, of_current = (
        [CanFrame(ms * 10**6, number, bytes([ms % 256, *raw.to_bytes(2, "little"), 0, 0, 0, 0, 0]))
         for ms in moments[name]]
        for name, number, raw in (("voltage", 516, 3500), ("current", 517, 200))
    )  # fmt: skip
    return sorted(of_voltage + of_current, key=lambda frame: frame.stamp_ns)


@pytest.mark.parametrize(
    ("voltages", "currents", "pairs"),
    [
        (range(0, 1000, 100), range(20, 1000, 100), 10),  # the voltage a little before
        (range(20, 1000, 100), range(0, 1000, 100), 10),  # or after
        (range(0, 1000, 100), range(5, 1000, 10), 10),  # a voltage with some of the currents
        (range(0, 5000, 1000), range(500, 5000, 1000), 0),  # too far apart to be of one moment
    ],
)
def test_voltage_and_current_may_come_in_two_messages(write, voltages, currents, pairs):
    decoder = Decoder(load_profile(write(HEAD + APART)))
    frames = frames_apart({"voltage": voltages, "current": currents})
    readings = [reading for frame in frames for reading in decoder.decode(frame)]
    assert not decoder.dropped
    whole = [reading for reading in readings if reading.power == reading.power]
    assert [r.power for r in whole] == pytest.approx([7000.0] * pairs)
    told = {
        name: {r.stamp_ns // 10**6 for r in readings if getattr(r, name) == getattr(r, name)}
        for name in ("voltage", "current")
    }
    assert told["current"] >= {*currents[:-1]}
    assert len(told["voltage"]) >= len(voltages) - 1


def test_messages_of_voltage_and_current_are_judged_each_by_its_own(write):
    profile = load_profile(write(HEAD + SPEED + APART))
    assert profile.quantities == {"speed", "battery"}
    guard = FitGuard(profile, [])
    assert {message.quantity for message in guard.fit.messages} == {"speed", "voltage", "current"}
    bridge = CanBridge(profile)
    moments = {"voltage": range(0, 3000, 100), "current": range(20, 3000, 100)}
    for frame in frames_apart(moments):
        bridge.decode(frame)
    arrivals = bridge.status(3000 * 10**6).signals["battery"]
    assert arrivals.count == 30 and not arrivals.stale
