"""Profiles that ask: every value from the bytes their sources give, and every error told."""

import re

import pytest

from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.decoder import AnswerDecoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import load_profile
from evpinn_ros.can.request import Answer
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from test.can.conftest import ASKING, KONA, refusal

CONFIG = share_directory() / "config" / "can"

# A published answer of an EV6 that charges at a wallbox with some 1 kW.
EV6 = """
103E620101EFFBE7 21EF6B2040017200 22FFF21C16201E20 23201F1E20004BBB 240DBB3D00008D00
2500D09F0000D37D 2600009CDF00009B 274400895F240002 28CD000000000BB8
"""


def decode(name, **answers):
    """The readings of a profile when its requests get these answers, hexadecimal."""
    profile = load_profile(name)
    requests = {request.name: request for request in profile.requests}
    decoder, readings = AnswerDecoder(profile), []
    for stamp, (request, data) in enumerate(answers.items()):
        readings += decoder.decode(Answer(stamp, requests[request], bytes.fromhex(data)))
    assert not decoder.dropped
    return decoder, readings


@pytest.mark.parametrize(
    ("name", "answers", "voltage", "current", "charge"),
    [
        # 0.2 A of discharge; 228/255 of the charge
        ("chevrolet_bolt", {"charge": "E4", "voltage": "8CA0", "current": "0004"},
         360.0, -0.2, 228 / 255),
        ("chevrolet_bolt", {"charge": "00", "voltage": "8CA0", "current": "FF38"}, 360.0, 10.0, 0),
        # 0x024A0: 150 A against 0x249F0 = 150000, which is none; an answer at rest, as quoted
        ("vw_meb", {"charge": "A9", "voltage": "05C1", "current": "000249F039"},
         368.25, 0.0, 0.676),
        ("vw_meb", {"charge": "A9", "voltage": "05C1", "current": "0002366800"},
         368.25, -50.0, 0.676),
        ("bmw_i3", {"voltage": "8CA0", "current": "FFFFEC78"}, 360.0, -50.0, None),
        ("bmw_i3", {"voltage": "8CA0", "current": "00001388"}, 360.0, 50.0, None),
        # 32768 is no current, 4 steps are 1 A
        ("renault_zoe_ph1", {"charge": "1388", "voltage": "02D0", "current": "7F38"},
         360.0, -50.0, 1.0),
        # 32640 is no current, 32 steps are 1 A
        ("renault_zoe_ph2", {"charge": "2710", "voltage": "0E10", "current": "7940"},
         360.0, -50.0, 1.0),
        ("hyundai_ioniq_28",
         {"battery": "00000000C8 0000000000 00C8 0E10"}, 360.0, -20.0, 1.0),
    ],
)  # fmt: skip
def test_battery_of_every_profile(name, answers, voltage, current, charge):
    _, (reading,) = decode(name, **answers)
    assert reading.voltage == pytest.approx(voltage)
    assert reading.current == pytest.approx(current)
    assert reading.power == pytest.approx(-voltage * current)
    if charge is None:
        assert reading.state_of_charge != reading.state_of_charge
    else:
        assert reading.state_of_charge == pytest.approx(charge)


@pytest.mark.parametrize(
    ("name", "data", "kmh", "step_kmh"),
    [
        ("bmw_i3", "0236", 56.6, 0.1),
        ("renault_zoe_ph1", "161C", 56.6, 0.01),
        ("renault_zoe_ph2", "161C", 56.6, 0.01),
        ("hyundai_kia", "00" * 29 + "39", 57.0, 1.0),
        ("obd2_speed", "39", 57.0, 1.0),
    ],
)
def test_speed_of_every_profile(name, data, kmh, step_kmh):
    _, (reading,) = decode(name, speed=data)
    assert reading.speed == pytest.approx(kmh / 3.6)
    assert reading.variance == pytest.approx((step_kmh / 3.6) ** 2 / 12)


def test_12_v_of_the_zoe():
    decoder, readings = decode("renault_zoe_ph2", auxiliary="0578")
    assert not readings and decoder.auxiliary_voltage == pytest.approx(14.0)


def test_every_profile_that_asks_has_its_vector():
    tested = {"hyundai_kia"}  # by frames, below
    for mark in test_battery_of_every_profile.pytestmark + test_speed_of_every_profile.pytestmark:
        tested |= {arguments[0] for arguments in mark.args[1]}
    assert tested == set(ASKING)


@pytest.mark.parametrize(
    ("frames", "voltage", "current", "charge"),
    [(KONA, 404.7, 0.0, 0.94), (EV6, 719.0, 1.4, 0.535)],
)
def test_published_frames_decode_as_a_log_would(frames, voltage, current, charge):
    bridge = CanBridge(load_profile("hyundai_kia"))
    readings = []
    for stamp, data in enumerate(frames.split()):
        readings += bridge.decode(CanFrame(stamp, 0x7EC, bytes.fromhex(data)))
    (reading,) = readings
    assert reading == BatteryReading(
        0, pytest.approx(voltage), pytest.approx(current), pytest.approx(charge)
    )
    assert bridge.status(8).frames == 9 and not bridge.status(8).dropped


def test_bolt_broadcasts_its_speed():
    bridge = CanBridge(load_profile("chevrolet_bolt"))
    (reading,) = bridge.decode(CanFrame(7, 0x3E9, bytes.fromhex("1388000000000000")))
    assert reading == SpeedReading(7, pytest.approx(50 * 0.44704), pytest.approx(1.7e-6, rel=0.1))


def test_an_id_that_the_profile_reads_is_not_asked(tmp_path):
    """Whatever the list of diagnostic ids says: the car itself sends there."""
    dbc = (CONFIG / "nissan_leaf.dbc").read_text()
    number = re.search(r"BO_ (\d+) (\w+)", dbc)
    (tmp_path / "mine.dbc").write_text(dbc.replace(f"BO_ {number[1]} ", f"BO_ {0x797} "))
    text = (CONFIG / "nissan_leaf.yaml").read_text().replace("nissan_leaf.dbc", "mine.dbc")
    assert f"message: {number[2]}" in text
    text = re.sub(r"(?ms)^state_of_charge:.*?(?=^\S|\Z)", "", text)
    text += """
requests: {twelve: {tx: 0x797, rx: 0x79A, read: 22 11 03, min_length: 1, period: 5}}
auxiliary_voltage: {request: twelve, first_byte: 0, type: u8, unit: V, valid: [0, 20]}
"""
    (tmp_path / "mine.yaml").write_text(text)
    assert "the car itself broadcasts 0x797" in refusal(tmp_path / "mine.yaml")
