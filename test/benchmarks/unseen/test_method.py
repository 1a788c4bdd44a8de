"""Our own estimator as a method: the energy of its rows."""

import pytest

from benchmarks.unseen.method import OnlineChain
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle

POWER, LAST = 14e3, 60.5  # W; s of the last battery reading, half a second after a speed


def test_energy_counts_from_the_battery_s_last_reading():
    chain, energy = OnlineChain(load_vehicle("tesla_model_3_lr")), {}
    for half in range(2, 140):
        stamp_ns = half * NANOSECONDS // 2
        if half % 2 == 0:
            reading = SpeedReading(stamp_ns, 25.0)
        elif half / 2 <= LAST:
            reading = BatteryReading(stamp_ns, 350.0, -POWER / 350.0)
        else:
            continue
        for row in chain.add_reading(reading):
            energy[row.stamp_ns / NANOSECONDS] = row.energy
    for time in (60.0, 61.0, 62.0, 63.0):
        assert energy[time] == pytest.approx((time - LAST) * POWER, abs=0.15 * POWER)
