"""The bridge without ROS: decodes frames to readings and reports the health of the bus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
import time

from evpinn_ros.can.current_sign import CurrentSign
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.guard import FitGuard
from evpinn_ros.can.poller import Poller
from evpinn_ros.can.profile import CanProfile
from evpinn_ros.can.request import Send
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading

STALE_PERIODS = 10
PERIOD_WEIGHT = 0.05
SHORTEST_PERIOD_NS = NANOSECONDS // 10
"""Shorter periods count as this one: a busy computer may delay frames by almost a second."""
LONGEST_PERIOD_NS = NANOSECONDS
"""Longest period of a signal, also assumed until the period is known."""
WAITING = "waiting"
"""Text of a bridge before the first frame."""

_KINDS: Mapping[str, type[Reading]] = {"speed": SpeedReading, "battery": BatteryReading}


@dataclass(frozen=True, slots=True)
class SignalStatus:
    """Arrival of one quantity: count, rate, age."""

    count: int  # readings so far
    rate: float  # readings per second, NaN until two came
    age: float  # seconds since the last, NaN before the first
    stale: bool  # no reading for ten periods, or none ever


@dataclass(frozen=True, slots=True)
class BridgeStatus:
    """One look at the bridge, for diagnostics."""

    ok: bool  # every quantity of the profile arrives
    text: str  # the state, for people
    frames: int  # frames of the profile's ids
    unknown_frames: int  # frames of other ids
    unknown_ids: int  # number of other ids, up to `MOST_IDS`
    dropped: Mapping[str, int]  # unused values by reason (see `Decoder`)
    signals: Mapping[str, SignalStatus]  # `speed` and `battery`, if in the profile
    # why readings are refused; None while the traffic fits the profile
    refusal: str | None = None
    # fault of the sign of the current, by the other signals; None without one
    fault: str | None = None


class CanBridge:
    """Decodes the frames of one bus and watches over them; for one thread at a time."""

    def __init__(
        self,
        profile: CanProfile,
        send: Send | None = None,
        *,
        guard: FitGuard | None = None,
        sign: CurrentSign | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`send` allows requests, `guard` holds readings back, `sign` checks the current."""
        self._key, self._guard, self._sign = profile.key, guard, sign
        self._decoder = Decoder(profile, guard.fit if guard is not None else None)
        self._arrivals = {name: _Arrivals() for name in _KINDS if name in profile.quantities}
        self.poller = Poller(profile, send, clock) if profile.requests else None
        self._answers = 0

    def decode(self, frame: CanFrame) -> tuple[Reading, ...]:
        """The readings that a frame completes or releases; never raises."""
        if self.poller is not None and self.poller.is_answer(frame):
            self._answers += 1
            readings = self.poller.decode(frame)
            if self._guard is not None:
                readings = self._guard.pass_answer(readings)
        else:
            readings = self._decoder.decode(frame)
            if self.poller is not None:
                self.poller.note(frame, readings)
            if self._guard is not None:
                readings = self._guard.pass_on(frame, readings)
                if self.poller is not None:
                    self.poller.contradicted = self._guard.contradiction is not None
        return self._watched(readings)

    def finish(self) -> tuple[Reading, ...]:
        """The readings still held back when the frames end."""
        return self._watched(self._guard.finish()) if self._guard is not None else ()

    @property
    def better_profile(self) -> str | None:
        """Key of a profile that fits where this one is refused; None if none fits."""
        contradiction = self._guard.contradiction if self._guard is not None else None
        return None if contradiction is None else contradiction.better

    @property
    def refusal(self) -> str | None:
        """Reason why readings are refused, and a profile that fits; None if none are refused."""
        contradiction = self._guard.contradiction if self._guard is not None else None
        if contradiction is None:
            return None
        better = f"; '{self.better_profile}' fits better" if self.better_profile else ""
        return f"profile '{self._key}' contradicts the traffic: {contradiction.why}{better}"

    def _watched(self, readings: tuple[Reading, ...]) -> tuple[Reading, ...]:
        for reading in readings:
            if self._sign is not None:
                self._sign.add_reading(reading)
            for name, arrivals in self._arrivals.items():
                if isinstance(reading, _KINDS[name]):
                    arrivals.record(reading.stamp_ns)
        return readings

    def status(self, now_ns: int) -> BridgeStatus:
        """The state at `now_ns`, a time of the clock that stamped the frames."""
        signals = {name: arrivals.status(now_ns) for name, arrivals in self._arrivals.items()}
        stale = [name for name, signal in signals.items() if signal.stale]
        fault = self._sign.fault if self._sign is not None else None
        text = self.refusal or self._fault(signals) or fault
        return BridgeStatus(
            ok=not text and not stale,
            text=text or (f"no {' and no '.join(stale)}" if stale else "receiving"),
            frames=self._decoder.known + self._answers,
            unknown_frames=self._decoder.unknown.total() + self._decoder.uncounted,
            unknown_ids=len(self._decoder.unknown),
            dropped=dict(self._dropped),
            signals=signals,
            refusal=self.refusal,
            fault=fault,
        )

    def _fault(self, signals: Mapping[str, SignalStatus]) -> str | None:
        decoder, guard = self._decoder, self._guard
        if not decoder.known and not self._answers:
            if not decoder.unknown:
                return WAITING
            advice = guard.advice() if guard is not None else None
            better = f" '{advice}' fits" if advice else ""
            return f"no frame of this profile: another bus or car?{better}"
        if guard is not None and guard.held:
            return f"{guard.verdict.value}: {guard.held} readings held back"
        if self._dropped.total() > sum(signal.count for signal in signals.values()):
            return "most values are implausible: is the profile wrong?"
        return None

    @property
    def _dropped(self) -> Counter[str]:
        dropped = self._decoder.dropped
        if self.poller is not None:
            dropped = dropped + self.poller.dropped
        return dropped + self._guard.dropped if self._guard is not None else dropped


class _Arrivals:
    """Arrival times of the readings of one quantity, and their usual interval."""

    def __init__(self) -> None:
        self._count = 0
        self._last_ns: int | None = None
        self._period_ns = math.nan

    def record(self, stamp_ns: int) -> None:
        self._count += 1
        if self._last_ns is not None:
            # Average the intervals, at first with equal weight; a pause counts as one long period.
            clipped = min(max(stamp_ns - self._last_ns, 0), LONGEST_PERIOD_NS)
            intervals = self._count - 1
            if intervals == 1:
                self._period_ns = clipped
            else:
                weight = max(PERIOD_WEIGHT, 1 / intervals)
                self._period_ns += weight * (clipped - self._period_ns)
        self._last_ns = max(stamp_ns, self._last_ns or stamp_ns)

    def status(self, now_ns: int) -> SignalStatus:
        age_ns = math.nan if self._last_ns is None else now_ns - self._last_ns
        period_ns = self._period_ns if math.isfinite(self._period_ns) else LONGEST_PERIOD_NS
        patience_ns = STALE_PERIODS * max(period_ns, SHORTEST_PERIOD_NS)
        return SignalStatus(
            count=self._count,
            rate=NANOSECONDS / self._period_ns if self._period_ns else math.nan,
            age=age_ns / NANOSECONDS,
            stale=not age_ns <= patience_ns,  # NaN, before the first reading, is stale too
        )
