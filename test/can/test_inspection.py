from functools import cache
import math

import pytest

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.inspection import MOST_IDS, Inspection, frame_bits
from evpinn_ros.can.profile import MOTORS
from test.can.conftest import ALL, KONA, PROFILES

pytestmark = pytest.mark.slow

MS = 1_000_000


@pytest.fixture(scope="module")
def reports(bus):
    """The report of each profile's bus."""
    return cache(lambda name: inspected(bus(name)).report())


def inspected(frames, bitrate=500_000):
    inspection = Inspection(PROFILES.values(), bitrate)
    for frame in frames:
        inspection.add_frame(frame)
    return inspection


@pytest.mark.parametrize("name", sorted(PROFILES))
def test_the_own_profile_of_every_simulated_bus_comes_first(name, reports):
    report = reports(name)
    own = next(profile for profile in report.profiles if profile.fit.profile == name)
    assert own.fit.score == report.best.fit.score and own.contradicted is None
    heard = [message for message in own.fit.messages if message.frames]
    assert len(heard) == len({*PROFILES[name].messages} - {*MOTORS})
    assert all(message.share > 0.99 for message in heard)
    assert own.sign is None


def test_rates_jitter_ages_and_lengths():
    frames = [CanFrame(10 * MS * i + (i % 2) * MS, 0x100, bytes(8 - i % 2)) for i in range(101)]
    frames.append(CanFrame(500 * MS, 0x18DAF110, b"", True))
    frames.sort(key=lambda frame: frame.stamp_ns)
    fast, once = inspected(frames).report(3000 * MS).ids
    assert (fast.can_id, fast.extended, fast.count) == (0x100, False, 101)
    assert fast.period == pytest.approx(0.01) and fast.rate == pytest.approx(100)
    assert fast.jitter == pytest.approx(0.001, rel=0.02)
    assert fast.age == pytest.approx(2.0) and fast.lengths == {8: 51, 7: 50}
    assert (once.can_id, once.extended, once.age) == (0x18DAF110, True, 2.5)
    assert math.isnan(once.period) and math.isnan(once.rate) and math.isnan(once.jitter)


def test_load_of_a_full_bus():
    # 111 bits without stuffing, 135 with the most (Davis et al., table of section 3).
    assert frame_bits(8, extended=False) == (111, 135)
    assert frame_bits(8, extended=True) == (131, 160)
    assert frame_bits(0, extended=False) == (47, 55)
    frames = [CanFrame(i * MS, 0x100, bytes(8)) for i in range(1001)]
    low, high = inspected(frames, bitrate=135_000).report().load
    assert low == pytest.approx(111 / 135, rel=0.01) and high == pytest.approx(1.0, rel=0.01)


def test_ids_without_end_do_not_fill_the_memory():
    frames = (CanFrame(i, i, b"", True) for i in range(MOST_IDS + 100))
    report = inspected(frames).report()
    assert len(report.ids) == MOST_IDS and report.uncounted == 100


def test_what_another_tester_asks_for_is_told():
    inspection = Inspection(ALL, 500_000)
    for stamp, data in enumerate(KONA.split() * 3):
        inspection.add_frame(CanFrame(stamp * 10 * MS, 0x7EC, bytes.fromhex(data)))
    best = inspection.report().best
    assert best.fit.profile == "hyundai_kia" and best.asks
    assert best.values["voltage"].newest == pytest.approx(404.7)
    speed, battery, charge = best.fit.messages
    assert (speed.frames, battery.frames, battery.good, charge.good) == (0, 27, 3, 3)
