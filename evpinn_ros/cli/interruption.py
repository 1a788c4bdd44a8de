"""Delays Ctrl-C, SIGTERM and the closing of the terminal until results are written."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Any

import typer

from evpinn_ros.cli.console import note
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.stopping import STOPS, leave_terminal

INTERRUPTED = 130  # 128 + SIGINT, the exit code of shells


class Interruption:
    """Records the first stop signal, so that results are written; a second Ctrl-C ends at once.

    The exit code is 128 plus the signal's number. A signal that was ignored stays ignored.
    """

    def __init__(self) -> None:
        self.asked = False
        """Whether a signal asked to stop."""
        self._code = INTERRUPTED
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interruption:
        for number in STOPS:
            before = signal.getsignal(number)
            if before in (signal.default_int_handler, signal.SIG_DFL):
                self._before[number] = before
                signal.signal(number, self._note)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        _: TracebackType | None,
    ) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        if self.asked and (error is None or isinstance(error, InputError | typer.Exit)):
            reason = error if isinstance(error, InputError) else "results cover the work so far"
            note(f"evpinn: stopped: {reason}")
            raise typer.Exit(self._code) from error

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            if number == signal.SIGINT:
                signal.default_int_handler(number, frame)
            return
        if number == signal.SIGHUP:
            leave_terminal()
        self.asked, self._code = True, 128 + number
