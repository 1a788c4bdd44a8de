"""Runs nodes in one thread until they are stopped, and ends them in good order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from functools import partial
import os
import signal
import sys
from typing import NoReturn

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions, install_signal_handlers

from evpinn_ros.common.errors import InputError, printable
from evpinn_ros.nodes.base import GuardedNode
from evpinn_ros.nodes.supervision import tell, watchdog_period

SWITCH_INTERVAL = 5e-4
"""s that a thread may keep the interpreter from one that wants it: the bridge's after each system
call, the callbacks' while an update is computed. At Python's own 5 ms, beside the learner, one
frame in a hundred came 12 ms late, now 4."""

MakeNode = Callable[[], GuardedNode]


def run(
    *makers: MakeNode,
    args: list[str] | None = None,
    beside: AbstractContextManager[object] | None = None,
) -> int:
    """Make nodes and spin them until SIGINT, SIGTERM or a shutdown; this ends the process with 0.

    Args:
        makers: of the nodes, called once ROS is up; those who listen before those who speak.
        args: of the command line, None for those of the process.
        beside: entered before the nodes start and left when they have ended.

    Returns:
        The exit code 1, with a line on stderr, when input is wrong or something that shall last
        could not be written.
    """
    # A signal shall wake rclpy up and nothing else: a KeyboardInterrupt would strike anywhere, in
    # the middle of its C++ too, which turns it into some other error.
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: signals.append(number))
    with beside or nullcontext():
        code = _run(makers, args, signals)
    if code == 0:
        _end_process()
    return code


def _run(makers: Sequence[MakeNode], args: list[str] | None, signals: Sequence[int]) -> int:
    sys.setswitchinterval(SWITCH_INTERVAL)
    # In Jazzy `rclpy.init` is no context manager yet.
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        return _fail(f"ROS does not start: {error}")  # of arguments it names no more than those
    nodes: list[GuardedNode] = []
    unkept: list[str] = []
    try:
        for make in makers:
            nodes.append(make())
        # Only now: a node that is shut down while it is made does not end quietly.
        install_signal_handlers()
        if not signals:
            _supervise(nodes)
            _spin(nodes)
    except InputError as error:
        return _fail(str(error))
    except ExternalShutdownException:
        pass
    except RuntimeError:
        if rclpy.ok():
            raise
        # The shutdown came in the middle of a call into rclpy.
    finally:
        unkept += _end(nodes)
    for problem in unkept:
        _fail(problem)
    return 1 if unkept else 0


def _end(nodes: Sequence[GuardedNode]) -> list[str]:
    """Close all nodes, whatever one of them raises; the first error is raised in the end.

    Returns:
        What the nodes could not keep.
    """
    # A listener receives the others' last messages; a destroyed node announces that it is gone.
    tell("STOPPING=1")
    steps: list[Callable[[], object]] = [node.close for node in reversed(nodes)]
    steps += [node.destroy_node for node in nodes]
    errors: list[Exception] = []
    problems: list[str] = []
    for step in (*steps, rclpy.try_shutdown):
        try:
            problem = step()
        except Exception as error:
            errors.append(error)
        else:
            problems += [problem] if isinstance(problem, str) else []
    if errors:
        raise errors[0]
    return problems


def _supervise(nodes: Sequence[GuardedNode]) -> None:
    """Tell systemd that all is up; from the thread of the callbacks, that these go on."""
    tell("READY=1")
    period = watchdog_period()
    if period is not None and nodes:
        nodes[0].every(period, partial(tell, "WATCHDOG=1"))


def _spin(nodes: list[GuardedNode]) -> None:
    executor = SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    executor.spin()


def _end_process() -> NoReturn:
    """End without taking libraries to pieces: of torch, 0.6 s of the processor for nothing."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # whoever started us may have closed it
            with suppress(OSError):
                stream.flush()
    os._exit(0)


def _fail(reason: str) -> int:
    print(printable(" ".join(reason.split())), file=sys.stderr)
    return 1
