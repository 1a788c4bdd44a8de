"""Road and air: grade, density, wind, known auxiliary loads."""

from __future__ import annotations

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
from evpinn_ros.core.signals.track import NEVER, SignalTrack

SLOPE_STD = 0.015  # 1-sigma of the slope of roads, between a plain and hills
SLOPE_LENGTH = 300.0  # m, correlation length of the slope of roads
ALTITUDE_STD = 0.7  # m, 1-sigma of barometers and GNSS within such a length
ALTITUDE_STEP = 1.0  # m, least road between two altitudes that are used
ALTITUDE_LENGTH = 10.0  # m, correlation length of their errors
HEATED_BELOW = 20.0  # degrees Celsius outside; the room temperature of degree days (VDI 3807)
GRADE_WINDOW = 1.0  # s over which IMU pitch is averaged
STALE_AFTER = 10.0  # s without news, then the quantity counts as unknown
WIND_STALE_AFTER = 600.0  # s; weather stations report a mean of ten minutes
REFERENCE_CELSIUS = 20.0  # at which vehicle files state air density
KELVIN = 273.15
GAS_CONSTANT = 287.05  # J/(kg K), of dry air


def density_of_air(reference: float, celsius: Any, pascal: Any) -> Any:
    """Density of dry air, an ideal gas, kg/m^3; NaN takes the value of the vehicle file.

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
        load_known: whether the car ever reported it.
    """

    air_density: Any
    head_wind: Any
    celsius: Any
    load: Any
    load_known: Any


class _Latest:
    """Latest values of the quantities in readings of one kind, in order of stamps."""

    def __init__(self, width: int) -> None:
        self.stamps = np.array([NEVER])
        self._values = np.full((width, 1), np.nan)

    def extend(self, stamps: np.ndarray, values: np.ndarray) -> None:
        """Take the readings that follow: ns, shape (n,), and values, shape (fields, n)."""
        self.stamps = np.concatenate((self.stamps, stamps))
        self._values = np.concatenate((self._values, values[: len(self._values)]), axis=1)

    def forget_before(self, needed_ns: int) -> None:
        """Drop the values before the last one up to a moment."""
        first = int(self.stamps.searchsorted(needed_ns, side="right")) - 1
        if first > len(self.stamps) // 2:
            self.stamps, self._values = self.stamps[first:], self._values[:, first:]

    def at(self, moments: np.ndarray) -> tuple[np.ndarray, ...]:
        """Stamps, `NEVER` before the first, and latest values up to moments, (n,) each."""
        index = np.maximum(self.stamps.searchsorted(moments, side="right") - 1, 0)
        return self.stamps[index], *self._values[:, index]

    @property
    def is_known(self) -> bool:
        """True once there was a reading."""
        return bool(self.stamps[-1] != NEVER)


class Road:
    """Grade, air density and known loads at moments, from optional readings."""

    def __init__(self, grade_source: GradeSource, reference_density: float) -> None:
        """Take the air density, kg/m^3, of the vehicle file as that at `REFERENCE_CELSIUS`."""
        self._source = grade_source
        self._reference_density = reference_density
        self._celsius, self._pascal, self._wind = _Latest(1), _Latest(1), _Latest(1)
        self.forget()

    def forget(self) -> None:
        """Drop what may not be joined across a gap or a jump of time."""
        self._auxiliary = _Latest(2)
        self._pitch_ns, self._pitches = np.empty(0, np.int64), np.empty(0)  # of the last window
        self._pitch, self._slope = _Latest(1), _Latest(1)
        self._hill = _Hill()
        self.altitudes = SignalTrack(STALE_AFTER)
        self._odometer = self._height = 0.0  # m
        self._altitude = AltitudeDetector()
        self._placed_ns = NEVER  # up to here heights were given

    def extend(self, block: Block, stamps: np.ndarray, distances: np.ndarray) -> None:
        """Take the readings of a block, in order of stamps.

        Args:
            block: of readings.
            stamps: of its speeds, ns, shape (n,).
            distances: driven up to each, m, shape (n,).
        """
        kinds: Mapping[type[Reading], _Latest] = {
            TemperatureReading: self._celsius,
            PressureReading: self._pascal,
            WindReading: self._wind,
            AuxiliaryReading: self._auxiliary,
        }
        for kind, latest in kinds.items():
            if kind in block.rows:
                latest.extend(block.rows[kind].stamps, block.rows[kind].values)
        if GradeReading in block.rows:
            self._add_pitch(block.rows[GradeReading])
        altitudes = block.of_kind(AltitudeReading)
        if len(altitudes.stamps) or len(stamps):
            self._add_slopes(altitudes, stamps, distances)
            self.altitudes.extend(altitudes.stamps, altitudes.values[0])

    def forget_before(self, needed_ns: int) -> None:
        """Drop readings that no moment from `needed_ns` on rests on."""
        for latest in (self._celsius, self._pascal, self._wind, self._auxiliary, self._pitch,
                     self._slope):  # fmt: skip
            latest.forget_before(needed_ns)
        self.altitudes.forget_before(needed_ns)

    def _add_pitch(self, rows: Rows) -> None:
        """Take readings of pitch as the mean of the last `GRADE_WINDOW` at each."""
        stamps = np.concatenate((self._pitch_ns, rows.stamps))
        pitches = np.concatenate((self._pitches, rows.values[0]))
        begins = stamps.searchsorted(rows.stamps - int(GRADE_WINDOW * NANOSECONDS))
        sums, ends = np.append(0.0, pitches.cumsum()), np.arange(len(stamps))[-len(rows.stamps) :]
        means = (sums[ends + 1] - sums[begins]) / (ends + 1 - begins)
        self._pitch.extend(rows.stamps, means[None])
        self._pitch_ns, self._pitches = stamps[begins[-1] :], pitches[begins[-1] :]

    def _add_slopes(self, altitudes: Rows, stamps: np.ndarray, distances: np.ndarray) -> None:
        """Take altitudes as the slope of the road at each, with the distances between."""
        slopes, driven = [], distances.tolist()
        passed = stamps.searchsorted(altitudes.stamps, side="right").tolist()
        begin = 0
        for end, altitude in zip(passed, altitudes.values[0].tolist(), strict=True):
            self._hill.travel(driven[begin:end])
            self._hill.see(altitude)
            slopes.append(self._hill.slope)
            begin = end
        self._hill.travel(driven[begin:])
        self._slope.extend(altitudes.stamps, np.array([slopes]))

    def grades(self, moments: np.ndarray) -> np.ndarray:
        """Road incline angles, rad, 0 while unknown, shape (n,)."""
        grades = np.zeros(len(moments))
        if self._source in (GradeSource.AUTO, GradeSource.FIX) and self._slope.is_known:
            stamps, slopes = self._slope.at(moments)
            slope = np.arctan(slopes)
            known = (_age(moments, stamps) <= STALE_AFTER) & (np.abs(slope) < GRADE_LIMIT)
            grades = np.where(known, slope, 0.0)
        if self._source in (GradeSource.AUTO, GradeSource.IMU) and self._pitch.is_known:
            stamps, pitches = self._pitch.at(moments)
            grades = np.where(_age(moments, stamps) < STALE_AFTER, pitches, grades)
        return grades

    def conditions(self, moments: np.ndarray) -> Conditions:
        """The surroundings at moments, shape (n,) each; a temperature that is unknown is NaN.

        Heating that is reported on a warm day does not count: on five of six drives of an i3 above
        20 degrees the battery gave none of it; below, all of it.
        """
        wind_ns, winds = self._wind.at(moments)
        blows = _age(moments, wind_ns) <= WIND_STALE_AFTER
        load_ns, heating, others = self._auxiliary.at(moments)
        fresh = _age(moments, load_ns) <= STALE_AFTER
        celsius, pascal = self._celsius.at(moments)[1], self._pascal.at(moments)[1]
        return Conditions(
            density_of_air(self._reference_density, celsius, pascal),
            np.where(blows, winds, 0.0),
            celsius,
            load=np.where(fresh, others + np.where(celsius >= HEATED_BELOW, 0.0, heating), 0.0),
            load_known=load_ns != NEVER,
        )

    @property
    def shows_heights(self) -> bool:
        """True if there is any pitch or altitude."""
        return self._pitch.is_known or len(self.altitudes) > 0

    def heights(
        self, stamps: np.ndarray, odometers: np.ndarray
    ) -> Iterator[list[tuple[float, float]]]:
        """Yields, for each new moment, the new pairs of odometer and height of the road, m.

        While the IMU gives pitch, its integral replaces altitudes; these go on from its height.

        Args:
            stamps: of the moment before and n new ones, ns, increasing, shape (n + 1,).
            odometers: m, at these.
        """
        pitch_ns, pitches = self._pitch.at(stamps[1:])
        fresh = _age(stamps[1:], pitch_ns) < STALE_AFTER
        fresh &= self._source in (GradeSource.AUTO, GradeSource.IMU)
        seen_ns, altitudes = self.altitudes.stamps, self.altitudes.values.tolist()
        upto = seen_ns.searchsorted(stamps[1:], side="right")
        places = np.interp(seen_ns - stamps[0], stamps - stamps[0], odometers).tolist()
        if self._source not in (GradeSource.AUTO, GradeSource.FIX):
            upto = np.zeros_like(upto)
        rows = zip(
            fresh.tolist(), pitches.tolist(), stamps[1:].tolist(), odometers[1:].tolist(),
            upto.tolist(), strict=True,
        )  # fmt: skip
        placed = int(seen_ns.searchsorted(self._placed_ns, side="right"))
        for is_fresh, pitch, now_ns, odometer, last in rows:
            way, self._odometer = odometer - self._odometer, odometer
            if is_fresh:
                self._height += way * math.sin(pitch)
                self._altitude, self._placed_ns = AltitudeDetector(), now_ns
                placed = int(seen_ns.searchsorted(now_ns, side="right"))
                yield [(odometer, self._height)]
                continue
            first, placed = placed, max(last, placed)
            if first < last:
                self._placed_ns = int(seen_ns[last - 1])
            yield list(self._risen(places[first:last], altitudes[first:last]))

    def _risen(
        self, places: Sequence[float], altitudes: Sequence[float]
    ) -> Iterator[tuple[float, float]]:
        """Yields pairs of odometer and height, m, from altitudes at places, m."""
        for place, altitude in zip(places, altitudes, strict=True):
            self._altitude = self._altitude.after(place, altitude)
            rise = self._altitude.rise
            if rise is not None:
                yield rise.since, self._height  # not given yet where the altitude was stuck
                self._height += rise.height
                yield place, self._height

    def unknown(self, stamp_ns: int) -> tuple[str, ...]:
        """Which of grade, temperature, pressure, wind and loads have no data."""
        has_pitch = _age(stamp_ns, int(self._pitch.stamps[-1])) < STALE_AFTER
        given = {
            "grade": (has_pitch and self._source in (GradeSource.AUTO, GradeSource.IMU))
            or (
                not self._altitude.detected and self._source in (GradeSource.AUTO, GradeSource.FIX)
            ),
            "temperature": self._celsius.is_known,
            "pressure": self._pascal.is_known,
            "wind": self._wind.is_known,
            "loads": self._auxiliary.is_known,
        }
        return tuple(name for name, known in given.items() if not known)


class _Hill:
    """Slope of the road from altitudes: a Kalman filter along the road.

    The slope varies as that of roads does, by `SLOPE_STD` within `SLOPE_LENGTH`, so a single
    altitude weighs little: over the length of a car, the noise of a barometer looks like a cliff.
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
        """Update by an altitude, m; ignored within `ALTITUDE_STEP` of the last."""
        if math.isnan(self._altitude):
            self._altitude = altitude
            return
        if self._road < ALTITUDE_STEP:
            return
        miss = altitude - self._altitude
        if abs(miss) > LEAP + STEEPEST * self._road:
            self._altitude, self._road = altitude, 0.0  # the receiver got its fix: no slope
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
    """Absolute time between stamps, s; inf since `NEVER`."""
    return np.where(stamp_ns == NEVER, np.inf, abs(now_ns - stamp_ns) / NANOSECONDS)
