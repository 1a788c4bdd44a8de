"""Makes readings of one car from single values that arrive irregularly or only on change.

Values within `BURST_NS`, and earlier ones that still hold, are one set of readings, stamped by the
first arrival if messages have no stamp. Any message of a car confirms its other values. A retained
value may be days old: it is used once the car sends it, a `LASTING` one once the car sends any.
"""

from __future__ import annotations

from collections.abc import Collection
import math

from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    BatteryReading,
    Reading,
    SpeedReading,
    TemperatureReading,
)
from evpinn_ros.extras.bridges.layouts import LASTING, Measurand, Parsed, Value

BURST_NS = 150_000_000  # a publisher sends all changes within some milliseconds
MOST_AHEAD_NS = 86_400 * NANOSECONDS
"""Clocks of cars are off by seconds or a time zone; a stamp further in the future is ignored."""
VARIANCE_OF_A_STEP = 1.0 / 12.0  # of rounding, per squared step
NAN = math.nan


class Snapshots:
    """Collects values of one car into sets of readings."""

    def __init__(self, nominal_voltage: float, *, on_change: bool) -> None:
        """With `on_change`, a value holds until the car sends another."""
        self._nominal_voltage, self._on_change = nominal_voltage, on_change
        self._held: dict[Measurand, Value] = {}
        self._burst_ns: int | None = None

    @property
    def due_ns(self) -> float:
        """Time, ns, from which on `flush` returns readings; infinite if no value waits."""
        return math.inf if self._burst_ns is None else self._burst_ns + BURST_NS

    def forget(self) -> None:
        """Forget values that may have changed while the connection was lost."""
        self._held = {
            quantity: held for quantity, held in self._held.items() if quantity in LASTING
        }
        self._burst_ns = None

    def add(self, parsed: Parsed, arrived_ns: int, *, retained: bool) -> list[Reading]:
        """Take a message, `retained` if the broker stored it; returns the completed readings."""
        if retained:
            if self._on_change:
                self._hold(parsed, LASTING)
            return []
        if not self._on_change:
            self._held.clear()
            self._hold(parsed)
            stamp_ns = parsed.stamp_ns or arrived_ns
            is_one = stamp_ns - arrived_ns < MOST_AHEAD_NS
            return self._readings(stamp_ns if is_one else arrived_ns)
        complete = self.flush(arrived_ns)
        if self._burst_ns is None:
            self._burst_ns = arrived_ns
        self._hold(parsed)
        return complete

    def flush(self, now_ns: int) -> list[Reading]:
        """Readings of the values that arrived together, once their burst is over."""
        if self._burst_ns is None or 0 <= now_ns - self._burst_ns < BURST_NS:
            return []
        stamp_ns, self._burst_ns = self._burst_ns, None
        return self._readings(stamp_ns)

    def _hold(self, parsed: Parsed, wanted: Collection[Measurand] = tuple(Measurand)) -> None:
        self._held |= {
            quantity: value for quantity, value in parsed.values.items() if quantity in wanted
        }

    def _value(self, quantity: Measurand) -> float:
        return self._held.get(quantity, Value()).value

    def _readings(self, stamp_ns: int) -> list[Reading]:
        if self._value(Measurand.ASLEEP) == 1.0:
            return self._asleep(stamp_ns)
        readings: list[Reading] = []
        if not math.isnan(celsius := self._value(Measurand.TEMPERATURE)):
            readings.append(TemperatureReading(stamp_ns, celsius))
        if not math.isnan(altitude := self._value(Measurand.ALTITUDE)):
            place = self._value(Measurand.LATITUDE), self._value(Measurand.LONGITUDE)
            readings.append(AltitudeReading(stamp_ns, altitude, *place))
        if not math.isnan(heating := self._value(Measurand.HEATING)):
            readings.append(AuxiliaryReading(stamp_ns, heating))
        battery = self._battery(stamp_ns)
        if battery is not None:
            readings.append(battery)
        speed = self._speed(stamp_ns)
        return readings if speed is None else [*readings, speed]

    def _asleep(self, stamp_ns: int) -> list[Reading]:
        """The charge alone: other values of a parked car are old, or belong to the charger."""
        for quantity in (Measurand.SPEED, Measurand.POWER, Measurand.CURRENT, Measurand.VOLTAGE):
            self._held.pop(quantity, None)
        charge = self._value(Measurand.CHARGE)
        return [] if math.isnan(charge) else [BatteryReading(stamp_ns, NAN, NAN, charge)]

    def _speed(self, stamp_ns: int) -> SpeedReading | None:
        if self._value(Measurand.STANDING) == 1.0:  # TeslaMate sends no speed of a parked car
            return SpeedReading(stamp_ns, 0.0)
        speed, step = self._held.get(Measurand.SPEED, Value())
        has_speed = not math.isnan(speed)
        return SpeedReading(stamp_ns, speed, VARIANCE_OF_A_STEP * step**2) if has_speed else None

    def _battery(self, stamp_ns: int) -> BatteryReading | None:
        volt, current = self._value(Measurand.VOLTAGE), self._value(Measurand.CURRENT)
        power, charge = self._value(Measurand.POWER), self._value(Measurand.CHARGE)
        power_std = math.nan
        if math.isnan(current) and not math.isnan(power):
            volt = volt if volt > 0.0 else self._nominal_voltage
            current = -power / volt
            power_std = math.sqrt(VARIANCE_OF_A_STEP) * self._held[Measurand.POWER].step
        if all(map(math.isnan, (volt, current, charge))):
            return None
        return BatteryReading(stamp_ns, volt, current, charge, power_std)


def is_due(last_ns: int, now_ns: int, period_ns: int) -> bool:
    """Whether a period has passed since `last_ns`, or the clock was set back."""
    return not 0 <= now_ns - last_ns < period_ns
