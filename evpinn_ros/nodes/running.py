"""Runs nodes in one thread until they are stopped, and ends them in good order.

systemd is told by sd_notify(3): datagrams to the socket in NOTIFY_SOCKET, if there is one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
import faulthandler
from functools import partial
import os
import signal
import socket
import sys
import time
from types import FrameType
from typing import NoReturn

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from evpinn_ros.common.errors import InputError, printable
from evpinn_ros.common.stopping import at_stop
from evpinn_ros.nodes.base import GuardedNode
from evpinn_ros.nodes.discovery import announce_often

SWITCH_INTERVAL = 5e-4
"""s that a thread may keep the interpreter from one that wants it: the bridge's after each system
call, the callbacks' while an update is computed. At Python's own 5 ms, beside the learner, one
frame in a hundred came 12 ms late, now 4 (docs/project/upstream.md)."""

START = 30.0
"""s for the nodes to be made: 0.3 on free cores. Only what hangs takes longer."""

FAREWELL = 8.0
"""s for the nodes to leave the network once all is saved: 0.1 on free cores, seconds on a machine
under load; a launch kills after 10. Others that leave as well may hang Fast DDS for good (its
issue 6502)."""

ONE_WISH = 1.0
"""s within which signals are one: a terminal and the launch that it stops both send theirs."""

LONGEST_SPIN = 0.1
"""s of one wait, after which Python learns of a signal; with none given, that of Kilted's
executor does not wait at all."""

MakeNode = Callable[[], GuardedNode]
GENERATOR = "rosidl_generator_py.generate_py_impl"
"""What makes Python of message definitions: loaded with the first message, and used by builds."""

SYSTEMD_PATIENCE = 0.1  # s for a systemd that does not read: it must not hold up the callbacks


def run(
    *makers: MakeNode,
    args: list[str] | None = None,
    beside: AbstractContextManager[object] | None = None,
) -> int:
    """Spin nodes until a signal, which ends the process with 0; returns 1, with a line, on errors.

    `makers` of listening nodes come first; `beside` is entered before the nodes start.
    """
    # A signal is noted and nothing else: a KeyboardInterrupt would strike anywhere, in the middle
    # of rclpy's C++ too, which turns it into some other error, and rclpy's own handler shuts its
    # context down while the executor enters endpoints, which aborts the process.
    signals: list[int] = []
    at_stop(lambda number, _: signals.append(number))
    with beside or nullcontext():
        code = _run(makers, args, signals)
    if code == 0:
        _end_process()
    return code


def _run(makers: Sequence[MakeNode], args: list[str] | None, signals: Sequence[int]) -> int:
    sys.setswitchinterval(SWITCH_INTERVAL)
    load_no_generator()
    announce_often()
    # In Jazzy `rclpy.init` is no context manager yet.
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        return _fail(f"ROS does not start: {error}")  # of arguments it names no more than those
    executor = new_executor()
    nodes: list[GuardedNode] = []
    code = 0
    try:
        with deadline(START):
            for make in makers:
                nodes.append(make())
        if not signals:
            tell("READY=1")
            period = watchdog_period()
            if period is not None and nodes:  # from the thread of the callbacks: these go on
                nodes[0].every(period, partial(tell, "WATCHDOG=1"))
            for node in nodes:
                executor.add_node(node)
            while rclpy.ok() and not signals:
                executor.spin_once(timeout_sec=LONGEST_SPIN)
    except InputError as error:
        code = _fail(str(error))
    finally:
        code = _end(nodes, executor) or code
    return code


def new_executor() -> Executor:
    """The EventsExecutor where it serves coroutines: in Kilted since 9.1.2, not in Jazzy.

    SingleThreadedExecutor enters every endpoint in Python before each message, which takes half
    of the energy node's processor at 10 Hz.
    """
    if not hasattr(Executor, "create_future"):  # came together with coroutines
        return SingleThreadedExecutor()
    from rclpy.experimental import EventsExecutor  # here: older versions have none

    executor = EventsExecutor()
    for number in (signal.SIGINT, signal.SIGTERM):  # which it takes for itself
        if (handler := signal.getsignal(number)) is not None:
            signal.signal(number, handler)
    return executor


def load_no_generator() -> None:
    """Spare this process what only builds of messages need: 3 to 7 MB, 0.1 s of each start."""
    sys.modules.setdefault(GENERATOR, None)  # type: ignore[arg-type]


def _end(nodes: Sequence[GuardedNode], executor: Executor) -> int:
    """Close all nodes; raises their first error, or returns 1 if something was not kept."""
    begin, code = time.monotonic(), 0
    tell("STOPPING=1")
    errors: list[Exception] = []
    for node in reversed(nodes):
        try:
            if problem := node.close():
                code = _fail(problem)
        except Exception as error:
            errors.append(error)
    code = 1 if errors else code

    def end_at_once(_: int, __: FrameType | None) -> None:
        if time.monotonic() - begin > ONE_WISH:
            os._exit(code)

    # A listener receives the others' last messages; a destroyed node announces that it is gone,
    # once no executor holds its endpoints.
    steps: list[Callable[[], object]] = [
        partial(at_stop, end_at_once),
        executor.shutdown,
    ]
    steps += [node.destroy_node for node in nodes]
    steps.append(try_shutdown)  # not that of `rclpy`, which in Kilted ends the thread once more
    with deadline(FAREWELL):
        for step in steps:
            try:
                step()
            except Exception as error:
                errors.append(error)
    if errors:
        raise errors[0]
    return code


def _end_process() -> NoReturn:
    """End without taking libraries to pieces: of torch, 0.6 s of the processor."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(0)


def _fail(reason: str) -> int:
    print(printable(" ".join(reason.split())), file=sys.stderr)
    return 1


def tell(state: str) -> None:
    """Send one state, `READY=1`, `WATCHDOG=1` or `STOPPING=1`; who does not listen is ignored."""
    path = os.environ.get("NOTIFY_SOCKET", "")
    if not path:
        return
    address = "\0" + path[1:] if path.startswith("@") else path  # of the abstract namespace
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as outlet:
        outlet.settimeout(SYSTEMD_PATIENCE)
        outlet.sendto(state.encode(), address)


def watchdog_period() -> float | None:
    """Half of the s that systemd waits (WATCHDOG_USEC), or None."""
    waits = os.environ.get("WATCHDOG_USEC", "")
    return int(waits) / 2e6 if waits.isdecimal() and int(waits) > 0 else None


@contextmanager
def deadline(seconds: float) -> Iterator[None]:
    """End with 1, and say where it hangs, after so long; `faulthandler` needs no interpreter."""
    faulthandler.dump_traceback_later(seconds, exit=True, file=2)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
