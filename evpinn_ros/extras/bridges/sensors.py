"""Topics of a car's single numbers, and their discovery messages for Home Assistant.

Sources: home-assistant.io, "MQTT" and "MQTT sensor"; developers.home-assistant.io, "Sensor
entity".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import math
from typing import Any

from evpinn_ros import __version__
from evpinn_ros.replays.energy_metrics import MEANINGS

MEASUREMENT, INCREASING = "measurement", "total_increasing"


def number_at(document: Mapping[str, Any], path: tuple[str, ...]) -> float | None:
    """The finite number at a path of keys in a document, else None."""
    value: Any = document
    for key in path:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value if isinstance(value, int | float) and math.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Sensor:
    """One number of a document with a topic of its own, for Home Assistant."""

    document: str  # `power`, `energy`, ...
    path: tuple[str, ...]  # keys to the number in the document
    name: str  # for people
    unit: str | None  # in the spelling of Home Assistant, or None
    device_class: str | None  # of Home Assistant; None if none fits
    state_class: str | None = MEASUREMENT  # of Home Assistant; None without statistics
    digits: int = 1  # after the point
    diagnostic: bool = False  # True if it describes the car, not its drives

    @property
    def topic(self) -> str:
        """Topic, relative to that of the car."""
        return "/".join((self.document, *self.path))

    def text(self, document: Mapping[str, Any]) -> str:
        """The number as a payload, or "None", which Home Assistant shows as unknown."""
        number = number_at(document, self.path)
        return "None" if number is None else f"{number:.{self.digits}f}"


SENSORS = (
    Sensor("power", ("measured_w",), "Power", "W", "power", digits=0),
    Sensor("power", ("predicted_w",), "Predicted power", "W", "power", digits=0),
    Sensor("energy", ("drawn_kwh",), "Energy drawn", "kWh", "energy", INCREASING, 3),
    Sensor("energy", ("regenerated_kwh",), "Energy recovered", "kWh", "energy", INCREASING, 3),
    Sensor("energy", ("trip_kwh",), "Energy of this drive", "kWh", "energy", None, 3),
    Sensor("energy", ("trip_km",), "Distance of this drive", "km", "distance", None),
    Sensor("consumption", ("10",), "Consumption, last 10 km", "kWh/100km", None),
    Sensor("consumption", ("100",), "Consumption, last 100 km", "kWh/100km", None),
    Sensor("range", ("charge_percent",), "Charge", "%", "battery"),
    Sensor("range", ("range_km",), "Range", "km", "distance", digits=0),
    Sensor("range", ("lower_km",), "Range, at least", "km", "distance", digits=0),
    Sensor("range", ("upper_km",), "Range, at most", "km", "distance", digits=0),
    *(
        Sensor("breakdown", (part, "kwh"), f"This drive: {name}", "kWh", "energy", None, 3)
        for part, name in MEANINGS.items()
    ),
    Sensor("parameters", ("mass", "value"), "Mass", "kg", "weight", None, 0, True),
    Sensor("parameters", ("eta", "value"), "Efficiency", None, None, None, 3, True),
    Sensor("parameters", ("c_rr", "value"), "Rolling resistance", None, None, None, 4, True),
    Sensor("parameters", ("c_d", "value"), "Drag coefficient", None, None, None, 3, True),
    Sensor("parameters", ("p_aux", "value"), "Standing load", "W", "power", None, 0, True),
)


def discovery(
    prefix: str, base: str, status_topic: str, car: str, model: str
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Topic and content of a car's discovery messages; none if the prefix is empty."""
    device = f"evpinn_{car}"
    of_all = {
        "availability_topic": status_topic,
        "device": {
            "identifiers": [device],
            "name": f"EV-PINN {car}",
            "model": model,
            "manufacturer": "evpinn_ros",
            "sw_version": __version__,
        },
        "origin": {"name": "evpinn_ros", "sw_version": __version__},
    }
    for sensor in SENSORS if prefix else ():
        key = "_".join((sensor.document, *sensor.path))
        content = {
            "name": sensor.name,
            "unique_id": f"{device}_{key}",
            "state_topic": f"{base}/{sensor.topic}",
            "unit_of_measurement": sensor.unit,
            "device_class": sensor.device_class,
            "state_class": sensor.state_class,
            "suggested_display_precision": sensor.digits,
            "entity_category": "diagnostic" if sensor.diagnostic else None,
        }
        present = {name: value for name, value in content.items() if value is not None}
        yield f"{prefix}/sensor/{device}/{key}/config", present | of_all
