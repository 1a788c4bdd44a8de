"""Fit of a profile to the traffic of a bus, and contradictions between the two.

A frame with new data is *good* if length, checksum, counter and range are valid and the value did
not jump, else *bad*; score = mean over messages of good / (good + bad). Motors are left out, as
not every car sends torque. A missing message counts 0, one without values 0.5. A profile is
*proven* if checksums of its own are valid: by chance one in 256 is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import math
from operator import itemgetter

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import MOTORS, CanProfile
from evpinn_ros.core.signals.readings import NANOSECONDS

SILENT_ON_FIT = "not_available"
JUMPED = "jumped"
JUMPS: Mapping[str, tuple[float, float]] = {
    "speed": (1.0, 15.0),
    **dict.fromkeys(("battery", "voltage"), (40.0, 100.0)),
}
"""Largest plausible change of a quantity's first signal: a step, and its growth per second. No
tyre allows 15 m/s^2; 500 A through 0.1 ohm are 50 V."""
SHORTEST_NS = NANOSECONDS // 10  # stamps of frames from one burst are unreliable

ENOUGH = 5  # frames before a message can fail or recover
RIGHT = 0.9  # share of good frames at which a failed message is plausible again
NEARLY_ALL = 0.99  # share that counts as all
ENOUGH_PROOF = 2  # valid checksums
MARGIN = 0.1  # by which the score of a better profile exceeds this one's
HOLDS = 0.5  # mean share of the received messages at which a profile is worth naming


@dataclass(slots=True)
class MessageFit:
    """Fit of the frames of one message, counted as they arrive."""

    quantity: str  # key of the profile's `messages`
    can_id: int  # of the message
    has_checksum: bool = False  # True if the checksum rule is known
    frames: int = 0  # frames received
    good: int = 0  # valid frames
    # invalid frames by reason: those of `Decoder`, and `jumped`
    bad: Counter[str] = field(default_factory=Counter)
    _data: bytes = b""  # of the newest frame with new data
    _value: float | None = None
    _stamp_ns: int = 0

    def add_good(self, frame: CanFrame, value: float) -> None:
        """Take a frame with a valid value of the quantity's first signal, SI."""
        self.frames += 1
        if frame.data == self._data and self.good:
            return
        if self._jumped(frame.stamp_ns, value):
            self.bad[JUMPED] += 1
        else:
            self.good += 1
        self._data, self._value, self._stamp_ns = frame.data, value, frame.stamp_ns

    def add_bad(self, frame: CanFrame, reason: str) -> None:
        """Take a frame that the decoder refused."""
        self.frames += 1
        if reason == SILENT_ON_FIT or (frame.data == self._data and self.bad):
            return
        self.bad[reason] += 1
        self._data = frame.data

    def restart(self) -> None:
        """Reset the counts, but keep the last value and payload."""
        self.frames = self.good = 0
        self.bad.clear()

    @property
    def share(self) -> float:
        """Share of good frames, 0..1."""
        total = self.good + self.bad.total()
        if not total:
            return 0.5 if self.frames else 0.0
        return self.good / total

    @property
    def fails(self) -> bool:
        """True if most frames are bad."""
        return self.bad.total() >= ENOUGH and self.share < 0.5

    @property
    def came_right(self) -> bool:
        """True if nearly all frames are good."""
        return self.good >= ENOUGH and self.share >= RIGHT

    @property
    def proven(self) -> bool:
        """True if the checksum is valid, too often for chance."""
        return self.has_checksum and self.good >= ENOUGH_PROOF and not self.fails

    def __str__(self) -> str:
        place = f"{self.quantity} (0x{self.can_id:X})"
        if not self.frames:
            return f"{place} was never received"
        if self.share >= NEARLY_ALL:
            return f"{place} holds"
        total = self.good + self.bad.total()
        if not total:
            return f"{place}: no values"
        reason, count = max(self.bad.items(), key=itemgetter(1))
        return f"{place}: {100 * count / total:.0f} % {reason}"

    def _jumped(self, stamp_ns: int, value: float) -> bool:
        elapsed_ns = stamp_ns - self._stamp_ns
        if self._value is None or elapsed_ns < 0:  # time went back, as when a log restarts
            return False
        step, rate = JUMPS.get(self.quantity, (math.inf, 0.0))
        seconds = max(elapsed_ns, SHORTEST_NS) / NANOSECONDS
        return abs(value - self._value) > step + rate * seconds


class ProfileFit:
    """Fit of one profile to the frames so far, counted by its decoder."""

    def __init__(self, profile: CanProfile) -> None:
        self.profile, self.name = profile.key, profile.name
        self.messages = [
            MessageFit(quantity, rule.key[0], rule.checksum is not None)
            for quantity, rule in profile.messages.items()
            if quantity not in MOTORS
        ]  # by quantity; none if the profile only asks, so that listening cannot judge it

    def restart(self) -> None:
        """Reset the counts, but keep the last values and payloads."""
        for message in self.messages:
            message.restart()

    @property
    def score(self) -> float:
        """Mean over the messages of the share of good frames, 0..1."""
        return _mean([message.share for message in self.messages])

    @property
    def holds(self) -> bool:
        """True if its received messages fit: a log may hold few of its ids."""
        return _mean([message.share for message in self.messages if message.frames]) > HOLDS

    @property
    def frames(self) -> int:
        """Frames of the profile's ids."""
        return sum(message.frames for message in self.messages)

    @property
    def proven(self) -> bool:
        """True if the checksum of a message is valid, too often for chance."""
        return any(message.proven for message in self.messages)

    @property
    def order(self) -> tuple[float, ...]:
        """Sort key, best last: score, then proof, then share of the traffic that it explains."""
        good = sum(message.good for message in self.messages)
        return self.score, float(self.proven), len(self.messages) if good else 0, good


def _mean(shares: Sequence[float]) -> float:
    return sum(shares) / len(shares) if shares else 0.0


@dataclass(frozen=True, slots=True)
class Contradiction:
    """Reason why a profile cannot be the right one."""

    wrong: frozenset[str]  # quantities of the messages that contradict it
    why: str  # the reason in words
    better: str | None  # key of a profile that fits better, or None


def ranked(fits: Iterable[ProfileFit]) -> list[ProfileFit]:
    """Fits, best first; fits of equal score in the order of their names."""
    by_name = sorted(fits, key=lambda fit: fit.profile)
    return sorted(by_name, key=lambda fit: fit.order, reverse=True)


def contradiction(checked: ProfileFit, others: Sequence[ProfileFit]) -> Contradiction | None:
    """Contradiction between the traffic and a profile, or None.

    A profile is contradicted if a message fails, unless its checksums prove it and no other
    profile explains the traffic better; or if its checksums are never valid but another's are.
    """
    holding = sorted((other for other in others if other.holds), key=lambda fit: fit.order)
    better = [other for other in holding if other.score >= checked.score + MARGIN]
    wrong = [message for message in checked.messages if message.fails]
    if wrong and (better or not checked.proven):
        return _contradiction(wrong, better)
    proven = [other for other in holding if other.proven]
    provable = any(message.has_checksum for message in checked.messages)
    if proven and checked.frames and provable and not checked.proven:
        return _contradiction([other for other in checked.messages if not other.proven], proven)
    return None


def _contradiction(wrong: Sequence[MessageFit], better: Sequence[ProfileFit]) -> Contradiction:
    quantities = frozenset(message.quantity for message in wrong)
    key = better[-1].profile if better else None
    return Contradiction(quantities, "; ".join(map(str, wrong)), key)
