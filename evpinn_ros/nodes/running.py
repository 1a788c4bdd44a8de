"""Runs nodes in one thread until a signal, and shuts them down in order.

It reports to systemd by sd_notify(3): datagrams to the socket NOTIFY_SOCKET, if set.
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
from evpinn_ros.nodes.discovery import set_profile

SWITCH_INTERVAL = 5e-4
"""s for which a thread may hold the interpreter while another waits: the bridge after each system
call, callbacks during an update. With Python's default of 5 ms and a busy learner, one frame in a
hundred was 12 ms late; with this value, 4 ms (docs/project/upstream.md)."""

START = 30.0
"""s to make the nodes, which takes 0.3 s on idle cores; more than this is a hang."""

FAREWELL = 8.0
"""s for the nodes to leave the network after saving: 0.1 on idle cores, seconds under load; a
launch kills after 10. If other nodes leave at the same time, Fast DDS may hang forever (its issue
6502)."""

SAME_SIGNAL = 1.0
"""s within which several signals count as one: a terminal and its launch both send one."""

LONGEST_SPIN = 0.1
"""s of one wait, after which Python handles signals; without a timeout, Kilted's executor does not
wait at all."""

MakeNode = Callable[[], GuardedNode]
GENERATOR = "rosidl_generator_py.generate_py_impl"
"""Generator of Python code for messages: imported with the first message, used only by builds."""

SYSTEMD_PATIENCE = 0.1  # s to wait if systemd does not read; must not delay callbacks


def run(
    *makers: MakeNode,
    args: list[str] | None = None,
    beside: AbstractContextManager[object] | None = None,
) -> int:
    """Spin nodes until a signal, which ends the process with 0; returns 1 after a printed error.

    `makers` make the nodes, listeners first; `beside` is entered before the nodes start.
    """
    # The handler only records the signal. A KeyboardInterrupt inside rclpy's C++ would become
    # another error, and rclpy's own handler shuts the context down while the executor adds
    # endpoints, which aborts the process.
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
    set_profile()
    # In Jazzy `rclpy.init` is not a context manager yet.
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        return _fail(f"ROS does not start: {error}")  # for wrong arguments it names only these
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
            if period is not None and nodes:  # in the thread of the callbacks: these run
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
    """An EventsExecutor if it supports coroutines: in Kilted since 9.1.2, not in Jazzy.

    SingleThreadedExecutor adds every endpoint in Python before each message, which is half of the
    energy node's processor time at 10 Hz.
    """
    if not hasattr(Executor, "create_future"):  # was added together with coroutines
        return SingleThreadedExecutor()
    from rclpy.experimental import EventsExecutor  # imported here: older versions lack it

    executor = EventsExecutor()
    for number in (signal.SIGINT, signal.SIGTERM):  # EventsExecutor replaces their handlers
        if (handler := signal.getsignal(number)) is not None:
            signal.signal(number, handler)
    return executor


def load_no_generator() -> None:
    """Skip an import that only message builds need: saves 3 to 7 MB, and 0.1 s per start."""
    sys.modules.setdefault(GENERATOR, None)  # type: ignore[arg-type]


def _end(nodes: Sequence[GuardedNode], executor: Executor) -> int:
    """Close all nodes; raises their first error, or returns 1 if something was not saved."""
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
        if time.monotonic() - begin > SAME_SIGNAL:
            os._exit(code)

    # Listeners receive the last messages of others; a destroyed node announces its end once no
    # executor holds its endpoints.
    steps: list[Callable[[], object]] = [
        partial(at_stop, end_at_once),
        executor.shutdown,
    ]
    steps += [node.destroy_node for node in nodes]
    steps.append(try_shutdown)  # not `rclpy.shutdown`, which in Kilted ends the thread twice
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
    """End the process without finalizers of libraries: those of torch take 0.6 s."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(0)


def _fail(reason: str) -> int:
    print(printable(" ".join(reason.split())), file=sys.stderr)
    return 1


def tell(state: str) -> None:
    """Send systemd one state, `READY=1`, `WATCHDOG=1` or `STOPPING=1`; errors are ignored."""
    path = os.environ.get("NOTIFY_SOCKET", "")
    if not path:
        return
    address = "\0" + path[1:] if path.startswith("@") else path  # in the abstract namespace
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as outlet:
        outlet.settimeout(SYSTEMD_PATIENCE)
        outlet.sendto(state.encode(), address)


def watchdog_period() -> float | None:
    """Half of systemd's watchdog timeout (WATCHDOG_USEC), s; None without one."""
    waits = os.environ.get("WATCHDOG_USEC", "")
    return int(waits) / 2e6 if waits.isdecimal() and int(waits) > 0 else None


@contextmanager
def deadline(seconds: float) -> Iterator[None]:
    """Exit with 1 and print a traceback, by `faulthandler`, if a block takes over `seconds`."""
    faulthandler.dump_traceback_later(seconds, exit=True, file=2)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
