"""Drives as TeslaMate and OVMS publish them: topics and payloads, second by second."""

from __future__ import annotations

from functools import cache
import math
from pathlib import Path
from typing import NamedTuple

from evpinn_ros.core.signals.readings import BatteryReading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.sources import open_source

BAGS = Path(__file__).resolve().parents[3] / "bags"
VEHICLE = "tesla_model_3_lr"


class Second(NamedTuple):
    """One second of a drive: km/h, V, A (positive out of the battery)."""

    stamp_ns: int
    speed: float
    voltage: float
    current: float

    @property
    def power(self):
        """Power drawn, kW."""
        return self.voltage * self.current / 1000.0


@cache
def drive(name="urban", seconds=600):
    """The newest values of each second of a bundled drive."""
    seconds_sent: list[Second] = []
    speed = battery = None
    for reading in open_source(BAGS / name, load_vehicle(VEHICLE)).readings():
        if isinstance(reading, SpeedReading):
            speed = reading
        elif isinstance(reading, BatteryReading) and not math.isnan(reading.power):
            battery = reading
        if speed is None or battery is None:
            continue
        if not seconds_sent or reading.stamp_ns - seconds_sent[-1].stamp_ns >= 1_000_000_000:
            kmh = 3.6 * speed.speed
            seconds_sent.append(Second(reading.stamp_ns, kmh, battery.voltage, -battery.current))
        if len(seconds_sent) == seconds:
            break
    return tuple(seconds_sent)


def energy(seconds, digits=None):
    """Energy drawn, kWh, by the trapezoid; of power rounded to so many digits of a kW."""
    powers = [s.power if digits is None else round(s.power, digits) for s in seconds]
    return sum(
        (a + b) / 2 * (t.stamp_ns - s.stamp_ns) / 3.6e12
        for a, b, s, t in zip(powers, powers[1:], seconds, seconds[1:], strict=False)
    )


def _changed(sets):
    held: dict[str, str] = {}
    for stamp_ns, values in sets:
        yield stamp_ns, {t: text for t, text in values.items() if held.get(t) != text}
        held.update(values)


def as_teslamate(car="1", **of):
    """Each second's topics that changed: whole km/h and kW. The place always changes."""
    base = f"teslamate/cars/{car}"

    return _changed(
        (
            second.stamp_ns,
            {
                f"{base}/state": "driving",
                f"{base}/shift_state": "D",
                f"{base}/speed": str(round(second.speed)),
                f"{base}/power": str(round(second.power)),
                f"{base}/outside_temp": "18.5",
                f"{base}/usable_battery_level": "80",
                f"{base}/latitude": str(48.0 + 1e-5 * i),
            },
        )
        for i, second in enumerate(drive(**of))
    )


def as_ovms(car="CAR", **of):
    """Each second's metrics that were modified, as OVMS writes floats."""
    base = f"ovms/me/{car}/metric"

    return _changed(
        (
            second.stamp_ns,
            {
                f"{base}/v/e/on": "yes",
                f"{base}/v/p/speed": f"{second.speed:g}",
                f"{base}/v/b/voltage": f"{second.voltage:g}",
                f"{base}/v/b/current": f"{second.current:g}",
                f"{base}/v/b/soc": "80.0",
                f"{base}/v/p/latitude": f"{48.0 + 1e-5 * i:.6f}",
            },
        )
        for i, second in enumerate(drive(**of))
    )
