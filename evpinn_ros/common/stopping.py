"""Signals that ask a process to stop; imports nothing that takes time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
import os
import signal
import stat
from types import FrameType
from typing import Any

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Handler = Callable[[int, FrameType | None], object]


def at_stop(handler: Handler) -> None:
    """Call a handler at each signal to stop; an ignored hang-up, as under nohup, stays ignored.

    If the terminal was closed, output to it ends before the handler runs.
    """

    def leave_and_handle(number: int, frame: FrameType | None) -> None:
        leave_terminal()
        handler(number, frame)

    for number in STOPS:
        if number != signal.SIGHUP:
            signal.signal(number, handler)
        elif signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, leave_and_handle)


@contextmanager
def stopped_by(handler: Handler) -> Iterator[None]:
    """Call a handler at each signal to stop within a block, as `at_stop` does."""
    before = {number: signal.getsignal(number) for number in STOPS}
    at_stop(handler)
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier or signal.SIG_DFL)


@contextmanager
def interruptible(handlers: Mapping[signal.Signals, Any]) -> Iterator[None]:
    """Replace handlers within a block, and ignore Ctrl-C after it.

    After the block the process only ends: a KeyboardInterrupt in a finalizer prints a traceback.
    """
    try:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def leave_terminal() -> None:
    """End output to a closed terminal, where each line would raise an error."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        try:
            if stat.S_ISCHR(os.fstat(stream).st_mode):
                os.dup2(nowhere, stream)
        except OSError:  # closed already
            continue
    os.close(nowhere)
