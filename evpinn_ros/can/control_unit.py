"""Talks to one control unit by ISO-TP: one request at a time, and its answers."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterable
import logging
import math

import isotp
from udsoncan.ResponseCode import ResponseCode

from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.request import Address, Answer, RequestRule, Send

ANSWER_TIMEOUT_S = 1.0
PENDING_TIMEOUT_S = 5.0
"""Timeout of an answer, and of one that the control unit announced as pending."""

LONGEST_WAIT_S = 10.0
"""Longest total time for which a control unit may report an answer as pending."""

REFUSALS = 3
"""Refusals in a row after which a request is not made again."""

ANSWERS = ("answered", "short_answer", "pending", "busy", "refused")
"""Counters of a control unit's answers, without noise on its id."""

NEGATIVE = 0x7F
"""First byte of a refusal, before the requested service and the reason (ISO 14229-1)."""

LOGGER = "evpinn_ros.isotp"
LINK_OPTIONS = {"tx_padding": 0x00, "blocksize": 0, "stmin": 0, "logger_name": LOGGER}
logging.getLogger(LOGGER).disabled = True  # it warns of every damaged frame, and we count them


class ControlUnit:
    """Sends requests to one control unit and assembles its answers; for one thread at a time."""

    def __init__(
        self, address: Address, requests: Iterable[RequestRule], send: Send | None
    ) -> None:
        """Prepare; `requests` are in order of urgency; without `send` it only listens."""
        # `asked`, `answered`, `silent`, `pending`, `busy`, `refused`, `short_answer`,
        # `unexpected_answer` (to no request of the profile), `garbled` (not ISO-TP), `send_errors`
        self.counters: Counter[str] = Counter()
        self.retired: dict[str, str] = {}  # reason of each request that was refused too often
        self._requests = {request.name: request for request in requests}
        self._address, self._send = address, send
        self._due_s = dict.fromkeys(self._requests, -math.inf)
        self._refusals: Counter[str] = Counter()
        self._asked: RequestRule | None = None
        self._asked_s = self._deadline_s = math.nan
        self._sent = False
        self._stamp_ns = 0
        self._inbox: deque[isotp.CanMessage] = deque()
        self._link = isotp.TransportLayerLogic(
            rxfn=lambda _timeout: self._inbox.popleft() if self._inbox else None,
            txfn=self._transmit,
            address=_isotp_address(address),
            error_handler=lambda _: self.counters.update(garbled=1),
            params=LINK_OPTIONS,
        )

    def receive(self, frame: CanFrame, now_s: float) -> Answer | None:
        """The answer that this frame completes, or None; never raises."""
        position = len(self._address.prefix)
        if len(frame.data) > position and frame.data[position] >> 4 in (0, 1):
            self._stamp_ns = frame.stamp_ns  # a single frame or a first frame
        self._inbox.append(
            isotp.CanMessage(
                arbitration_id=frame.can_id,
                dlc=len(frame.data),
                data=frame.data,
                extended_id=frame.extended,
            )
        )
        self._link.process()
        payload = self._link.recv()
        return self._read(bytes(payload), now_s) if payload else None

    @property
    def answers(self) -> int:
        """Number of all replies of the control unit, including refusals."""
        return sum(self.counters[kind] for kind in ANSWERS)

    def step(self, now_s: float, may_ask: Collection[str]) -> float:
        """Handle a timeout, send a due request of `may_ask`; returns the next step's time, s."""
        if self._asked is not None and now_s >= self._deadline_s:
            self.counters["silent"] += 1
            self._finish()
        askable = [name for name in self._due_s if name in may_ask]
        if self._asked is None and askable and self._send is not None:
            name = min(askable, key=lambda name: self._due_s[name])
            if now_s < self._due_s[name]:
                return self._due_s[name]
            self._ask(self._requests[name], now_s)
        return math.inf if self._asked is None else self._deadline_s

    def revive(self) -> None:
        """Allow refused requests again: the car has slept since."""
        self._due_s = dict.fromkeys(self._requests, -math.inf)
        self._refusals.clear()
        self.retired.clear()

    def _ask(self, request: RequestRule, now_s: float) -> None:
        self._asked, self._asked_s = request, now_s
        self._deadline_s = now_s + ANSWER_TIMEOUT_S
        self._due_s[request.name] = now_s + request.period_s
        self._sent = False
        self._link.reset()
        self._link.send(request.payload)
        self._link.process()
        if self._sent:
            self.counters["asked"] += 1
        else:
            self._finish()

    def _finish(self) -> None:
        self._asked = None
        self._link.stop_receiving()

    def _transmit(self, message: isotp.CanMessage) -> None:
        """Send a frame of the ISO-TP link, only while a request of ours waits for its answer."""
        if self._asked is None or self._send is None:
            return
        try:
            self._sent = self._send(CanFrame.of(message, 0))
        except Exception:
            # Each driver fails in its own way; the bus reader detects a lost bus.
            self.counters["send_errors"] += 1
            self._sent = True

    def _read(self, payload: bytes, now_s: float) -> Answer | None:
        if payload[0] == NEGATIVE:
            self._take_negative(payload, now_s)
            return None
        requests = self._requests.values()
        request = next((waiting for waiting in requests if payload.startswith(waiting.echo)), None)
        if request is None:
            self.counters["unexpected_answer"] += 1
            return None
        if request is self._asked:
            self._refusals[request.name] = 0
            self._finish()
        data = payload[len(request.echo) :]
        if len(data) < request.min_length:
            self.counters["short_answer"] += 1
            return None
        self.counters["answered"] += 1
        return Answer(self._stamp_ns, request, data)

    def _take_negative(self, payload: bytes, now_s: float) -> None:
        asked = self._asked
        if asked is None or len(payload) < 3 or payload[1] != asked.payload[0]:
            self.counters["unexpected_answer"] += 1
            return
        reason = payload[2]
        if reason == ResponseCode.RequestCorrectlyReceived_ResponsePending:
            self.counters["pending"] += 1
            self._deadline_s = min(now_s + PENDING_TIMEOUT_S, self._asked_s + LONGEST_WAIT_S)
        elif reason == ResponseCode.BusyRepeatRequest:
            self.counters["busy"] += 1
            self._finish()
        else:
            self.counters["refused"] += 1
            self._refusals[asked.name] += 1
            if self._refusals[asked.name] >= REFUSALS:
                self.retired[asked.name] = ResponseCode.get_name(reason)
                del self._due_s[asked.name]
            self._finish()


def _isotp_address(address: Address) -> isotp.Address:
    modes = isotp.AddressingMode
    if address.target is None:
        mode = modes.Normal_29bits if address.extended else modes.Normal_11bits
        return isotp.Address(mode, txid=address.tx_id, rxid=address.rx_id)
    return isotp.Address(
        modes.Extended_29bits if address.extended else modes.Extended_11bits,
        txid=address.tx_id,
        rxid=address.rx_id,
        target_address=address.target,
        source_address=address.source,
    )
