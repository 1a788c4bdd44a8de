"""Contents of a bus: ids, rates, load, values, fitting profile; one pass, bounded memory."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
import math

from evpinn_ros.can.current_sign import CurrentSign
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.fit import MessageFit, ProfileFit, contradiction, ranked
from evpinn_ros.can.frame import MOST_IDS, BusId, CanFrame
from evpinn_ros.can.poller import Poller
from evpinn_ros.can.profile import QUANTITIES, CanProfile
from evpinn_ros.core.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
)

NO_ANSWER = "no_answer"
STANDARD_BITS, EXTENDED_BITS = 34, 54
"""Bits of a data frame, except data, to which stuffing applies: header and checksum."""
FIXED_BITS = 13  # delimiters, acknowledgement, end of frame and interframe space: never stuffed
STUFF_EVERY = 4  # bits per stuff bit, at worst


@dataclass(slots=True)
class IdStatus:
    """The traffic of one id, with running mean and variance of its intervals (Welford)."""

    can_id: int  # the id
    extended: bool  # True if it has 29 bits
    count: int = 0  # frames
    lengths: Counter[int] = field(default_factory=Counter)  # frames by bytes of data
    last_ns: int = 0  # when the newest frame was received
    age: float = math.nan  # time from the newest frame to the end, s; set by the report
    _mean: float = 0.0
    _squares: float = 0.0

    def add_frame(self, frame: CanFrame) -> None:
        """Take the next frame."""
        self.lengths[len(frame.data)] += 1
        if self.count:
            interval = (frame.stamp_ns - self.last_ns) / NANOSECONDS
            difference = interval - self._mean
            self._mean += difference / self.count
            self._squares += difference * (interval - self._mean)
        self.count += 1
        self.last_ns = frame.stamp_ns

    @property
    def period(self) -> float:
        """Mean interval between frames, s; NaN for a single one."""
        return self._mean if self.count > 1 else math.nan

    @property
    def jitter(self) -> float:
        """Standard deviation of the interval, s; NaN for fewer than three frames."""
        return math.sqrt(self._squares / (self.count - 2)) if self.count > 2 else math.nan

    @property
    def rate(self) -> float:
        """Frames per second, NaN while the period is unknown or zero."""
        return 1.0 / self.period if self.period else math.nan


@dataclass(slots=True)
class ValueStatus:
    """The values of one signal: count, newest, smallest and largest."""

    count: int = 0
    newest: float = math.nan
    lowest: float = math.inf
    highest: float = -math.inf

    def record(self, value: float) -> None:
        """Note one more value."""
        self.count, self.newest = self.count + 1, value
        self.lowest, self.highest = min(self.lowest, value), max(self.highest, value)


class ProfileReport:
    """Report on one profile, which decodes the whole bus."""

    def __init__(self, profile: CanProfile) -> None:
        self.fit = ProfileFit(profile)  # fit to the traffic
        self._profile = profile
        self.contradicted: str | None = None  # why the profile is not that of the car
        # `speed` m/s, `voltage` V, `current` A, `state_of_charge` 0..1, of those received
        self.values: defaultdict[str, ValueStatus] = defaultdict(ValueStatus)
        self.asks = bool(profile.asked)  # only answers to other testers are seen here
        self.experimental = profile.experimental  # never the best: its sources disagree
        self._keys = {rule.key for rule in profile.messages.values()}
        self._decoder, self._poller = Decoder(profile, self.fit), Poller(profile)
        self._sign = CurrentSign()
        self._answers: Counter[BusId] = Counter()
        self._asked: list[tuple[MessageFit, BusId]] = []
        for quantity, fields in profile.asked.items():
            if quantity in QUANTITIES:
                unit = fields[-1].request.address.answers_from
                self._asked.append((MessageFit(quantity, unit[0]), unit))
        self.fit.messages += [message for message, _ in self._asked]

    def add_frame(self, frame: CanFrame) -> None:
        """Take a frame; never raises."""
        key = frame.key
        readings: tuple[Reading, ...] = ()
        if self._poller.is_answer(frame):
            self._answers[key] += 1
            readings = self._poller.decode(frame)
        elif key in self._keys:
            readings = self._decoder.decode(frame)
        for reading in readings:
            self._sign.add_reading(reading)
            for name, value in _named_values(reading):
                self.values[name].record(value)

    @property
    def quantities(self) -> dict[int, list[str]]:
        """Quantities read from each id, with the motor, which does not count for the fit."""
        read = {rule.key[0]: [name] for name, rule in self._profile.messages.items()}
        for message, (unit, *_) in self._asked:
            read.setdefault(unit, []).append(message.quantity)
        return read

    @property
    def dropped(self) -> Counter[str]:
        """Number of unused values by reason."""
        return self._decoder.dropped + self._poller.dropped

    @property
    def sign(self) -> str | None:
        """Fault of the sign of the current, None while there is none."""
        return self._sign.fault

    @property
    def sign_decided(self) -> bool:
        """True if the car pulled away, braked or charged enough to judge the sign."""
        return self._sign.decided

    def count_answers(self) -> None:
        """Update the fit of requested quantities; answers of foreign ids suggest another car."""
        for message, unit in self._asked:
            name = "voltage" if message.quantity == "battery" else message.quantity
            message.frames = self._answers[unit]
            message.good = self.values[name].count if name in self.values else 0
            lacking = Counter({NO_ANSWER: message.frames} if message.frames else {})
            message.bad = Counter(self._poller.dropped) if message.good else lacking


@dataclass(frozen=True, slots=True)
class BusReport:
    """Report of a bus's contents."""

    duration: float  # from the first frame to the end, s
    frames: int  # total number
    uncounted: int  # frames of ids beyond `MOST_IDS`
    # share of the bit rate that the frames take, 0..1, without and with most stuff bits; NaN if
    # no time passed
    load: tuple[float, float]
    ids: tuple[IdStatus, ...]  # in order of id
    profiles: tuple[ProfileReport, ...]  # best first

    @property
    def best(self) -> ProfileReport | None:
        """The profile that fits; None if none does."""
        first = next((profile for profile in self.profiles if not profile.experimental), None)
        fits = first is not None and first.fit.holds and first.contradicted is None
        return first if fits else None


class Inspection:
    """Takes the frames of one bus, in order."""

    def __init__(self, profiles: Iterable[CanProfile], bitrate: float) -> None:
        self._bitrate = bitrate
        self._ids: dict[BusId, IdStatus] = {}
        self._frames = self._uncounted = 0
        self._bits = [0, 0]
        self._first_ns: int | None = None
        self._last_ns = 0
        self._profiles = [ProfileReport(profile) for profile in profiles]

    def add_frame(self, frame: CanFrame) -> None:
        """Take a frame; never raises."""
        self._frames += 1
        if self._first_ns is None:
            self._first_ns = self._last_ns = frame.stamp_ns
        self._last_ns = max(self._last_ns, frame.stamp_ns)
        for index, bits in enumerate(frame_bits(len(frame.data), frame.extended)):
            self._bits[index] += bits
        key = frame.key
        if key in self._ids or len(self._ids) < MOST_IDS:
            self._ids.setdefault(key, IdStatus(*key)).add_frame(frame)
        else:
            self._uncounted += 1
        for profile in self._profiles:
            profile.add_frame(frame)

    def report(self, end_ns: int | None = None) -> BusReport:
        """Findings so far; ages count up to `end_ns`, or to the newest frame."""
        end_ns = self._last_ns if end_ns is None else end_ns
        first_ns = end_ns if self._first_ns is None else self._first_ns
        duration = (end_ns - first_ns) / NANOSECONDS
        possible = self._bitrate * duration
        low, high = (bits / possible if possible > 0 else math.nan for bits in self._bits)
        for traffic in self._ids.values():
            traffic.age = (end_ns - traffic.last_ns) / NANOSECONDS
        for profile in self._profiles:
            profile.count_answers()
        by_fit = {profile.fit: profile for profile in self._profiles}
        for fit, profile in by_fit.items():
            refused = contradiction(fit, [other for other in by_fit if other is not fit])
            profile.contradicted = refused.why if refused is not None else None
        return BusReport(
            duration=duration,
            frames=self._frames,
            uncounted=self._uncounted,
            load=(low, high),
            ids=tuple(traffic for _, traffic in sorted(self._ids.items())),
            profiles=tuple(by_fit[fit] for fit in ranked(by_fit)),
        )


def frame_bits(length: int, extended: bool) -> tuple[int, int]:
    """Bits of a classic CAN data frame, without and with the most stuff bits.

    Davis, Burns, Bril, Lukkien, Real-Time Systems 35, 2007, eq. 1.
    """
    stuffed = (EXTENDED_BITS if extended else STANDARD_BITS) + 8 * length
    return stuffed + FIXED_BITS, stuffed + FIXED_BITS + (stuffed - 1) // STUFF_EVERY


def _named_values(reading: Reading) -> Iterator[tuple[str, float]]:
    if isinstance(reading, SpeedReading):
        yield "speed", reading.speed
    elif isinstance(reading, BatteryReading):
        yield "voltage", reading.voltage
        yield "current", reading.current
        if not math.isnan(reading.state_of_charge):
            yield "state_of_charge", reading.state_of_charge
    elif isinstance(reading, MotorReading):
        yield "motor_torque", reading.torque
        if not math.isnan(reading.speed):
            yield "motor_speed", reading.speed
