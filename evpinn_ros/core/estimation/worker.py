"""Workers that compute one update at a time: at once in replay, in a thread on board."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

Clock = Callable[[], float]  # seconds of a monotonic clock; cores have none of their own

DURATIONS_KEPT = 3600  # of the latest updates, an hour's


class InlineWorker:
    """Computes at once, in the calling thread: the same bag gives the same bits.

    Attributes:
        durations: of the latest updates, s.
    """

    def __init__(self, clock: Clock) -> None:
        """Measure durations by this clock."""
        self._clock = clock
        self._outcome: tuple[Any, Exception | None] = None, None
        self.durations: deque[float] = deque(maxlen=DURATIONS_KEPT)

    def submit(self, work: Callable[[], Any]) -> None:
        """Start some work; nothing else may be under way."""
        try:
            self._outcome = self._timed(work), None
        except Exception as error:
            self._outcome = None, error

    def collect(self) -> Any | None:
        """Result of the work, once; None while it is under way; errors of the work are raised."""
        result, error = self._outcome
        self._outcome = None, None
        if error is not None:
            raise error
        return result

    def cancel(self) -> None:
        """Discard the work under way; it may still run to its end."""
        self._outcome = None, None

    def close(self) -> None:
        """Stop for good, without waiting for the work under way."""

    def _timed(self, work: Callable[[], Any]) -> Any:
        begin = self._clock()
        result = work()
        self.durations.append(self._clock() - begin)
        return result


class ThreadWorker(InlineWorker):
    """Computes in one thread of its own, so that callbacks never wait.

    With `wait`, `collect` waits for the result: a node replayed faster than real time then gives
    the same numbers as the cores alone.
    """

    def __init__(self, clock: Clock, *, wait: bool = False) -> None:
        """Measure durations by this clock."""
        super().__init__(clock)
        self._wait = wait
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="update")
        self._future: Future[Any] | None = None

    def submit(self, work: Callable[[], Any]) -> None:
        """Start the work in the thread."""
        self._future = self._executor.submit(self._timed, work)

    def collect(self) -> Any | None:
        """Result of the work if it is ready, else None."""
        future = self._future
        if future is None or not (self._wait or future.done()):
            return None
        self._future = None
        return None if future.cancelled() else future.result()

    def cancel(self) -> None:
        """Discard the work under way."""
        if self._future is not None:
            self._future.cancel()
        self._future = None

    def close(self) -> None:
        """Cancel work that has not begun; do not wait for work that has."""
        self._executor.shutdown(wait=False, cancel_futures=True)
