"""Ends a process whose last step hangs, by timers of the C library.

A call into the middleware that never returns keeps the interpreter, so neither a thread of Python
nor a handler of signals would get a turn; these timers need neither. What hangs, and why
no timer of Python's own will do: docs/project/upstream.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import ctypes
import faulthandler
import sys
import time
from typing import Any

IN_A_THREAD = 2  # SIGEV_THREAD: at its time the timer calls a function, in a thread of its own
AFTER_THE_DUMP = 0.1  # s, so that no two threads write at once


class _Event(ctypes.Structure):
    """`sigevent` of sigevent(7)."""

    _fields_ = (
        ("argument", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("kind", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("rest", ctypes.c_void_p * 8),
    )


class _Due(ctypes.Structure):
    """`itimerspec` of timer_settime(2)."""

    _fields_ = (("period", ctypes.c_long * 2), ("seconds", ctypes.c_long), ("ns", ctypes.c_long))


@contextmanager
def deadline(seconds: float, reason: str, code: int) -> Iterator[None]:
    """End the process with `code` when the block takes longer.

    It writes first where it hangs and the reason, to stderr. Without POSIX timers there is no
    limit.
    """
    lib, line, timers = ctypes.CDLL(None), ctypes.c_char_p(reason.encode()), []
    with suppress(AttributeError, OSError):
        if sys.stderr is not None:  # whoever started us may have closed it
            faulthandler.dump_traceback_later(seconds, file=2)
            timers += [_timer(lib, seconds + AFTER_THE_DUMP, lib.warnx, line)]
        timers += [_timer(lib, seconds + 2 * AFTER_THE_DUMP, lib._exit, ctypes.c_void_p(code))]
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        for timer in timers:
            lib.timer_delete(timer)


def _timer(
    lib: ctypes.CDLL, seconds: float, function: Any, argument: ctypes.c_char_p | ctypes.c_void_p
) -> ctypes.c_void_p:
    """A timer that calls a function of C with one argument, once."""
    given, address = (ctypes.cast(each, ctypes.c_void_p) for each in (argument, function))
    event, timer = _Event(given, 0, IN_A_THREAD, address), ctypes.c_void_p()
    due = _Due((0, 0), int(seconds), int(seconds % 1 * 1e9))
    if lib.timer_create(time.CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) != 0:
        raise OSError("no timer")
    lib.timer_settime(timer, 0, ctypes.byref(due), None)
    return timer
