"""A log of several drives, and charging, becomes its drives."""

from dataclasses import replace

from benchmarks.unseen.drives import UnseenDrive
from benchmarks.unseen.splitting import split
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading


def standing(start_ns: int, seconds: float, current: float):
    for index in range(int(seconds / 5)):
        stamp_ns = start_ns + index * 5 * NANOSECONDS
        yield SpeedReading(stamp_ns, 0.0)
        yield BatteryReading(stamp_ns, 360.0, current)


def later(drive: UnseenDrive, seconds: float):
    return [
        replace(each, stamp_ns=each.stamp_ns + int(seconds * NANOSECONDS))
        for each in drive.readings
    ]


def test_a_pause_and_charging_end_a_drive(make_drive):
    drive = make_drive(300.0, period=5.0)
    charging = list(standing(drive.start_ns + 305 * NANOSECONDS, 400.0, 9.0))
    readings = [*drive.readings, *charging, *later(drive, 800.0), *later(drive, 5000.0)]
    found = list(split(readings))
    assert [UnseenDrive("", part).duration for part in found] == [295.0, 295.0, 295.0]
    assert not set(charging) & {each for part in found for each in part}


def test_waiting_at_a_light_does_not(make_drive):
    drive = make_drive(300.0, period=5.0)
    waiting = list(standing(drive.start_ns + 305 * NANOSECONDS, 400.0, -2.0))
    readings = [*drive.readings, *waiting, *later(drive, 800.0)]
    assert list(split(readings)) == [tuple(readings)]
