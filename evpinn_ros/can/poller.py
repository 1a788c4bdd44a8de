"""Requests values that a car does not broadcast, by OBD-II, KWP2000 and UDS.

Without `send` it only decodes the answers to the requests of another tester.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
import math
import threading
import time

from evpinn_ros.can.decoder import AnswerDecoder
from evpinn_ros.can.frame import BusId, CanFrame
from evpinn_ros.can.profile import ONLY_ASKED, CanProfile
from evpinn_ros.can.read_only import ReadOnlyGate
from evpinn_ros.can.request import Address, RequestRule, Send
from evpinn_ros.can.restraint import Leave, Restraint
from evpinn_ros.core.signals.readings import Reading

LISTEN_FIRST_S = 1.0
"""Time to listen before the first request, to detect other senders on its id."""

ECHO_S = 1.0
"""Longest delay with which an adapter may echo a frame of ours."""

LONGEST_SLEEP_S = 0.2
"""Longest sleep of `run`, and so its delay to see `stop` or the end of a pause."""


@dataclass(frozen=True, slots=True)
class PollStatus:
    """One look at the poller, for diagnostics."""

    ok: bool  # requests are sent, and none was refused for good
    text: str  # the state, for people
    counters: Mapping[str, int]  # sums over all control units (see `ControlUnit`)


class Poller:
    """Sends one request at a time to each control unit of a profile; `run` needs a thread."""

    def __init__(
        self,
        profile: CanProfile,
        send: Send | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare to send requests, or only to listen if `send` is None."""
        # Imported here: without requests neither ISO-TP nor UDS is needed.
        from evpinn_ros.can.control_unit import ControlUnit

        self.contradicted = False  # True if the profile is not that of the car: no requests
        self._profile, self._clock = profile, clock
        self._decoder = AnswerDecoder(profile)
        self._restraint = Restraint()
        self._names = frozenset(request.name for request in profile.requests)
        auxiliary = profile.asked.get(ONLY_ASKED, ())
        self._auxiliary = frozenset(field.request.name for field in auxiliary)
        self._begun_s: float | None = None
        self._shared_id: int | None = None
        units: dict[Address, list[RequestRule]] = {}
        for request in profile.requests:
            units.setdefault(request.address, []).append(request)
        self._asked_ids = {(unit.tx_id, unit.extended) for unit in units if send is not None}
        self._sent_s: dict[tuple[BusId, bytes], float] = {}
        self._gate = None if send is None else ReadOnlyGate(profile.requests, send, clock)
        transmit = None if send is None else self._transmit
        self._units = {
            address.answers_from: ControlUnit(address, requests, transmit)
            for address, requests in units.items()
        }
        self._changed = threading.Condition()
        self._stopped = threading.Event()

    def is_answer(self, frame: CanFrame) -> bool:
        """True if the frame is (part of) an answer to a request of the profile."""
        return frame.key in self._units

    def decode(self, frame: CanFrame) -> tuple[Reading, ...]:
        """The readings that this frame completes; never raises."""
        with self._changed:
            now_s = self._clock()
            self._record_traffic(frame, now_s)
            unit = self._units[frame.key]
            answers = unit.answers
            answer = unit.receive(frame, now_s)
            if unit.answers > answers:
                self._restraint.answered()
            readings = () if answer is None else self._decoder.decode(answer)
            self._observe(readings, now_s)
            if answer is not None and not math.isnan(self._decoder.auxiliary_voltage):
                self._restraint.auxiliary(self._decoder.auxiliary_voltage, now_s)
            # Send the next request at once, so that voltage and current are of one moment.
            unit.step(now_s, self._may_ask(now_s))
            self._changed.notify()
            return readings

    def note(self, frame: CanFrame, readings: Iterable[Reading]) -> None:
        """Note a frame that is no answer, with its readings."""
        with self._changed:
            now_s = self._clock()
            self._record_traffic(frame, now_s)
            self._observe(readings, now_s)

    def run(self) -> None:
        """Send each request in its turn, in this thread, until `stop` is called."""
        with self._changed:
            while not self._stopped.is_set():
                self._changed.wait(min(max(self.step(), 0.0), LONGEST_SLEEP_S))

    def step(self) -> float:
        """Send the requests that are due; returns the time until the next one, s."""
        with self._changed:
            now_s = self._clock()
            may_ask = self._may_ask(now_s)
            return min(unit.step(now_s, may_ask) for unit in self._units.values()) - now_s

    def stop(self) -> None:
        """Make `run` return, within 0.2 s plus the driver's time to send."""
        self._stopped.set()

    def status(self) -> PollStatus:
        """Whether requests are sent, why not, and the counters so far."""
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
                f"profile {self._profile.key} needs read requests; "
                "poll:=true (evpinn run --poll) allows them"
            )
        elif self.contradicted:
            text = "stopped: the traffic contradicts the profile"
        elif self._shared_id is not None:
            text = (
                f"stopped: the car or another tester sends on 0x{self._shared_id:X} too; "
                "restart to try again"
            )
        elif reason is not None:
            text = f"stopped: {reason}; resumes when the car wakes, or after a restart"
        elif retired:
            text = ", ".join(f"{name} refused: {why}" for name, why in retired.items())
        else:
            text = "asking"
        stopped = self.contradicted or self._shared_id is not None or reason is not None
        ok = self._gate is not None and not stopped and not retired
        return PollStatus(ok, text, dict(counters))

    @property
    def dropped(self) -> Counter[str]:
        """Number of unused values by reason (see `AnswerDecoder`)."""
        return self._decoder.dropped

    def _may_ask(self, now_s: float) -> frozenset[str]:
        if self.contradicted or self._shared_id is not None:
            return frozenset()
        if self._begun_s is None:
            self._begun_s = now_s
        if now_s - self._begun_s < LISTEN_FIRST_S:
            return frozenset()
        if self._restraint.leave is Leave.AUXILIARY:
            return self._auxiliary
        return self._names if self._restraint.leave is Leave.ALL else frozenset()

    def _transmit(self, frame: CanFrame) -> bool:
        assert self._gate is not None
        now_s = self._clock()
        self._sent_s[frame.key, frame.data] = now_s
        try:
            sent = self._gate(frame)
        except Exception:
            self._restraint.asked(now_s, sent=True)
            raise
        self._restraint.asked(now_s, sent)
        return sent

    def _record_traffic(self, frame: CanFrame, now_s: float) -> None:
        sent_s = self._sent_s.get((frame.key, frame.data), -math.inf)
        if frame.key in self._asked_ids and now_s - sent_s > ECHO_S:  # too late for an echo
            self._shared_id = frame.can_id
        if self._restraint.record_frame(frame.can_id, frame.extended, now_s):
            for unit in self._units.values():
                unit.revive()
            self._changed.notify()

    def _observe(self, readings: Iterable[Reading], now_s: float) -> None:
        for reading in readings:
            self._restraint.observe(reading, now_s)
