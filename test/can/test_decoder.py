from collections import Counter
import math

import pytest

from evpinn_ros.can.decoder import (
    ALONE_AFTER_NS,
    CHARGE_HOLD_NS,
    STUCK_AFTER,
    TORQUE_HOLD_NS,
    Decoder,
)
from evpinn_ros.can.frame import MOST_IDS, CanFrame
from evpinn_ros.can.profile import id_sum, load_profile, nissan_crc8
from evpinn_ros.core.signals.readings import BatteryReading, MotorReading, SpeedReading


def frame(can_id: int, payload: str, stamp_ns: int = 0, *, extended: bool = False) -> CanFrame:
    return CanFrame(stamp_ns, can_id, bytes.fromhex(payload), extended)


def tesla_speed(raw: int, counter: int = 0) -> CanFrame:
    """0x257 by hand: 12 bits at bit 12, counter at bit 8, sum of id and bytes in byte 0."""
    rest = ((raw << 4 | counter) & 0xFFFF).to_bytes(2, "little") + bytes(5)
    return CanFrame(0, 0x257, bytes([(0x57 + 0x02 + sum(rest)) & 0xFF]) + rest)


@pytest.fixture
def tesla():
    return Decoder(load_profile("tesla_model_3"))


@pytest.fixture
def leaf():
    return Decoder(load_profile("nissan_leaf"))


@pytest.mark.parametrize(("raw", "kmh"), [(1500, 80.0), (500, 0.0), (375, -10.0)])
def test_speed_of_model_3(tesla, raw, kmh):
    """1500 * 0.08 - 40 = 80 km/h; reverse is negative, and standstill exactly zero."""
    (reading,) = tesla.decode(tesla_speed(raw))
    assert isinstance(reading, SpeedReading)
    assert reading.speed == (pytest.approx(kmh / 3.6) if kmh else 0.0)
    assert reading.variance == pytest.approx((0.08 / 3.6) ** 2 / 12)


SPEED = tesla_speed(1500)
DROPPED = [
    (tesla_speed(4095), "not_available"),
    (CanFrame(0, 0x257, bytes([SPEED.data[0] ^ 1]) + SPEED.data[1:]), "bad_checksum"),
    *((frame(0x132, payload), "short_frame") for payload in ("", "98", "989467")),
    (frame(0x132, "FF" * 8), "out_of_range"),
    (frame(0x132, "7695EA2600000000"), "out_of_range"),  # the firmware of 2019
]


@pytest.mark.parametrize(("bad", "reason"), DROPPED)
def test_what_may_not_be_used_is_dropped_and_counted(tesla, bad, reason):
    assert tesla.decode(bad) == ()
    assert tesla.dropped == Counter({reason: 1})


@pytest.mark.parametrize("payload", ["989467000000", "9894670000000000", "98946700"])
def test_battery_of_model_3_also_when_shortened(tesla, payload):
    # 0x9498 = 38040: 380.40 V; 0x0067 = 103: -0.1 * 103 = -10.3 A discharge, so it charges
    (reading,) = tesla.decode(frame(0x132, payload, 5))
    assert isinstance(reading, BatteryReading)
    assert reading.stamp_ns == 5
    assert reading.voltage == pytest.approx(380.40)
    assert reading.current == pytest.approx(10.3)
    assert not tesla.dropped


def test_discharge_of_model_3_is_negative(tesla):
    # raw -200 in 15 bits is 0x7F38: -0.1 * -200 = +20 A discharge
    (reading,) = tesla.decode(frame(0x132, "9894387F0000"))
    assert reading.current == pytest.approx(-20.0)
    assert reading.power == pytest.approx(380.4 * 20.0)
    # Bit 31 is no part of the value.
    (reading,) = tesla.decode(frame(0x132, "989438FF0000"))
    assert reading.current == pytest.approx(-20.0)


def leaf_battery(current_raw: int, voltage_raw: int, counter: int = 0) -> CanFrame:
    """0x1DB by hand, most significant bit first."""
    data = bytearray(8)
    data[0:2] = ((current_raw & 0x7FF) << 5).to_bytes(2, "big")
    data[2:4] = (voltage_raw << 6).to_bytes(2, "big")
    data[6] = counter
    data[7] = nissan_crc8(0, bytes(data[:7]))
    return CanFrame(0, 0x1DB, bytes(data))


def test_crc8_against_a_polynomial_division():
    # The remainder of a single one, shifted by 8: the polynomial itself.
    assert nissan_crc8(0, b"\x01") == 0x85
    assert nissan_crc8(0, b"\x01\x85") == 0
    assert id_sum(0x257, b"\xff\x02") == (0x57 + 2 + 0xFF + 2) & 0xFF


def test_stuck_counter(leaf):
    decoded = [leaf.decode(leaf_battery(-141, 783, 2)) for _ in range(STUCK_AFTER + 3)]
    assert [bool(readings) for readings in decoded] == [True] * STUCK_AFTER + [False] * 3
    assert leaf.dropped == Counter(stuck_counter=3)
    assert leaf.decode(leaf_battery(-141, 783, 3))


def test_state_of_charge_comes_with_the_battery(leaf):
    assert math.isnan(leaf.decode(leaf_battery(0, 783))[0].state_of_charge)
    # 925 = 0b11_1001_1101: 92.5 %
    assert leaf.decode(frame(0x55B, "E740000000000000")) == ()
    (reading,) = leaf.decode(leaf_battery(0, 783, 1))
    assert reading.state_of_charge == pytest.approx(0.925)
    late = leaf_battery(0, 783, 2)
    (reading,) = leaf.decode(CanFrame(CHARGE_HOLD_NS + 1, late.can_id, late.data))
    assert math.isnan(reading.state_of_charge)


def test_unknown_ids_are_counted(tesla):
    assert tesla.decode(frame(0x700, "00")) == ()
    assert tesla.decode(frame(0x132, "989467000000", extended=True)) == ()
    assert tesla.unknown == Counter({0x700: 1, 0x132: 1})
    assert tesla.known == 0


def test_garbage_ids_fill_no_memory(tesla):
    for can_id in range(MOST_IDS + 10):
        tesla.decode(frame(can_id, "00", extended=True))
    assert (len(tesla.unknown), tesla.uncounted) == (MOST_IDS, 10)


def model_3_motor(can_id: int, axle_torque: int, stamp_ns: int) -> CanFrame:
    """0x108, 0x186 by hand: 13 bits at bit 27 of 2 N m at the axle, 100.0 rpm at bit 40."""
    rest = ((axle_torque // 2 & 0x1FFF) << 19 | 1000 << 32).to_bytes(7, "little")
    return CanFrame(stamp_ns, can_id, bytes([id_sum(can_id, rest)]) + rest)


def test_torque_of_two_motors_is_their_sum_and_waits_for_both(tesla):
    rear, front = 0x108, 0x186
    assert tesla.decode(model_3_motor(rear, 904, 0)) == ()
    assert tesla.decode(model_3_motor(front, -90, 10)) == ()
    (reading,) = tesla.decode(model_3_motor(rear, 904, 20))
    assert reading.torque == pytest.approx((904 - 90) / 9.04, rel=1e-4)
    assert reading.speed == pytest.approx(100 * 9.04 * 2 * math.pi / 60)
    assert tesla.decode(model_3_motor(rear, 904, TORQUE_HOLD_NS + 11)) == ()
    assert not tesla.dropped


def test_a_car_without_a_second_motor_has_the_torque_of_the_first(tesla):
    assert tesla.decode(model_3_motor(0x108, -904, 5)) == ()
    assert tesla.decode(model_3_motor(0x108, -904, ALONE_AFTER_NS)) == ()
    (reading,) = tesla.decode(model_3_motor(0x108, -904, ALONE_AFTER_NS + 6))
    assert reading.torque == pytest.approx(-100.0, rel=1e-4)


def test_no_torque_where_that_of_the_second_motor_cannot_be_read():
    decoder = Decoder(load_profile("tesla_model_s"))

    def motor(stamp_ns: int, counter: int) -> CanFrame:
        body = bytes((0, counter << 5, 0x90, 0x01, 0, 0x10, 0))
        return CanFrame(stamp_ns, 0x106, body + bytes([id_sum(0x106, body)]))

    assert decoder.decode(motor(0, 0)) == ()
    (reading,) = decoder.decode(motor(ALONE_AFTER_NS + 1, 1))
    assert reading == MotorReading(ALONE_AFTER_NS + 1, 100.0, pytest.approx(4096 * math.pi / 30))
    decoder.decode(frame(0x1D4, "0000000000000000", ALONE_AFTER_NS + 2))
    assert decoder.decode(motor(ALONE_AFTER_NS + 3, 2)) == ()
    assert decoder.decode(motor(10 * ALONE_AFTER_NS, 3)) == ()
