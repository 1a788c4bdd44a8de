"""Road and air: grade, density, wind, known auxiliary loads."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.core.signals.block import Block, Rows
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
from evpinn_ros.core.signals.track import BEFORE, NEVER, SignalTrack

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


def density_of_air(reference: float, celsius: Any, pascal: Any) -> Any:
    """Density of dry air, an ideal gas, kg/m^3; what is NaN is that of the vehicle file.

    Args:
        reference: density that the vehicle file has at `REFERENCE_CELSIUS`, kg/m^3.
        celsius: temperatures, degrees Celsius, a number or an array.
        pascal: pressures, Pa, of the same shape.
    """
    kelvin = KELVIN + np.where(np.isnan(celsius), REFERENCE_CELSIUS, celsius)
    of_file = reference * (REFERENCE_CELSIUS + KELVIN) / kelvin
    return np.where(np.isnan(pascal), of_file, pascal / (GAS_CONSTANT * kelvin))


class GradeSource(str, Enum):
    """Source of grade. `auto` takes the IMU if there is one, else altitude, else none."""

    AUTO = "auto"
    NONE = "none"
    IMU = "imu"
    FIX = "fix"


class Conditions(NamedTuple):
    """Surroundings at a moment, or at n of them: shape (n,) each, where None is NaN.

    Attributes:
        air_density: kg/m^3.
        head_wind: wind against the car, m/s over ground; 0 while unknown.
        celsius: temperature outside, None while unknown.
        load: auxiliary power the car reports, W; 0 while unknown.
        load_known: whether it reports any.
        doubted_load: heating that it reports on a warm day, W, which is often not drawn.
    """

    air_density: Any
    head_wind: Any
    celsius: Any
    load: Any
    load_known: Any
    doubted_load: Any = 0.0


class _Told:
    """What readings of one kind told last, by places in the order of arrival."""

    def __init__(self, width: int) -> None:
        self.orders, self.stamps = np.array([BEFORE]), np.array([NEVER])
        self._values = np.full((width, 1), np.nan)

    def extend(self, rows: Rows) -> None:
        """Take what came."""
        self.orders = np.concatenate((self.orders, rows.order))
        self.stamps = np.concatenate((self.stamps, rows.stamps))
        self._values = np.concatenate((self._values, rows.values[: len(self._values)]), axis=1)

    def settle(self) -> None:
        """Take all as come before."""
        if len(self.orders) > 1:
            self.orders, self.stamps = np.array([BEFORE]), self.stamps[-1:]
            self._values = self._values[:, -1:]

    def at(self, by: np.ndarray) -> tuple[np.ndarray, ...]:
        """Stamps, `NEVER` before the first, and values told last by places, (n,) each."""
        index = self.orders.searchsorted(by, side="right") - 1
        return self.stamps[index], *self._values[:, index]

    @property
    def is_told(self) -> bool:
        """True once there was a reading."""
        return bool(self.stamps[-1] != NEVER)


class Road:
    """Grade, air density and known loads at moments, from optional readings.

    What is asked is asked by a place in the order of arrival (`signals.track`).
    """

    def __init__(self, grade_source: GradeSource, reference_density: float) -> None:
        """Take the air density, kg/m^3, of the vehicle file as that at `REFERENCE_CELSIUS`."""
        self._source = grade_source
        self._reference_density = reference_density
        self._celsius, self._pascal, self._wind = _Told(1), _Told(1), _Told(1)
        self.forget()

    def forget(self) -> None:
        """Drop what may not be joined across a gap or a jump of time."""
        self._auxiliary = _Told(2)
        self._window: deque[tuple[int, float]] = deque()  # of pitch
        self._sum = 0.0  # over it
        self._pitch, self._slope = _Told(1), _Told(1)
        self._hill = _Hill()
        self.altitudes = SignalTrack(STALE_AFTER)
        self._odometer = self._height = 0.0  # m
        self._altitude = AltitudeDetector()
        self._placed_ns = NEVER  # up to here heights were given

    def extend(self, block: Block, orders: np.ndarray, distances: np.ndarray) -> None:
        """Take readings of a block, and distances, m, that were driven by places in it.

        Altitudes come in the order of their stamps.
        """
        kinds: Mapping[type[Reading], _Told] = {
            TemperatureReading: self._celsius,
            PressureReading: self._pascal,
            WindReading: self._wind,
            AuxiliaryReading: self._auxiliary,
        }
        for kind, told in kinds.items():
            if kind in block.rows:
                told.extend(block.rows[kind])
        if GradeReading in block.rows:
            self._pitch.extend(self._mean_pitch(block.rows[GradeReading]))
        altitudes = block.of_kind(AltitudeReading)
        if not (len(altitudes.order) or len(orders)):
            return
        self._slope.extend(self._slopes(altitudes, orders, distances))
        self.altitudes.extend(altitudes.order, altitudes.stamps, altitudes.values[0])

    def insert(self, reading: AltitudeReading) -> None:
        """Take an altitude of any stamp between blocks."""
        rows = Block.of([reading]).rows[AltitudeReading]
        self._slope.extend(self._slopes(rows, np.empty(0), np.empty(0)))
        self._slope.settle()
        self.altitudes.insert(reading.stamp_ns, reading.altitude)

    def settle(self, needed_ns: int) -> None:
        """Take all as come before; see `SignalTrack.settle`."""
        for told in (self._celsius, self._pascal, self._wind, self._auxiliary, self._pitch,
                     self._slope):  # fmt: skip
            told.settle()
        self.altitudes.settle(needed_ns)

    def _mean_pitch(self, rows: Rows) -> Rows:
        """Readings of pitch as the mean of the last `GRADE_WINDOW`."""
        window, means = self._window, []
        for stamp_ns, grade in zip(rows.stamps.tolist(), rows.values[0].tolist(), strict=True):
            window.append((stamp_ns, grade))
            self._sum += grade
            oldest = stamp_ns - int(GRADE_WINDOW * NANOSECONDS)
            while not oldest <= window[0][0] <= stamp_ns:
                self._sum -= window.popleft()[1]
            if len(window) == 1:
                self._sum = grade  # nothing is left of rounding
            means.append(self._sum / len(window))
        return rows._replace(values=np.array([means]))

    def _slopes(self, altitudes: Rows, orders: np.ndarray, distances: np.ndarray) -> Rows:
        """Altitudes as the slope of the road once each is seen, with the distances between."""
        slopes, driven = [], distances.tolist()
        passed = np.searchsorted(orders, altitudes.order).tolist()
        begin = 0
        for end, altitude in zip(passed, altitudes.values[0].tolist(), strict=True):
            self._hill.travel(driven[begin:end])
            self._hill.see(altitude)
            slopes.append(self._hill.slope)
            begin = end
        self._hill.travel(driven[begin:])
        return altitudes._replace(values=np.array([slopes]))

    def grades(self, moments: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Road incline angles, rad, 0 while unknown, shape (n,)."""
        grades = np.zeros(len(moments))
        if self._source in (GradeSource.AUTO, GradeSource.FIX) and self._slope.is_told:
            stamps, slopes = self._slope.at(by)
            slope = np.arctan(slopes)
            known = (_age(moments, stamps) <= STALE_AFTER) & (np.abs(slope) < GRADE_LIMIT)
            grades = np.where(known, slope, 0.0)
        if self._source in (GradeSource.AUTO, GradeSource.IMU) and self._pitch.is_told:
            stamps, pitches = self._pitch.at(by)
            grades = np.where(_age(moments, stamps) < STALE_AFTER, pitches, grades)
        return grades

    def conditions(self, moments: np.ndarray, by: np.ndarray) -> Conditions:
        """The surroundings at moments, shape (n,) each; a temperature that is unknown is NaN.

        A heater that reports kilowatts on a warm day is not plausible: on five of six real drives
        above 20 degrees none of it was drawn, below all of it. So it is `doubted_load` there.
        """
        told_ns, winds = self._wind.at(by)
        blows = _age(moments, told_ns) <= WIND_STALE_AFTER
        told_ns, heating, others = self._auxiliary.at(by)
        fresh = _age(moments, told_ns) <= STALE_AFTER
        heating, others = np.where(fresh, heating, 0.0), np.where(fresh, others, 0.0)
        celsius, pascal = self._celsius.at(by)[1], self._pascal.at(by)[1]
        warm = celsius >= HEATED_BELOW
        return Conditions(
            density_of_air(self._reference_density, celsius, pascal),
            np.where(blows, winds, 0.0),
            celsius,
            load=others + np.where(warm, 0.0, heating),
            load_known=told_ns != NEVER,
            doubted_load=np.where(warm, heating, 0.0),
        )

    @property
    def shows_heights(self) -> bool:
        """True if any reading tells of the road's height."""
        return self._pitch.is_told or len(self.altitudes) > 0

    def heights(
        self, stamps: np.ndarray, odometers: np.ndarray, by: np.ndarray, passed: int, kept: int
    ) -> Iterator[list[tuple[float, float]]]:
        """Places, m by the odometer, and heights of the road there, m, that are new at moments.

        Altitudes stand at their own stamps, whenever they come; the integral of pitch stands in
        for them where the IMU gives them, and goes on from the last of them.

        Args:
            stamps: ns, increasing; of moments that passed before, and n new ones.
            odometers: m, at these.
            by: places in the order of arrival of the new ones, shape (n,).
            passed: how many passed before.
            kept: moments, the last included, among which altitudes find their place.
        """
        told_ns, pitches = self._pitch.at(by)
        fresh = _age(stamps[passed:], told_ns) < STALE_AFTER
        fresh &= self._source in (GradeSource.AUTO, GradeSource.IMU)
        seen_ns, altitudes = self.altitudes.stamps, self.altitudes.values.tolist()
        upto = seen_ns.searchsorted(stamps[passed:], side="right")
        upto = np.minimum(upto, self.altitudes.count(by))
        begins = stamps[np.maximum(np.arange(passed, len(stamps)) - (kept - 1), 0)]
        oldest = seen_ns.searchsorted(begins).tolist()
        places = np.interp(seen_ns - stamps[0], stamps - stamps[0], odometers).tolist()
        if self._source not in (GradeSource.AUTO, GradeSource.FIX):
            upto = np.zeros_like(upto)
        rows = zip(
            fresh.tolist(), pitches.tolist(), stamps[passed:].tolist(),
            odometers[passed:].tolist(), oldest, upto.tolist(), strict=True,
        )  # fmt: skip
        placed = int(seen_ns.searchsorted(self._placed_ns, side="right"))
        for is_fresh, pitch, now_ns, odometer, first, last in rows:
            way, self._odometer = odometer - self._odometer, odometer
            if is_fresh:
                self._height += way * math.sin(pitch)
                self._altitude, self._placed_ns = AltitudeDetector(), now_ns
                placed = int(seen_ns.searchsorted(now_ns, side="right"))
                yield [(odometer, self._height)]
                continue
            first, placed = max(first, placed), max(last, placed)
            if first < last:
                self._placed_ns = int(seen_ns[last - 1])
            yield list(self._risen(places[first:last], altitudes[first:last]))

    def _risen(
        self, places: Sequence[float], altitudes: Sequence[float]
    ) -> Iterator[tuple[float, float]]:
        """Places and heights that altitudes there tell, m."""
        for place, altitude in zip(places, altitudes, strict=True):
            self._altitude = self._altitude.after(place, altitude)
            rise = self._altitude.rise
            if rise is not None:
                yield rise.since, self._height  # not given yet where the altitude was stuck
                self._height += rise.height
                yield place, self._height

    def unknown(self, stamp_ns: int) -> tuple[str, ...]:
        """Those of grade, temperature, pressure, wind and loads that no input gives."""
        told_ns = int(self._pitch.stamps[-1])
        given = {
            "grade": _age(stamp_ns, told_ns) < STALE_AFTER or not self._altitude.detected,
            "temperature": self._celsius.is_told,
            "pressure": self._pascal.is_told,
            "wind": self._wind.is_told,
            "loads": self._auxiliary.is_told,
        }
        return tuple(name for name, known in given.items() if not known)


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

    def travel(self, distances: Sequence[float]) -> None:
        """Move on by distances, m, one after another."""
        if math.isnan(self._altitude):
            self._road += sum(distances)
            return
        for distance in distances:
            self._road += distance
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


def _age(now_ns: Any, stamp_ns: Any) -> Any:
    """Seconds between stamps; a stamp from the future is as far from now as an old one."""
    return abs(now_ns - stamp_ns) / NANOSECONDS
