"""A drive whose way and energy are known, and what a log of it gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime, timedelta
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pytest

from evpinn_ros.core.signals.admission import Admission
from evpinn_ros.core.signals.readings import DAY_NS, BatteryReading, SpeedReading
from evpinn_ros.logs.read_options import ReadOptions
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.sources import open_drive

START = datetime(2024, 3, 5, 7, 8, 9)
LONGEST_STEP = 15.0  # s; over more, nothing is known
FloatArray = NDArray[np.float64]


def crossed(names: str, kinds: Sequence[Any], cases: Sequence[Any]) -> pytest.MarkDecorator:
    """Each case in the first kind of log and, in turn, in one of the others; in all at night."""
    others = len(kinds) - 1
    rows = [
        pytest.param(kind, *(case if isinstance(case, tuple) else (case,)),
                     marks=() if at in (0, 1 + number % others) else pytest.mark.nightly)
        for number, case in enumerate(cases)
        for at, kind in enumerate(kinds)
    ]  # fmt: skip
    return pytest.mark.parametrize(f"kind,{names}", rows)


@dataclass(frozen=True)
class Drive:
    """Signals of a drive, SI; current and power positive while discharging; shape (n,)."""

    time: FloatArray
    speed: FloatArray
    voltage: FloatArray
    current: FloatArray
    odometer: FloatArray
    charge: FloatArray  # %

    @property
    def distance(self) -> float:
        """Way, m, but for holes."""
        return _integral(self.time, self.speed)

    @property
    def energy(self) -> float:
        """Energy out of the battery, J, but for holes."""
        return _integral(self.time, self.voltage * self.current)

    def rows(self, chosen: NDArray[np.intp]) -> Drive:
        """The drive in some of its moments."""
        return Drive(*(getattr(self, field.name)[chosen] for field in fields(Drive)))

    def bridged(self, first: int, after: int) -> Drive:
        """The drive with straight lines between two rows."""
        inside = slice(first, after + 1)
        values = {}
        for name in ("speed", "voltage", "current", "odometer", "charge"):
            values[name] = getattr(self, name).copy()
            values[name][inside] = np.linspace(*values[name][[first, after]], after + 1 - first)
        return replace(self, **values)


def simulated(
    count: int = 900, step: float = 1.0, mass: float = 2000.0, volts: float = 360.0, seed: int = 0
) -> Drive:
    """Stop and go in town and out of it; a car of this mass, kg, with a battery of these volts."""
    chance = np.random.default_rng(seed)
    time = step * np.arange(count)
    phases = chance.uniform(0.0, 2.0 * math.pi, 3)
    speed = 9.0 + 8.0 * np.sin(time / 9.0 + phases[0]) + 5.0 * np.sin(time / 23.0 + phases[1])
    speed = np.maximum(speed + 4.0 * np.sin(time / 140.0 + phases[2]), 0.0)
    wheels = speed * (mass * np.gradient(speed, time) + 0.11 * mass + 0.4 * speed**2)
    power: FloatArray = np.where(wheels > 0, wheels / 0.88, 0.6 * wheels) + 0.25 * mass
    resistance = volts / 4000.0
    voltage = volts - resistance * power / volts
    way = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))))
    charge = 80.0 - np.cumsum(power) * step / (30.0 * mass * 36.0)
    signals = (time, speed, voltage, power / voltage, 28_582_000.0 + way, charge)
    return Drive(*(np.asarray(signal, np.float64) for signal in signals))


def measured(source: Source) -> tuple[float, float]:
    """Way, m, and energy, J, of the readings of a source that are admitted."""
    signals: dict[str, list[tuple[int, float]]] = {"speed": [], "voltage": [], "current": []}
    for reading in filter(Admission().admits, source.readings()):
        if isinstance(reading, SpeedReading):
            signals["speed"].append((reading.stamp_ns, reading.speed))
        elif isinstance(reading, BatteryReading):
            for name, value in (("voltage", reading.voltage), ("current", -reading.current)):
                if math.isfinite(value):
                    signals[name].append((reading.stamp_ns, value))
    stamps, values = zip(*map(_signal, signals.values()), strict=True)
    volts = np.interp(stamps[2], stamps[1], values[1]) if stamps[1].size else np.nan
    return _integral(stamps[0], values[0]), _integral(stamps[2], volts * values[2])


def _signal(points: Sequence[tuple[int, float]]) -> tuple[FloatArray, FloatArray]:
    """Times since midnight, s, and values, shape (n,) each."""
    seconds = [stamp % DAY_NS / 1e9 for stamp, _ in points]
    return np.array(seconds, np.float64), np.array([value for _, value in points], np.float64)


def _integral(times: FloatArray, values: FloatArray) -> float:
    steps = np.diff(times)
    steps[steps > LONGEST_STEP] = 0.0
    return float((values[1:] + values[:-1]) @ steps) / 2 if times.size > 1 else math.nan


def opened(folder: Path, text: str | bytes, name: str = "drive.csv", **options: object) -> Source:
    """The table of a text."""
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    return open_drive(folder / name, 360.0, ReadOptions(**options))  # type: ignore[arg-type]


def date(seconds: float) -> str:
    """A date and time of the drive."""
    return (START + timedelta(seconds=seconds)).strftime("%Y-%m-%d %H:%M:%S")


Line = Callable[[float, float, float, float, float, float], str]


def table(header: str, drive: Drive, line: Line) -> str:
    """A table with a line for each moment: time, speed, volts, amperes, odometer and charge."""
    columns = (drive.time, drive.speed, drive.voltage, drive.current, drive.odometer, drive.charge)
    return (
        "\n".join([header, *(line(*map(float, row)) for row in zip(*columns, strict=True))]) + "\n"
    )
