"""Workers that compute updates: at once in replay, in a thread beside the callbacks on board."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol

Clock = Callable[[], float]  # seconds of a monotonic clock; cores have none of their own

DURATIONS_KEPT = 3600  # of the latest updates, an hour's


class Worker(Protocol):
    """Computes one update at a time."""

    durations: deque[float]

    def submit(self, work: Callable[[], Any]) -> None:
        """Start some work; nothing else may be under way."""

    def collect(self) -> Any | None:
        """Result of the work, None while it is still under way; errors of the work are raised."""

    def cancel(self) -> None:
        """Forget the work under way."""

    def close(self) -> None:
        """Stop for good."""


def _timed(work: Callable[[], Any], clock: Clock, durations: deque[float]) -> Any:
    begin = clock()
    result = work()
    durations.append(clock() - begin)
    return result


class InlineWorker:
    """Computes at once, in the calling thread: the same bag gives the same bits."""

    def __init__(self, clock: Clock) -> None:
        """Measure durations by this clock."""
        self._clock = clock
        self._result: Any | None = None
        self._error: Exception | None = None
        self.durations: deque[float] = deque(maxlen=DURATIONS_KEPT)

    def submit(self, work: Callable[[], Any]) -> None:
        """Compute the work."""
        try:
            self._result = _timed(work, self._clock, self.durations)
        except Exception as error:
            self._error = error

    def collect(self) -> Any | None:
        """Give the result, once."""
        result, error = self._result, self._error
        self.cancel()
        if error is not None:
            raise error
        return result

    def cancel(self) -> None:
        """Forget the result."""
        self._result, self._error = None, None

    def close(self) -> None:
        """Nothing to stop."""


class ThreadWorker:
    """Computes in one thread of its own, so that callbacks never wait.

    With `wait`, `collect` waits for the result: a node replayed faster than real time then gives
    the same numbers as the cores alone.
    """

    def __init__(self, clock: Clock, *, wait: bool = False) -> None:
        """Measure durations by this clock."""
        self._clock = clock
        self._wait = wait
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="update")
        self._future: Future[Any] | None = None
        self.durations: deque[float] = deque(maxlen=DURATIONS_KEPT)

    def submit(self, work: Callable[[], Any]) -> None:
        """Start the work in the thread."""
        self._future = self._executor.submit(_timed, work, self._clock, self.durations)

    def collect(self) -> Any | None:
        """Give the result if it is there."""
        future = self._future
        if future is None or not (self._wait or future.done()):
            return None
        self._future = None
        return None if future.cancelled() else future.result()

    def cancel(self) -> None:
        """Forget the work under way; it runs out unseen."""
        if self._future is not None:
            self._future.cancel()
        self._future = None

    def close(self) -> None:
        """Begin nothing more; do not wait for the work under way, whose result is not needed."""
        self._executor.shutdown(wait=False, cancel_futures=True)
