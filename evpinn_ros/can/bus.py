"""A CAN adapter read in one thread, which survives a quiet bus, unplugging and driver faults.

Nothing is sent unless `send` is called; the poller calls it through its gate. If the adapter
supports `listen_only`, set it: the adapter then does not even acknowledge frames.

The kind of stamps is chosen at the first frame after every opening: epoch stamps (above 1e9 s)
of a driver are used; stamps of an adapter's own quartz are mapped by a `ClockMap`. A frame without
a stamp is stamped at its arrival.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
import errno
import socket
import threading
from typing import Any

import can

from evpinn_ros.can import elm327
from evpinn_ros.can.frame import EPOCH_S, CanFrame, nanoseconds
from evpinn_ros.common.errors import InputError, one_line

LARGEST_DRIFT_PPM = 500
"""Largest drift of the clocks: quartz 100 ppm each; NTP slews a computer's clock by 500 ppm."""
SET_ANEW_NS = 1_000_000_000
"""A larger delay means that the node's clock was set forward, as by NTP after booting."""


class ClockMap:
    """Maps stamps of one adapter to the node's clock, in the order in which it received frames.

    A mapped stamp lies between the moment and the arrival of its frame, and never before the last
    one. It is late by `d_k + 2 r age_k` at most, for each earlier frame k, with its delay d_k, its
    age_k and the drift r. The map restarts if either clock goes back or the node's leaps forward.
    """

    def __init__(self) -> None:
        self._offset_ns = self._device_ns = self._now_ns = self._stamp_ns = 0
        self._started = False

    def convert(self, device_ns: int, now_ns: int) -> int:
        """Time of a frame by the node's clock, ns, from its own stamp and its arrival."""
        difference = now_ns - device_ns
        elapsed = device_ns - self._device_ns
        highest = self._offset_ns - (-elapsed * LARGEST_DRIFT_PPM // 1_000_000)  # rounded up
        if (
            not self._started
            or elapsed < 0
            or now_ns < self._now_ns
            or difference > highest + SET_ANEW_NS
        ):
            self._started = True
            self._offset_ns, self._stamp_ns = difference, now_ns
        else:
            self._offset_ns = min(difference, highest)
            self._stamp_ns = max(device_ns + self._offset_ns, self._stamp_ns)
        self._device_ns, self._now_ns = device_ns, now_ns
        return self._stamp_ns


RECEIVE_TIMEOUT_S = 0.1
SILENT_AFTER_S = 1.0
FIRST_BACKOFF_S = 0.5
LAST_BACKOFF_S = 2.0  # with the 2 s in which slcan opens, frames resume within 5 s
GARBLED_PAUSE_S = 0.01
SEND_TIMEOUT_S = 0.1
SOCKET_QUEUE = 1 << 22  # bytes; a frame takes up to a thousand of them
MANY_GARBLED = 100  # in a row, after which the driver does not recover by itself
MANY_ERRORS = 100  # error frames in a row: this adapter can read no traffic
SOCKETCAN_BUS_OFF = 0x40  # class bit in the id of an error frame (linux/can/error.h)

DRIVERS: Mapping[str, str] = {
    elm327.NAME: "the Python package pyserial",
    "gs_usb": "the Python package gs_usb",
    "kvaser": "Kvaser's CANlib",
    "pcan": "PEAK's PCAN-Basic",
    "serial": "the Python package pyserial",
    "slcan": "the Python package pyserial",
    "udp_multicast": "the Python package msgpack",
    "vector": "Vector's XL Driver Library",
}
"""Packages that python-can needs for the most common adapters."""

INTERFACES = can.VALID_INTERFACES | {elm327.NAME}
"""Drivers of python-can, and ours."""

OUR_CLOCK = frozenset(
    {elm327.NAME, "virtual", "udp_multicast"}
    | {"iscan", "neousys", "seeedstudio", "slcan", "socketcan"}
)
"""Drivers of python-can 4.6 that stamp frames by this computer's clock. Others with epoch stamps
(kvaser, pcan, vector) add the opening time to the adapter's counter, so they drift."""


class BusCondition(Enum):
    """Condition of the adapter."""

    CLOSED = "closed"
    OPEN = "open"
    SILENT = "silent: the car sleeps or this is another bus"
    ERRORS = "only error frames: wrong bit rate or faulty wiring?"
    OFF = "bus-off: the adapter stopped after too many errors; check bit rate and wiring"
    LOST = "lost: trying to reopen it"


@dataclass(frozen=True, slots=True)
class BusStatus:
    """One look at the adapter."""

    condition: BusCondition  # now
    problem: str | None  # the last fault and its remedy, in one line, or None
    # since the start: `frames`, `opened`, `lost`, `bus_off`, `error_frames`, `remote_frames`,
    # `garbled` (the driver could not read a frame), `callback_errors`, `close_errors`
    counters: Mapping[str, int]


class BusReader:
    """Passes every data frame of a bus to a callback, from the thread that calls `run`."""

    def __init__(
        self,
        interface: str,
        channel: str | int,
        on_frame: Callable[[CanFrame], None],
        now_ns: Callable[[], int],
        wait: Callable[[float], object] | None = None,
        **options: Any,
    ) -> None:
        """Store how to open the bus.

        `on_frame` is called in the thread of `run`; its exceptions are counted. `now_ns` is the
        node's clock; `wait` sleeps, s, before reopening; `options` are those of `can.Bus`.
        """
        self._interface, self._channel, self._options = interface, channel, options
        self._on_frame, self._now_ns = on_frame, now_ns
        self._bus: Any = None
        self._stop = threading.Event()
        self._wait = self._stop.wait if wait is None else wait
        self._condition = BusCondition.CLOSED
        self._problem: str | None = None
        self._counters: Counter[str] = Counter()
        self._begin()
        self._was_off = False
        self._backoff_s = FIRST_BACKOFF_S

    def open(self) -> None:
        """Open the bus now; if that fails, InputError states the remedy."""
        try:
            if self._interface == elm327.NAME:
                self._bus = elm327.Elm327Bus(
                    str(self._channel), stopped=self._stop.is_set, **self._options
                )
            else:
                self._bus = can.Bus(
                    channel=self._channel,
                    interface=self._interface,
                    ignore_config=True,
                    **self._options,
                )
        except Exception as error:
            # CanError, OSError, ValueError, NotImplementedError, AttributeError...: each driver
            # refuses in its own way, and every exception means that there is no bus now.
            self._problem = self._explained(error)
            raise InputError(self._problem) from error
        _deepen_queue(self._bus)
        self._condition = BusCondition.OPEN
        self._counters["opened"] += 1
        self._begin()

    def _begin(self) -> None:
        self._stamps_are_ours: bool | None = None
        self._clock = ClockMap()
        self._silent_s = 0.0
        self._errors = self._garbled = 0

    def run(self) -> None:
        """Read until `stop`; reopen the bus as often as needed."""
        try:
            while not self._stop.is_set():
                if self._bus is not None or self._reopen():
                    self._receive()
        finally:
            self._close(BusCondition.CLOSED)

    def stop(self) -> None:
        """Make `run` return, within about 0.1 s plus the driver's own time."""
        self._stop.set()

    def send(self, frame: CanFrame) -> bool:
        """Send a frame; False without a bus. Exceptions of the driver propagate."""
        bus = self._bus
        if bus is None:
            return False
        message = can.Message(
            arbitration_id=frame.can_id, data=frame.data, is_extended_id=frame.extended
        )
        bus.send(message, timeout=SEND_TIMEOUT_S)
        return True

    def status(self) -> BusStatus:
        """The condition, the last problem and the counters so far."""
        return BusStatus(self._condition, self._problem, dict(self._counters))

    def _reopen(self) -> bool:
        try:
            self.open()
        except InputError:  # `problem` keeps the reason
            self._condition = BusCondition.LOST
            self._back_off()
            return False
        return True

    def _back_off(self) -> None:
        self._wait(self._backoff_s)
        self._backoff_s = min(2 * self._backoff_s, LAST_BACKOFF_S)

    def _receive(self) -> None:
        try:
            message = self._bus.recv(RECEIVE_TIMEOUT_S)
            off = (message is None or message.is_error_frame) and self._is_off(message)
        except (can.CanError, OSError) as error:
            self._lose(self._explained(error))
        except Exception as error:
            self._stumble(error)
        else:
            self._garbled = 0
            if off:
                self._counters["bus_off"] += 1
                self._was_off = True
                self._lose(self._explained(BusCondition.OFF), BusCondition.OFF)
            elif message is None:
                self._silent_s += RECEIVE_TIMEOUT_S
                if self._silent_s >= SILENT_AFTER_S:
                    self._condition = BusCondition.OFF if self._was_off else BusCondition.SILENT
            else:
                self._take(message)

    def _is_off(self, message: Any) -> bool:
        """True if the controller went bus-off; few drivers report it."""
        if message is not None and self._interface == "socketcan":
            return bool(message.arbitration_id & SOCKETCAN_BUS_OFF)
        return self._bus.state is can.BusState.ERROR

    def _lose(self, problem: str, condition: BusCondition = BusCondition.LOST) -> None:
        self._counters["lost"] += 1
        self._problem = problem
        self._close(condition)
        self._back_off()

    def _stumble(self, error: Exception) -> None:
        """Skip a broken line of a serial adapter, after a pause that saves processor time."""
        self._counters["garbled"] += 1
        self._garbled += 1
        self._problem = f"{self._name}: garbled frame: {one_line(error)}"
        if self._garbled >= MANY_GARBLED:
            self._lose(self._problem)
        else:
            self._wait(GARBLED_PAUSE_S)

    def _take(self, message: Any) -> None:
        self._silent_s = 0.0
        if message.is_error_frame:
            self._counters["error_frames"] += 1
            self._errors += 1
            if self._errors >= MANY_ERRORS:
                self._condition = BusCondition.ERRORS
            return
        # Only a frame proves the bus: if opening succeeds but reading fails, the backoff grows.
        self._condition, self._backoff_s = BusCondition.OPEN, FIRST_BACKOFF_S
        self._errors, self._was_off = 0, False
        if message.is_remote_frame:
            self._counters["remote_frames"] += 1
        else:
            self._counters["frames"] += 1
            self._deliver(message)

    def _deliver(self, message: Any) -> None:
        try:
            self._on_frame(CanFrame.of(message, self._stamp_ns(message.timestamp)))
        except Exception as error:
            self._counters["callback_errors"] += 1
            self._problem = f"{self._name}: processing a frame failed: {error!r}"

    def _stamp_ns(self, seconds: float) -> int:
        if seconds == 0.0:  # python-can's default, and all that a gs_usb without a clock gives
            return self._now_ns()
        if self._stamps_are_ours is None:
            self._stamps_are_ours = self._interface in OUR_CLOCK and seconds > EPOCH_S
        if self._stamps_are_ours:
            return nanoseconds(seconds)
        return self._clock.convert(nanoseconds(seconds), self._now_ns())

    def _close(self, condition: BusCondition) -> None:
        bus, self._bus = self._bus, None
        self._condition = condition
        if bus is None:
            return
        try:
            bus.shutdown()
        except Exception as error:
            # An unplugged adapter cannot be stopped: ignore the error.
            self._counters["close_errors"] += 1
            self._problem = self._problem or f"{self._name}: closing failed: {one_line(error)}"

    def _explained(self, fault: BaseException | BusCondition) -> str:
        """A fault in one line: the bus, the driver's message, the remedy."""
        what = fault.value if isinstance(fault, BusCondition) else one_line(fault)
        remedy = _remedy(fault, self._interface, self._channel)
        return f"CAN bus {self._name}: {what}" + (f"; {remedy}" if remedy else "")

    @property
    def _name(self) -> str:
        return f"{self._interface} {self._channel}"


def _deepen_queue(bus: Any) -> None:
    """Buffer a second of a full bus instead of 0.1 s; adapters may have no socket."""
    with suppress(Exception):
        bus_socket = socket.socket(fileno=bus.fileno())
        try:
            bus_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_QUEUE)
        finally:
            bus_socket.detach()  # the driver still owns the socket


def _remedy(error: BaseException | BusCondition, interface: str, channel: str | int) -> str | None:
    if isinstance(error, BusCondition):
        restart = (
            f"`sudo ip link set {channel} type can restart-ms 100` makes it restart by itself"
        )
        return restart if interface == "socketcan" else None
    if interface not in INTERFACES:
        return f"known interfaces are {', '.join(sorted(INTERFACES))}"
    number = _errno(error)
    if number in (errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ETIMEDOUT):
        return "has this computer joined the adapter's Wi-Fi? Are address and port right?"
    if isinstance(error, can.CanInitializationError) and interface == elm327.NAME:
        return "switch the ignition on, and close other apps that use the adapter"
    if interface == "socketcan" and number == errno.ENETDOWN:
        return f"try `sudo ip link set {channel} up type can bitrate 500000`"
    if interface == "socketcan" and number == errno.ENODEV:
        return "is the adapter plugged in? `ip link show type can` lists the channels"
    if number in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
        return "this kernel has no CAN; try `sudo modprobe can_raw`"
    if number in (errno.EACCES, errno.EPERM):
        return "add your user to the group of the device (`dialout`)"
    if number == errno.EBUSY:
        return "another program has it open"
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EIO):
        return "is the adapter plugged in? Is the channel its name?"
    if isinstance(error, (ValueError, TypeError)):
        return "check channel, bitrate and the other bus options"
    if number is None:
        driver = DRIVERS.get(interface, "the driver")
        return f"is {driver} installed? Is the adapter plugged in?"
    return None


def _errno(error: BaseException) -> int | None:
    cause: BaseException | None = error
    while cause is not None:
        for name in ("errno", "error_code"):
            number = getattr(cause, name, None)
            if isinstance(number, int):
                return number
        cause = cause.__cause__ or cause.__context__
    return None
