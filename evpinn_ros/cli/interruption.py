"""Ctrl-C that waits until results are whole."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType

import typer

from evpinn_ros.cli.console import note
from evpinn_ros.common.errors import InputError

INTERRUPTED = 130  # 128 + SIGINT, as shells have it


class Interruption:
    """Notes the first Ctrl-C while it is entered, for work that stops between two readings.

    What the work then writes is whole, up to there; the command ends with 130. A second Ctrl-C
    does not wait. Where Ctrl-C is ignored, as in the background of a script, it stays so.

    Attributes:
        asked: whether to stop.
    """

    def __init__(self) -> None:
        self.asked = False
        self._deferred = False

    def __enter__(self) -> Interruption:
        self._deferred = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if self._deferred:
            signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        _: TracebackType | None,
    ) -> None:
        if self._deferred:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if self.asked and (error is None or isinstance(error, InputError | typer.Exit)):
            reason = error if isinstance(error, InputError) else "results are up to here"
            note(f"evpinn: stopped: {reason}")
            raise typer.Exit(INTERRUPTED) from error

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            signal.default_int_handler(number, frame)
        self.asked = True
