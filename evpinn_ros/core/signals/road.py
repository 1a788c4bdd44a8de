"""Road and air: grade, density, wind, known auxiliary loads."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from enum import Enum
import math
from typing import NamedTuple

import numpy as np

from evpinn_ros.core.signals.height import LEAP, STEEPEST, AltitudeDetector
from evpinn_ros.core.signals.readings import (
    GRADE_LIMIT,
    NANOSECONDS,
    AltitudeReading,
    AuxiliaryReading,
    GradeReading,
    PressureReading,
    Reading,
    TemperatureReading,
    WindReading,
)
from evpinn_ros.core.signals.track import SignalTrack

SLOPE_STD = 0.015  # 1-sigma of the slope of roads, between a plain and hills
SLOPE_LENGTH = 300.0  # m of road over which slopes are alike
ALTITUDE_STD = 0.7  # m, 1-sigma of what barometers and GNSS stray by within such a length
ALTITUDE_STEP = 1.0  # m between altitudes that are looked at
ALTITUDE_LENGTH = 10.0  # m of road over which they stray alike
HEATED_BELOW = 20.0  # degrees Celsius outside; that of the room in degree days (VDI 3807)
GRADE_WINDOW = 1.0  # s over which IMU pitch is averaged
STALE_AFTER = 10.0  # s without news, then the quantity counts as unknown
WIND_STALE_AFTER = 600.0  # s; weather stations report a mean of ten minutes
REFERENCE_CELSIUS = 20.0  # at which vehicle files state air density
KELVIN = 273.15
GAS_CONSTANT = 287.05  # J/(kg K), of dry air


def density_of_air(reference: float, celsius: float | None, pascal: float | None) -> float:
    """Density of dry air, an ideal gas, kg/m^3; what is None is that of the vehicle file.

    Args:
        reference: density that the vehicle file has at `REFERENCE_CELSIUS`, kg/m^3.
        celsius: temperature, degrees Celsius.
        pascal: pressure, Pa.
    """
    kelvin = KELVIN + (REFERENCE_CELSIUS if celsius is None else celsius)
    if pascal is not None:
        return pascal / (GAS_CONSTANT * kelvin)
    return reference * (REFERENCE_CELSIUS + KELVIN) / kelvin


class GradeSource(str, Enum):
    """Source of grade. `auto` takes the IMU if there is one, else altitude, else none."""

    AUTO = "auto"
    NONE = "none"
    IMU = "imu"
    FIX = "fix"


class Conditions(NamedTuple):
    """Surroundings at a moment.

    Attributes:
        air_density: kg/m^3.
        head_wind: wind against the car, m/s over ground; 0 while unknown.
        celsius: temperature outside, None while unknown.
        load: auxiliary power the car reports, W; 0 while unknown.
        load_known: whether it reports any.
        doubted_load: heating that it reports on a warm day, W, which is often not drawn.
    """

    air_density: float
    head_wind: float
    celsius: float | None
    load: float
    load_known: bool
    doubted_load: float = 0.0


class Road:
    """Grade, air density and known loads at a moment, from optional readings."""

    def __init__(self, grade_source: GradeSource, reference_density: float) -> None:
        """Take the air density, kg/m^3, of the vehicle file as that at `REFERENCE_CELSIUS`."""
        self._source = grade_source
        self._reference_density = reference_density
        self._celsius: float | None = None
        self._pascal: float | None = None
        self._wind: WindReading | None = None
        self.forget()

    def forget(self) -> None:
        """Drop what may not be joined across a gap or a jump of time."""
        self._auxiliary: AuxiliaryReading | None = None
        self._pitch: deque[tuple[int, float]] = deque()
        self._hill = _Hill()
        self._altitude_ns: int | None = None
        self._altitudes = SignalTrack(STALE_AFTER)
        self._odometer = self._height = 0.0  # m
        self._altitude = AltitudeDetector()
        self._placed_ns = -(2**63)  # up to here heights were given

    def add_reading(self, reading: Reading) -> None:
        """Take a reading; those that are not of road, air or loads are passed over."""
        match reading:
            case TemperatureReading():
                self._celsius = reading.celsius
            case PressureReading():
                self._pascal = reading.pascal
            case WindReading():
                self._wind = reading
            case AuxiliaryReading():
                self._auxiliary = reading
            case GradeReading():
                self._pitch.append((reading.stamp_ns, reading.grade))
                oldest = reading.stamp_ns - int(GRADE_WINDOW * NANOSECONDS)
                while not oldest <= self._pitch[0][0] <= reading.stamp_ns:
                    self._pitch.popleft()
            case AltitudeReading():
                self._hill.see(reading.altitude)
                self._altitude_ns = reading.stamp_ns
                self._altitudes.add(reading.stamp_ns, reading.altitude)

    def travel(self, distance: float) -> None:
        """Move on by a distance, m."""
        self._hill.travel(distance)

    def grade(self, stamp_ns: int) -> float:
        """Road incline angle, rad, 0 while unknown."""
        if self._source in (GradeSource.AUTO, GradeSource.IMU) and self._fresh_pitch(stamp_ns):
            return float(np.mean([grade for _, grade in self._pitch]))
        if self._source in (GradeSource.AUTO, GradeSource.FIX):
            return self._altitude_grade(stamp_ns)
        return 0.0

    def conditions(self, stamp_ns: int) -> Conditions:
        """The surroundings at a moment.

        A heater that reports kilowatts on a warm day is not plausible: on five of six real drives
        above 20 degrees none of it was drawn, below all of it. So it is `doubted_load` there.
        """
        wind, loads = self._wind, self._auxiliary
        blows = wind is not None and _age(stamp_ns, wind.stamp_ns) <= WIND_STALE_AFTER
        fresh = loads is not None and _age(stamp_ns, loads.stamp_ns) <= STALE_AFTER
        heating, others = (loads.heating, loads.others) if loads and fresh else (0.0, 0.0)
        warm = self._celsius is not None and self._celsius >= HEATED_BELOW
        return Conditions(
            density_of_air(self._reference_density, self._celsius, self._pascal),
            wind.head if wind and blows else 0.0,
            self._celsius,
            load=others + heating * (not warm),
            load_known=loads is not None,
            doubted_load=heating * warm,
        )

    def heights(
        self, stamps: Sequence[int], odometers: Sequence[float]
    ) -> Iterator[tuple[float, float]]:
        """Places, m by the odometer, and heights of the road there, m, not yet given.

        Altitudes stand at their own stamps, whenever they come; the integral of pitch stands in
        for them where the IMU gives them, and goes on from the last of them.

        Args:
            stamps: ns, increasing, of moments up to now.
            odometers: m, at these.
        """
        step, self._odometer = odometers[-1] - self._odometer, odometers[-1]
        if self._source in (GradeSource.AUTO, GradeSource.IMU) and self._fresh_pitch(stamps[-1]):
            self._height += step * math.sin(self.grade(stamps[-1]))
            self._altitude, self._placed_ns = AltitudeDetector(), stamps[-1]
            yield odometers[-1], self._height
        elif self._source in (GradeSource.AUTO, GradeSource.FIX):
            since_ns = max(self._placed_ns, stamps[0] - 1)
            for stamp_ns in self._altitudes.within(since_ns, stamps[-1] + 1):
                place = float(np.interp(stamp_ns, stamps, odometers))
                self._altitude = self._altitude.after(place, self._altitudes.at(stamp_ns))
                self._placed_ns, rise = stamp_ns, self._altitude.rise
                if rise is not None:
                    yield rise.since, self._height  # not given yet where the altitude was stuck
                    self._height += rise.height
                    yield place, self._height

    def unknown(self, stamp_ns: int) -> tuple[str, ...]:
        """Those of grade, temperature, pressure, wind and loads that no input gives."""
        given = {
            "grade": self._fresh_pitch(stamp_ns) or not self._altitude.detected,
            "temperature": self._celsius is not None,
            "pressure": self._pascal is not None,
            "wind": self._wind is not None,
            "loads": self._auxiliary is not None,
        }
        return tuple(name for name, known in given.items() if not known)

    def _fresh_pitch(self, stamp_ns: int) -> bool:
        return bool(self._pitch) and _age(stamp_ns, self._pitch[-1][0]) < STALE_AFTER

    def _altitude_grade(self, stamp_ns: int) -> float:
        if self._altitude_ns is None or _age(stamp_ns, self._altitude_ns) > STALE_AFTER:
            return 0.0
        slope = math.atan(self._hill.slope)
        return slope if abs(slope) < GRADE_LIMIT else 0.0


class _Hill:
    """Slope of the road from altitudes: a Kalman filter along the road.

    The slope wanders as that of roads does, by `SLOPE_STD` within `SLOPE_LENGTH`, so altitudes are
    taken for no more than they are worth: over the length of a car any barometer finds cliffs.
    """

    def __init__(self) -> None:
        self._altitude = math.nan  # m, before the first
        self.slope = 0.0  # rise over run
        # Variances of altitude and slope, and their covariance: numbers, for 2 x 2 arrays take
        # five times as long.
        self._variance, self._joint, self._of_slope = ALTITUDE_STD**2, 0.0, SLOPE_STD**2
        self._road = 0.0  # m since the last altitude

    def travel(self, distance: float) -> None:
        """Move on by a distance, m."""
        self._road += distance
        if math.isnan(self._altitude):
            return
        self._altitude += distance * self.slope
        self._variance += distance * (2.0 * self._joint + distance * self._of_slope)
        self._joint += distance * self._of_slope
        self._of_slope += 2.0 * SLOPE_STD**2 * distance / SLOPE_LENGTH

    def see(self, altitude: float) -> None:
        """Take an altitude, m; those of one place add nothing."""
        if math.isnan(self._altitude):
            self._altitude = altitude
            return
        if self._road < ALTITUDE_STEP:
            return
        miss = altitude - self._altitude
        if abs(miss) > LEAP + STEEPEST * self._road:
            self._altitude, self._road = altitude, 0.0  # a receiver that found itself: no slope
            return
        noise = ALTITUDE_STD**2 * max(1.0, ALTITUDE_LENGTH / self._road)
        self._road = 0.0
        gain = self._variance / (self._variance + noise)
        turn = self._joint / (self._variance + noise)
        self._altitude, self.slope = self._altitude + gain * miss, self.slope + turn * miss
        self._of_slope -= turn * self._joint
        self._joint -= gain * self._joint
        self._variance -= gain * self._variance


def _age(now_ns: int, stamp_ns: int) -> float:
    """Seconds between two stamps; a stamp from the future is as far from now as an old one."""
    return abs(now_ns - stamp_ns) / NANOSECONDS
