import pytest

from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import load_profile
from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading

MS = 1_000_000


@pytest.fixture
def profile():
    return load_profile("nissan_leaf")


def drive(bridge, profile, start_ms, end_ms, *, speed=True):
    encoder = Encoder(profile)
    readings = []
    for time in range(start_ms, end_ms, 10):
        readings += bridge.decode(encoder.battery(BatteryReading(time * MS, 390.0, -20.0)))
        if speed and time % 20 == 0:
            readings += bridge.decode(encoder.speed(SpeedReading(time * MS, 10.0)))
    return readings


def test_receiving(profile):
    bridge = CanBridge(profile)
    assert len(drive(bridge, profile, 0, 1000)) == 150
    status = bridge.status(1000 * MS)
    assert status.ok and status.text == "receiving"
    assert status.frames == 150 and status.unknown_frames == 0 and not status.dropped
    assert status.signals["battery"].rate == pytest.approx(100)
    assert status.signals["speed"].rate == pytest.approx(50)
    assert status.signals["speed"].age == pytest.approx(0.02)
    assert status.signals["speed"].count == 50


def test_stale_after_ten_periods_and_back(profile):
    bridge, encoder = CanBridge(profile), Encoder(profile)
    for time in range(0, 8000, 10):
        bridge.decode(encoder.battery(BatteryReading(time * MS, 390.0, -20.0)))
        if time % 400 == 0 and time < 4000:
            bridge.decode(encoder.speed(SpeedReading(time * MS, 10.0)))
        if time == 7590:
            assert bridge.status(time * MS).ok
    status = bridge.status(8000 * MS)
    assert not status.ok and status.text == "no speed"
    assert status.signals["speed"].stale and not status.signals["battery"].stale
    bridge.decode(encoder.speed(SpeedReading(8000 * MS, 10.0)))
    assert bridge.status(8000 * MS).ok
    assert bridge.status(60_000 * MS).text == "no speed and no battery"


def test_a_quick_signal_may_be_a_second_late(profile):
    bridge = CanBridge(profile)
    drive(bridge, profile, 0, 1000)
    drive(bridge, profile, 1000, 1980, speed=False)
    assert bridge.status(1980 * MS).ok
    drive(bridge, profile, 1980, 2000, speed=False)
    assert bridge.status(2000 * MS).text == "no speed"


def test_another_bus(profile):
    bridge = CanBridge(profile)
    bridge.decode(CanFrame(0, 0x700, b""))
    status = bridge.status(0)
    assert "no frame of this profile" in status.text
    assert (status.frames, status.unknown_frames, status.unknown_ids) == (0, 1, 1)
