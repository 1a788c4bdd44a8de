"""From answers to readings: the same checks and counts as for broadcast frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
import math

from evpinn_ros.can.control_unit import Answer
from evpinn_ros.can.decoder import CHARGE_HOLD_NS
from evpinn_ros.can.profile import ONLY_ASKED, CanProfile
from evpinn_ros.can.request import AnswerField
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading

PARTS = ("voltage", "current")
JOIN_NS = NANOSECONDS // 5
"""Voltage and current of two answers at most this far apart are of one moment. A pack's current
can change by 100 A in it, its voltage by 2 %; profiles ask for the voltage first, so that the
stamp, of the later answer, is the current's. What is farther apart, behind a slow adapter, are two
readings with stamps of their own."""


class AnswerDecoder:
    """Makes readings of the answers of one car; for one thread at a time.

    Attributes:
        dropped: values not used, by reason: `not_available`, `out_of_range`, `not_together` (the
            voltage or current beside one that is neither, in one answer).
        auxiliary_voltage: of the 12 V battery in the last answer, V, NaN when not in it.
    """

    def __init__(self, profile: CanProfile) -> None:
        self.dropped: Counter[str] = Counter()
        self.auxiliary_voltage = math.nan
        self._fields: dict[str, list[AnswerField]] = {}
        for fields in profile.asked.values():
            for field in fields:
                self._fields.setdefault(field.request.name, []).append(field)
        self._waiting: dict[str, tuple[int, float]] = {}
        self._charge_stamp_ns = 0
        self._charge = math.nan

    def decode(self, answer: Answer) -> tuple[Reading, ...]:
        """The readings that this answer makes or completes."""
        readings: list[Reading] = []
        values = self._values(answer)
        stamp_ns = answer.stamp_ns
        self.auxiliary_voltage, _ = values.get(ONLY_ASKED, (math.nan, math.nan))
        if "state_of_charge" in values:
            self._charge_stamp_ns, self._charge = stamp_ns, values["state_of_charge"][0]
        if "speed" in values:
            # A rounded number is off by a uniform error of one step: variance step^2 / 12.
            speed, step = values["speed"]
            readings.append(SpeedReading(stamp_ns, speed, step**2 / 12))
        asked = {field.signal.name for field in self._fields[answer.request.name]}
        if asked.issuperset(PARTS) and not values.keys() >= {*PARTS}:
            self.dropped["not_together"] += any(part in values for part in PARTS)
            return tuple(readings)
        for part in PARTS:
            if part in values:
                readings += self._late(stamp_ns, part)
                self._waiting[part] = stamp_ns, values[part][0]
        if len(self._waiting) == len(PARTS):
            found, self._waiting = self._waiting, {}
            readings.append(self._reading(found))
        return tuple(readings)

    def _values(self, answer: Answer) -> dict[str, tuple[float, float]]:
        """Value and step, SI, of each quantity in the answer that may be used."""
        values = {}
        for field in self._fields[answer.request.name]:
            raw = field.raw(answer.data)
            if reason := field.signal.refusal(raw):
                self.dropped[reason] += 1
            else:
                values[field.signal.name] = field.signal.value(raw), field.signal.resolution
        return values

    def _late(self, stamp_ns: int, part: str) -> list[BatteryReading]:
        """Reading of a value that waited for its other half in vain."""
        late = {
            name: at
            for name, at in self._waiting.items()
            if name == part or abs(stamp_ns - at[0]) > JOIN_NS
        }
        for name in late:
            del self._waiting[name]
        return [self._reading({name: at}) for name, at in late.items()]

    def _reading(self, parts: Mapping[str, tuple[int, float]]) -> BatteryReading:
        stamp_ns = max(at for at, _ in parts.values())
        fresh = abs(stamp_ns - self._charge_stamp_ns) <= CHARGE_HOLD_NS
        voltage, current = (parts.get(name, (0, math.nan))[1] for name in PARTS)
        charge = self._charge if fresh else math.nan
        return BatteryReading(stamp_ns, voltage, current, charge)
