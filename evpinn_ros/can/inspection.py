"""Contents of a bus: ids, rates, load, values, fitting profile; one pass, bounded memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
import math

from evpinn_ros.can.bus_load import frame_bits
from evpinn_ros.can.current_sign import CurrentSign
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.fit import MessageFit, ProfileEvidence, ProfileFit, contradiction, ranked
from evpinn_ros.can.frame import MOST_IDS, CanFrame
from evpinn_ros.can.poller import Poller
from evpinn_ros.can.profile import QUANTITIES, CanProfile
from evpinn_ros.signals.readings import (
    NANOSECONDS,
    BatteryReading,
    MotorReading,
    Reading,
    SpeedReading,
)

NO_ANSWER = "no_answer"


@dataclass(frozen=True, slots=True)
class IdStatus:
    """The traffic of one id."""

    can_id: int  # the id
    extended: bool  # whether it has 29 bits
    count: int  # frames
    period: float  # mean time from one to the next, s, NaN for a single one
    jitter: float  # its standard deviation, s, NaN for fewer than three frames
    age: float  # from the last one to the end, s
    lengths: Mapping[int, int]  # frames by bytes of data

    @property
    def rate(self) -> float:
        """Frames per second, NaN while the period is unknown or zero."""
        return 1.0 / self.period if self.period else math.nan


@dataclass(slots=True)
class ValueStatus:
    """The values of one signal: how many, and the newest, smallest and largest of them."""

    count: int = 0
    newest: float = math.nan
    lowest: float = math.inf
    highest: float = -math.inf

    def record(self, value: float) -> None:
        """Note one more value."""
        self.count, self.newest = self.count + 1, value
        self.lowest, self.highest = min(self.lowest, value), max(self.highest, value)


@dataclass(frozen=True, slots=True)
class ProfileReport:
    """Report of one profile on the traffic."""

    fit: ProfileFit  # how well it fits
    contradicted: str | None  # why it cannot be the right one, None while nothing says so
    # `speed` m/s, `voltage` V, `current` A, `state_of_charge` 0..1, where they came
    values: Mapping[str, ValueStatus]
    dropped: Mapping[str, int]  # values not used, by reason
    asks: bool  # some of its quantities must be asked for; only answers to others are seen here
    experimental: bool  # its sources disagree, so it is never the best
    sign: str | None  # what is wrong with the sign of the current, None while nothing is
    sign_decided: bool  # whether the car pulled away, braked or charged enough to judge that


@dataclass(frozen=True, slots=True)
class BusReport:
    """Report of a bus's contents."""

    duration: float  # from the first frame to the end, s
    frames: int  # all of them
    uncounted: int  # frames of ids beyond `MOST_IDS`
    # share of the bit rate that the frames take, 0..1, without stuffing bits and with the most of
    # them; NaN when no time passed
    load: tuple[float, float]
    ids: tuple[IdStatus, ...]  # in order
    profiles: tuple[ProfileReport, ...]  # best first

    @property
    def best(self) -> ProfileReport | None:
        """The profile that fits; None when none does."""
        first = next((each for each in self.profiles if not each.experimental), None)
        fits = first is not None and first.fit.holds and first.contradicted is None
        return first if fits else None


class Inspection:
    """Takes the frames of one bus, in order."""

    def __init__(self, profiles: Iterable[CanProfile], bitrate: float) -> None:
        """Compare with profiles; bitrate, bit/s, is what the load is a share of."""
        self._bitrate = bitrate
        self._ids: dict[tuple[int, bool], _Id] = {}
        self._frames = self._uncounted = 0
        self._bits = [0, 0]
        self._first_ns: int | None = None
        self._last_ns = 0
        self._candidates = [_Candidate(profile) for profile in profiles]

    def add_frame(self, frame: CanFrame) -> None:
        """Take a frame; never raises."""
        self._frames += 1
        if self._first_ns is None:
            self._first_ns = self._last_ns = frame.stamp_ns
        self._last_ns = max(self._last_ns, frame.stamp_ns)
        for index, bits in enumerate(frame_bits(len(frame.data), frame.extended)):
            self._bits[index] += bits
        key = (frame.can_id, frame.extended)
        if key in self._ids or len(self._ids) < MOST_IDS:
            self._ids.setdefault(key, _Id()).add_frame(frame)
        else:
            self._uncounted += 1
        for candidate in self._candidates:
            candidate.add_frame(frame)

    def report(self, end_ns: int | None = None) -> BusReport:
        """Findings so far; ages count to `end_ns`, or to the newest frame."""
        end_ns = self._last_ns if end_ns is None else end_ns
        first_ns = end_ns if self._first_ns is None else self._first_ns
        duration = (end_ns - first_ns) / NANOSECONDS
        possible = self._bitrate * duration
        low, high = (bits / possible if possible > 0 else math.nan for bits in self._bits)
        fits = [candidate.fit() for candidate in self._candidates]
        by_key = {candidate.key: candidate for candidate in self._candidates}
        return BusReport(
            duration=duration,
            frames=self._frames,
            uncounted=self._uncounted,
            load=(low, high),
            ids=tuple(traffic.status(*key, end_ns) for key, traffic in sorted(self._ids.items())),
            profiles=tuple(by_key[fit.profile].report(fit, fits) for fit in ranked(fits)),
        )


class _Id:
    """Counts, and follows mean and variance of the intervals (Welford)."""

    def __init__(self) -> None:
        self._lengths: Counter[int] = Counter()
        self._count = 0
        self._last_ns = 0
        self._mean = self._squares = 0.0

    def add_frame(self, frame: CanFrame) -> None:
        self._lengths[len(frame.data)] += 1
        if self._count:
            interval = (frame.stamp_ns - self._last_ns) / NANOSECONDS
            difference = interval - self._mean
            self._mean += difference / self._count
            self._squares += difference * (interval - self._mean)
        self._count += 1
        self._last_ns = frame.stamp_ns

    def status(self, can_id: int, extended: bool, end_ns: int) -> IdStatus:
        intervals = self._count - 1
        return IdStatus(
            can_id=can_id,
            extended=extended,
            count=self._count,
            period=self._mean if intervals else math.nan,
            jitter=math.sqrt(self._squares / (intervals - 1)) if intervals > 1 else math.nan,
            age=(end_ns - self._last_ns) / NANOSECONDS,
            lengths=dict(self._lengths),
        )


class _Candidate:
    """One profile, decoding the whole bus."""

    def __init__(self, profile: CanProfile) -> None:
        self.key, self._experimental = profile.key, profile.experimental
        self.evidence = ProfileEvidence(profile)
        self._keys = {rule.key for rule in profile.messages.values()}
        self._decoder = Decoder(profile, self.evidence)
        self._asks, self._asked = bool(profile.asked), _Asked(profile)
        self._values: dict[str, ValueStatus] = {}
        self._sign = CurrentSign()

    def add_frame(self, frame: CanFrame) -> None:
        for reading in self._readings(frame):
            self._sign.add_reading(reading)
            for name, value in _named_values(reading):
                self._values.setdefault(name, ValueStatus()).record(value)

    def _readings(self, frame: CanFrame) -> tuple[Reading, ...]:
        if self._asked.is_answer(frame):
            return self._asked.decode(frame)
        if (frame.can_id, frame.extended) in self._keys:
            return self._decoder.decode(frame)
        return ()

    def fit(self) -> ProfileFit:
        fit = self.evidence.fit()
        return replace(fit, messages=(*fit.messages, *self._asked.fits()))

    def report(self, fit: ProfileFit, fits: Iterable[ProfileFit]) -> ProfileReport:
        found = contradiction(fit, [each for each in fits if each.profile != fit.profile])
        return ProfileReport(
            fit=fit,
            contradicted=found.why if found is not None else None,
            values={name: replace(values) for name, values in self._values.items()},
            dropped=dict(self._decoder.dropped + self._asked.dropped),
            asks=self._asks,
            experimental=self._experimental,
            sign=self._sign.fault,
            sign_decided=self._sign.decided,
        )


class _Asked:
    """The quantities of a profile that a tester asked for while we listened."""

    def __init__(self, profile: CanProfile) -> None:
        self._poller = Poller(profile)
        self._units = {
            quantity: fields[-1].request.address.answers_from
            for quantity, fields in profile.asked.items()
            if quantity in QUANTITIES
        }
        self._frames: Counter[tuple[int, bool]] = Counter()
        self._good: Counter[str] = Counter()

    @property
    def dropped(self) -> Counter[str]:
        return self._poller.dropped

    def is_answer(self, frame: CanFrame) -> bool:
        return self._poller.is_answer(frame)

    def decode(self, frame: CanFrame) -> tuple[Reading, ...]:
        self._frames[frame.can_id, frame.extended] += 1
        readings = self._poller.decode(frame)
        for reading in readings:
            self._good.update(name for name, _ in _named_values(reading))
        return readings

    def fits(self) -> Iterator[MessageFit]:
        """An answer takes many frames: what counts against a quantity are values dropped.

        Ids of answers are the same in many cars. Frames that answer nothing we know speak of
        another one.
        """
        for quantity, unit in self._units.items():
            frames = self._frames[unit]
            good = self._good["voltage" if quantity == "battery" else quantity]
            bad = dict(self.dropped) if good else {NO_ANSWER: frames} if frames else {}
            yield MessageFit(quantity, unit[0], frames, good, bad, has_checksum=False)


def _named_values(reading: Reading) -> Iterable[tuple[str, float]]:
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
