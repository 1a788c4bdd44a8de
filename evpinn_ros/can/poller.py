"""Asks a car for what it does not broadcast, politely: OBD-II, KWP2000 and UDS, reading alone.

Without a way to send, a poller listens: it understands the answers that another tester asked
for, and those in a log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
import math
import threading
import time

from evpinn_ros.can.answers import AnswerDecoder
from evpinn_ros.can.control_unit import ControlUnit, Send
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import CanProfile
from evpinn_ros.can.read_only import ReadOnlyGate
from evpinn_ros.can.request import Address, RequestRule
from evpinn_ros.can.restraint import Restraint
from evpinn_ros.signals.readings import Reading

LONGEST_SLEEP_S = 0.2
"""How long `run` may take to notice `stop`, and the end of a rest."""


@dataclass(frozen=True, slots=True)
class PollStatus:
    """One look at the poller, for diagnostics.

    Attributes:
        ok: asking, and nothing was refused for good.
        text: the state in a few words.
        counters: of every control unit together (see `ControlUnit`).
    """

    ok: bool
    text: str
    counters: Mapping[str, int]


class Poller:
    """One question at a time to each control unit of a profile.

    `run` is for a thread of its own, `push` for the thread that reads the bus; `stop` and
    `status` may be called from any other.

    Attributes:
        contradicted: set by who knows that this is another car: then nothing is asked.
    """

    def __init__(
        self,
        profile: CanProfile,
        send: Send | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare to ask, or to listen.

        Args:
            profile: what to ask.
            send: puts a frame on the bus; None to listen alone.
            clock: s, never goes back.
        """
        self.contradicted = False
        self._profile, self._clock = profile, clock
        self._decoder = AnswerDecoder(profile)
        self._restraint = Restraint()
        units: dict[Address, list[RequestRule]] = {}
        for request in profile.requests:
            units.setdefault(request.address, []).append(request)
        self._gate = None if send is None else ReadOnlyGate(units, send)
        transmit = None if send is None else self._transmit
        self._units = {
            address.answers_from: ControlUnit(address, requests, transmit)
            for address, requests in units.items()
        }
        self._changed = threading.Condition()
        self._stopped = threading.Event()

    def hears(self, frame: CanFrame) -> bool:
        """Whether the frame is (part of) an answer that the profile knows."""
        return (frame.can_id, frame.extended) in self._units

    def push(self, frame: CanFrame) -> tuple[Reading, ...]:
        """The readings that this frame completes; never raises."""
        with self._changed:
            now_s = self._clock()
            self._heard(now_s)
            self._restraint.answered()
            unit = self._units[frame.can_id, frame.extended]
            answer = unit.push(frame, now_s)
            readings = () if answer is None else self._decoder.push(answer)
            self._observe(readings, now_s)
            if answer is not None and not math.isnan(self._decoder.auxiliary_voltage):
                self._restraint.auxiliary(self._decoder.auxiliary_voltage, now_s)
            # The next question goes out at once, so that voltage and current are of one moment.
            unit.step(now_s, self._may_ask)
            self._changed.notify()
            return readings

    def note(self, readings: Iterable[Reading]) -> None:
        """Something else came over the bus, with what it said."""
        with self._changed:
            now_s = self._clock()
            self._heard(now_s)
            self._observe(readings, now_s)

    def run(self) -> None:
        """Ask until `stop`."""
        with self._changed:
            while not self._stopped.is_set():
                now_s = self._clock()
                next_s = min(unit.step(now_s, self._may_ask) for unit in self._units.values())
                self._changed.wait(min(max(next_s - now_s, 0.0), LONGEST_SLEEP_S))

    def stop(self) -> None:
        """Make `run` return, within a fifth of a second plus the driver's own time to send."""
        self._stopped.set()

    def status(self) -> PollStatus:
        """Whether it asks, why not, and the counters so far."""
        with self._changed:
            counters: Counter[str] = sum(
                (unit.counters for unit in self._units.values()), Counter()
            )
            retired = {
                name: why for unit in self._units.values() for name, why in unit.retired.items()
            }
            reason = self._restraint.reason
        if self._gate is None:
            text = (
                f"profile {self._profile.key} asks the car; "
                "poll:=true (evpinn run --poll) lets it send read requests"
            )
        elif self.contradicted:
            text = "stopped: the traffic contradicts the profile"
        elif reason is not None:
            text = f"stopped: {reason}; goes on when the bus wakes, or with a new start"
        elif retired:
            text = ", ".join(f"{name} refused: {why}" for name, why in retired.items())
        else:
            text = "asking"
        ok = self._gate is not None and self._may_ask and not retired
        return PollStatus(ok, text, dict(counters))

    @property
    def dropped(self) -> Counter[str]:
        """Values not used, by reason (see `AnswerDecoder`)."""
        return self._decoder.dropped

    @property
    def _may_ask(self) -> bool:
        return not self.contradicted and self._restraint.reason is None

    def _transmit(self, frame: CanFrame) -> bool:
        assert self._gate is not None
        now_s = self._clock()
        try:
            sent = self._gate(frame)
        except Exception:
            self._restraint.asked(now_s, sent=True)
            raise
        self._restraint.asked(now_s, sent)
        return sent

    def _heard(self, now_s: float) -> None:
        if self._restraint.heard(now_s):
            for unit in self._units.values():
                unit.revive()
            self._changed.notify()

    def _observe(self, readings: Iterable[Reading], now_s: float) -> None:
        for reading in readings:
            self._restraint.observe(reading, now_s)
