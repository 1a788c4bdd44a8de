"""The one place where a test waits: for a condition, never for a time."""

from __future__ import annotations

from collections.abc import Callable
import time
from typing import TypeVar

Value = TypeVar("Value")

HANG_S = 120.0
"""Ends a test that hangs; no test may depend on it."""


def pause() -> None:
    """Leaves the processor to others for some milliseconds."""
    time.sleep(0.005)


def wait_until(
    condition: Callable[[], Value],
    timeout: float = HANG_S,
    *,
    meanwhile: Callable[[], object] = pause,
    report: Callable[[], object] = lambda: "",
) -> Value:
    """Returns the first true value of a condition.

    Args:
        condition: asked again and again.
        timeout: s until a hang is reported; at least 60.
        meanwhile: run between two questions, such as a step of an executor.
        report: what the failure shows of a hang, such as the output of a process.

    Raises:
        AssertionError: the condition did not become true.
    """
    end = time.monotonic() + timeout
    while not (value := condition()):
        assert time.monotonic() < end, f"still waiting after {timeout:g} s: {report()}"
        meanwhile()
    return value
