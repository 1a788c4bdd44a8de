"""Holds readings back while the traffic contradicts their profile.

Readings are held until the frames confirm the profile: at once if every speed and battery message
is valid, with a checksum; else after `DECIDE_NS`, or `DECIDE_LAST_NS` if only some are valid.
Then each second is judged anew; a refused profile resumes after ten seconds without contradiction.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from enum import Enum

from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.fit import Contradiction, ProfileFit, contradiction, ranked
from evpinn_ros.can.frame import BusId, CanFrame
from evpinn_ros.can.profile import CanProfile
from evpinn_ros.core.signals.readings import NANOSECONDS, MotorReading, Reading

DECIDE_NS = NANOSECONDS // 2
DECIDE_LAST_NS = 5 * NANOSECONDS
DECIDE_PATIENTLY_NS = 10 * NANOSECONDS
REVIEW_NS = NANOSECONDS
RESUME_NS = 10 * NANOSECONDS
REVIEW_FRAMES = 10  # frames of the profile; with fewer a review is postponed
# Quantities whose messages, if all are valid, confirm a profile at once:
LEADING = ("speed", "battery", "voltage", "current")
MOST_HELD = 10_000  # readings, in case all frames have one stamp


class ProfileVerdict(Enum):
    """Verdict on the profile."""

    UNDECIDED = "checking whether the profile fits"
    TRUSTED = "the profile fits"
    REFUSED = "the traffic contradicts the profile"


class FitGuard:
    """Filters the readings of one bus's decoder."""

    def __init__(
        self, profile: CanProfile, others: Iterable[CanProfile], *, patient: bool = False
    ) -> None:
        """Guard a profile; a `patient` guard always waits ten seconds first."""
        self.fit = ProfileFit(profile)  # counted by the decoder of this profile
        self.verdict = ProfileVerdict.UNDECIDED  # current verdict
        self.contradiction: Contradiction | None = None  # why readings are refused
        self.dropped: Counter[str] = Counter()  # readings: `undecided`, `contradicted`
        self._patient = patient
        self._period_ns = DECIDE_PATIENTLY_NS if patient else DECIDE_NS
        self._begin_ns: int | None = None
        self._held: list[Reading] = []
        self._comparing = True
        self._others: list[ProfileFit] = []
        self._decoders: dict[BusId, list[Decoder]] = {}
        for other in others:
            if other.key != profile.key:
                self._compare_with(other)

    def pass_on(self, frame: CanFrame, readings: tuple[Reading, ...]) -> tuple[Reading, ...]:
        """Readings to publish now that a frame was decoded to `readings`."""
        if self._comparing:
            for decoder in self._decoders.get(frame.key, ()):
                decoder.decode(frame)
        if self._begin_ns is None and self.fit.frames:
            self._begin_ns = frame.stamp_ns
        begin_ns = frame.stamp_ns if self._begin_ns is None else self._begin_ns
        due = not 0 <= frame.stamp_ns - begin_ns < self._period_ns
        if self.verdict is ProfileVerdict.UNDECIDED:
            return self._weigh(frame, readings, due)
        if due and self.fit.frames >= REVIEW_FRAMES:
            self._review(frame)
        return self.pass_answer(readings)

    def pass_answer(self, readings: tuple[Reading, ...]) -> tuple[Reading, ...]:
        """Readings of an answer to publish; it proves no profile, as it echoes the request."""
        if self.verdict is ProfileVerdict.REFUSED:
            self.dropped["contradicted"] += len(readings)
            return ()
        return readings

    def finish(self) -> tuple[Reading, ...]:
        """Decide about the readings still held at the end of the frames."""
        return self._decide() if self.verdict is ProfileVerdict.UNDECIDED else ()

    def advice(self) -> str | None:
        """Key of the other profile that fits the traffic best; None if none fits."""
        return next((fit.profile for fit in ranked(self._others) if fit.holds), None)

    @property
    def held(self) -> int:
        """Number of readings that wait for the decision."""
        return len(self._held)

    def _compare_with(self, other: CanProfile) -> None:
        fit = ProfileFit(other)
        decoder = Decoder(other, fit)
        self._others.append(fit)
        for key in {rule.key for rule in other.messages.values()}:
            self._decoders.setdefault(key, []).append(decoder)

    def _weigh(
        self, frame: CanFrame, readings: tuple[Reading, ...], due: bool
    ) -> tuple[Reading, ...]:
        self._held.extend(readings)
        full = len(self._held) >= MOST_HELD
        if not (due or full or (readings and self._is_plain())):
            return ()
        if not full and self._period_ns < DECIDE_LAST_NS and self._is_torn():
            self._period_ns += DECIDE_NS
            return ()
        released = self._decide()
        if self.verdict is ProfileVerdict.UNDECIDED:  # nothing to release yet: keep gathering
            self._begin_ns = frame.stamp_ns
        else:
            self._begin(frame)
        return released

    def _is_plain(self) -> bool:
        if self._patient:
            return False
        messages = [message for message in self.fit.messages if message.quantity in LEADING]
        plain = all(message.good and not message.bad for message in messages)
        return plain and any(message.has_checksum for message in messages)

    def _is_torn(self) -> bool:
        return any(
            message.bad and not (message.came_right or message.fails)
            for message in self.fit.messages
        )

    def _decide(self) -> tuple[Reading, ...]:
        contradiction = self._judge()
        held, self._held = tuple(self._held), []
        if contradiction is not None:
            self.dropped["undecided"] += len(held)
            self._refuse(contradiction)
            return ()
        # A motor proves nothing: in another car its id may pass a checksum by chance.
        if all(isinstance(reading, MotorReading) for reading in held):
            self.dropped["undecided"] += len(held)
            return ()
        self._trust()
        return held

    def _review(self, frame: CanFrame) -> None:
        messages, contradiction = self.fit.messages, self._judge()
        if contradiction is not None:
            self._refuse(contradiction)
        elif self.contradiction is not None:
            wrong = self.contradiction.wrong
            if all(message.came_right for message in messages if message.quantity in wrong):
                self._trust()
        # Others are decoded only if they can change the verdict: each costs as much as ours.
        spotless = self.fit.proven and not any(message.bad for message in messages)
        self._comparing = self.verdict is ProfileVerdict.REFUSED or not spotless
        self._begin(frame)

    def _judge(self) -> Contradiction | None:
        return contradiction(self.fit, self._others if self._comparing else [])

    def _refuse(self, contradiction: Contradiction) -> None:
        better = contradiction.better or self.advice()
        self.verdict = ProfileVerdict.REFUSED
        self.contradiction = replace(contradiction, better=better)

    def _trust(self) -> None:
        self.verdict, self.contradiction = ProfileVerdict.TRUSTED, None

    def _begin(self, frame: CanFrame) -> None:
        refused = self.verdict is ProfileVerdict.REFUSED
        self._period_ns = RESUME_NS if refused else REVIEW_NS
        self._begin_ns = frame.stamp_ns
        for fit in (self.fit, *self._others):
            fit.restart()
