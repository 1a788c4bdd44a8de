"""ELM327 and OBDLink adapters as a bus of python-can: frames in and out over AT commands.

The adapter generates flow control (ISO 15765-2). Only the given requests, which only read
(`request.READ_SERVICES`), are sent; between requests the adapter monitors broadcast ids. AT
commands follow the ELM327 data sheet (Elm Electronics, ELM327DSJ): ATSH and ATCP set the id, ATCRA
the filter, ATFC.. the flow control, ATCEA the first byte of extended addressing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import reduce
import re
import time
from typing import Any

import can

from evpinn_ros.can.diagnostic_ids import FUNCTIONAL, LAST_11_BIT_ID
from evpinn_ros.can.read_only import FLOW_CONTROL, frames_of
from evpinn_ros.can.request import Address, RequestRule

NAME = "elm327"
BAUD_RATES = (38400, 115200, 9600, 500000)  # of a cable, most common first; any for radio
PROTOCOLS = {500_000: ("6", "7"), 250_000: ("8", "9")}  # of ATSP, for 11 and 29 bit ids
PAUSE_S = 0.02  # longest wait of one read of the port
WAKE_S, RESET_S, ANSWER_S = 0.5, 3.0, 2.0  # timeouts of the adapter's replies
MOST_BYTES = 4096  # without a line end; a frame of 8 bytes takes 40
BANNER = re.compile(rb"ELM327|OBDLink|STN\d", re.IGNORECASE)
FRAME = re.compile(r"(?:[0-9A-F]{3}|[0-9A-F]{8})(?:[0-9A-F]{2}){0,8}")
SILENT = {"", "OK", "?", "NO DATA", "STOPPED", "BUFFER FULL", "SEARCHING..."}
"""Replies of the adapter that are no frames; "?" answers an unknown command."""
FAULTS = ("ERROR", "UNABLE TO CONNECT", "BUS BUSY", "FB ", "<")
"""Replies for a bus that the adapter cannot read; "<" begins the mark of a damaged line."""

START = ("ATE0", "ATL0", "ATS0", "ATH1", "ATCAF1", "ATCFC1", "ATAT1", "ATCSM1")
NEEDED = frozenset(("ATE0", "ATH1", "ATCAF1"))
"""Commands that are required; a clone that lacks one of the others keeps its default."""


class Elm327Bus(can.BusABC):  # type: ignore[misc]
    """One adapter; `recv` and `send` as in python-can, for one receiving thread."""

    def __init__(
        self,
        channel: str,
        bitrate: int = 500_000,
        requests: Iterable[RequestRule] = (),
        broadcast: Collection[int] | None = None,
        tty_baudrate: int | None = None,
        clock_s: Callable[[], float] = time.time,
        stopped: Callable[[], bool] = lambda: False,
        **_kwargs: Any,
    ) -> None:
        """Find the adapter (a port, or `tcp:HOST:PORT`) and prepare it, unless `stopped`.

        `broadcast`: ids to monitor between requests, None for all; `clock_s` stamps the frames.
        OSError, can.CanInitializationError, ValueError: no adapter, or an unsuitable one.
        """
        if bitrate not in PROTOCOLS:
            raise ValueError(f"an ELM327 takes a bitrate of 500000 or 250000, not {bitrate}")
        self.channel_info = f"{NAME} {channel}"
        self._short, self._long = PROTOCOLS[bitrate]
        frames = {request: frames_of(request) for request in requests}
        self._requests = {question: request for request, (question, _) in frames.items()}
        self._flow_controls = {flow_control for _, flow_control in frames.values()}
        self._broadcast, self._clock_s, self._stopped = broadcast, clock_s, stopped
        self._questions: deque[RequestRule] = deque()  # append and popleft are atomic
        self._commands: deque[str] = deque()
        self._lines: deque[tuple[float, str]] = deque()
        self._rest, self._last = b"", ""
        self._settings = {"ATCEA": "", "ATFCSM": "0"}  # settings that the adapter has now
        self._monitoring = self._extended = False
        self._deadline_s: float | None = None  # while waiting for the adapter's prompt
        self._port = self._find(channel, tty_baudrate)
        self._prepare()
        super().__init__(channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a known request, once, until the adapter is free; PermissionError for others."""
        key = msg.arbitration_id, msg.is_extended_id, bytes(msg.data)
        if key in self._flow_controls:
            return
        if key not in self._requests:
            raise PermissionError(f"{msg.arbitration_id:X}: no request of the profile")
        if self._requests[key] not in self._questions:
            self._questions.append(self._requests[key])

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        end = time.monotonic() + (timeout or 0.0)
        while True:
            while self._lines:
                message = self._read(*self._lines.popleft())
                if message is not None:
                    return message, True
            self._go_on()
            self._listen(min(PAUSE_S, max(end - time.monotonic(), 0.0)))
            if not self._lines and time.monotonic() >= end:
                return None, True

    def shutdown(self) -> None:
        """Stop monitoring and close the port."""
        super().shutdown()
        try:
            if self._monitoring:
                self._port.write(b" ")
        finally:
            self._port.close()

    # Lines ---------------------------------------------------------------------------------------

    def _listen(self, seconds: float) -> None:
        """Read for some seconds; a prompt frees the adapter for the next command."""
        self._port.timeout = seconds
        data = self._port.read(max(1, getattr(self._port, "in_waiting", 0)))
        now_s = self._clock_s()
        *whole, self._rest = re.split(rb"[\r\n]+|(?<=>)", self._rest + data.replace(b"\0", b""))
        for line in whole:
            if line.endswith(b">"):
                self._deadline_s = None
            self._lines.append((now_s, line.decode("latin-1").strip("> ")))
        if len(self._rest) > MOST_BYTES:
            self._rest = b""
            raise ValueError(f"more than {MOST_BYTES} bytes without a line end")

    def _read(self, now_s: float, text: str) -> can.Message | None:
        """The frame in a line or None; ValueError if damaged, CanOperationError after a reset."""
        word = text.replace(" ", "")
        if text in SILENT or word == self._last:  # or the echo of our last command
            return None
        if BANNER.search(text.encode()):
            raise can.CanOperationError("the adapter restarted: is its power supply loose?")
        if any(fault in text for fault in FAULTS):
            return can.Message(timestamp=now_s, is_error_frame=True)
        digits = 8 if self._extended else 3
        if FRAME.fullmatch(word) is None or len(word) < digits or (len(word) - digits) % 2:
            raise ValueError(f"the adapter replied {text[:40]!r}")
        return can.Message(
            timestamp=now_s,
            arbitration_id=int(word[:digits], 16),
            is_extended_id=self._extended,
            data=bytes.fromhex(word[digits:]),
        )

    # Commands ------------------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Send the next command if the adapter is ready for it."""
        if self._monitoring and self._deadline_s is None:
            self._monitoring = False  # the adapter stopped by itself: its buffer is full
        if self._monitoring:
            if self._questions:
                self._monitoring = False
                # Any character stops monitoring and brings the prompt. If the adapter just stopped
                # by itself, it ignores a space, whereas a line end would repeat the last command.
                self._port.write(b" ")
                self._deadline_s = time.monotonic() + ANSWER_S
            return
        if self._deadline_s is not None:
            if time.monotonic() > self._deadline_s:
                raise can.CanOperationError("the adapter stopped replying")
            return
        if not self._commands:
            self._plan()
        if self._commands:
            self._say(self._commands.popleft())

    def _plan(self) -> None:
        """Queue the commands of the next request, or those to monitor if there is none."""
        if self._questions:
            request = self._questions.popleft()
            self._commands.extend(self._changed(self._turn_to(request.address)))
            self._commands.append(request.payload.hex().upper())
        elif self._broadcast is None or self._broadcast:
            self._commands.extend(self._changed(self._to_monitor()))
            self._commands.append("ATMA")

    def _turn_to(self, address: Address) -> Iterator[tuple[str, str]]:
        """Commands that direct requests to one control unit, and receive it alone."""
        yield "ATSP", self._long if address.extended else self._short
        width = 8 if address.extended else 3
        request = f"{address.tx_id:0{width}X}"
        if address.extended:
            yield "ATCP", request[:2]
        yield "ATSH", request[-6:]
        yield "ATCEA", address.prefix.hex().upper()
        if address.tx_id in FUNCTIONAL:
            yield "ATCRA", request.replace("7DF", "7EX").replace("18DB33F1", "18DAF1XX")
            yield "ATFCSM", "0"
        else:
            yield "ATCRA", f"{address.rx_id:0{width}X}"
            yield "ATFCSH", request
            yield "ATFCSD", (address.prefix + FLOW_CONTROL).hex().upper()
            yield "ATFCSM", "1"

    def _to_monitor(self) -> Iterator[tuple[str, str]]:
        """Commands that filter by the bits that all monitored ids share."""
        ids = [can_id for can_id in self._broadcast or () if can_id <= LAST_11_BIT_ID]
        yield "ATSP", self._short
        yield "ATCRA", ""
        if ids:
            differ = reduce(int.__or__, (can_id ^ ids[0] for can_id in ids))
            yield "ATCF", f"{ids[0] & ~differ:03X}"
            yield "ATCM", f"{LAST_11_BIT_ID & ~differ:03X}"

    def _changed(self, wanted: Iterable[tuple[str, str]]) -> Iterator[str]:
        """Commands that change a setting: each takes 50 ms over a radio link."""
        for command, value in wanted:
            if self._settings.get(command) == value:
                continue
            if command == "ATCRA":  # sets filter and mask
                self._settings.update(ATCF="", ATCM="")
            self._settings[command] = value
            yield command + value

    def _say(self, command: str) -> None:
        self._last = command
        if command.startswith("ATSP"):
            self._extended = command[-1] == self._long
        self._monitoring = command == "ATMA"
        self._port.write(command.encode() + b"\r")
        self._deadline_s = time.monotonic() + ANSWER_S

    # Opening -------------------------------------------------------------------------------------

    def _find(self, channel: str, baud_rate: int | None) -> Any:
        import serial  # type: ignore[import-untyped]

        network = channel.startswith("tcp:")
        url = f"socket://{channel.removeprefix('tcp:')}" if network else channel
        reply = b""
        for rate in (baud_rate,) if baud_rate else BAUD_RATES[: 1 if network else None]:
            port = serial.serial_for_url(url, baudrate=rate, timeout=PAUSE_S, write_timeout=1.0)
            port.write(b"\r")  # ends any pending command
            self._until_prompt(port, WAKE_S)
            port.write(b"ATZ\r")
            reply = self._until_prompt(port, RESET_S)
            if BANNER.search(reply):
                return port
            port.close()
        replied = f"the reply was {reply[:40]!r}" if reply else "no reply"
        raise can.CanInitializationError(f"no ELM327 or OBDLink found: {replied}")

    def _prepare(self) -> None:
        for command in START:
            self._port.write(command.encode() + b"\r")
            reply = self._until_prompt(self._port, ANSWER_S)
            if b"OK" not in reply and command in NEEDED:
                self._port.close()
                raise can.CanInitializationError(f"the adapter lacks {command}: is it a clone?")

    def _until_prompt(self, port: Any, seconds: float) -> bytes:
        end, reply = time.monotonic() + seconds, b""
        port.timeout = PAUSE_S
        while not reply.rstrip().endswith(b">") and time.monotonic() < end:
            if self._stopped():
                port.close()
                raise can.CanInitializationError("stopped before the adapter was ready")
            reply += port.read(max(1, getattr(port, "in_waiting", 0)))
        return bytes(reply)
