"""A thread that answers plans, so that nothing that counts ever waits for them. Knows no ROS."""

from __future__ import annotations

from collections.abc import Callable
from queue import SimpleQueue
import threading
from typing import TypeAlias

from evpinn_ros.energy.forecaster import Forecaster

MOST_WAITING = 100  # plans or calls; who asks faster than is answered is refused
LONGEST_STOP = 5.0  # s to wait for the plan in work; the thread is a daemon

Job: TypeAlias = Callable[[Forecaster], object]


class PlanDesk:
    """Does one job after the other with a forecaster that is its own."""

    def __init__(self, forecaster: Forecaster) -> None:
        """Begin to wait for jobs; what `forecaster` shall know comes by `tell`."""
        self._forecaster = forecaster
        self._jobs: SimpleQueue[Job | None] = SimpleQueue()
        self._places = threading.Semaphore(MOST_WAITING)
        self._thread = threading.Thread(target=self._work, name="plans", daemon=True)
        self._thread.start()

    def tell(self, update: Job) -> None:
        """Let the forecaster know something, before all that is asked from now on."""
        self._jobs.put(update)

    def ask(self, job: Job) -> bool:
        """Have a plan answered, by a job that must not raise; False while too many wait."""
        if not self._places.acquire(blocking=False):
            return False

        def counted(forecaster: Forecaster) -> None:
            try:
                job(forecaster)
            finally:
                self._places.release()

        self._jobs.put(counted)
        return True

    def close(self) -> None:
        """End the thread after the job in work; what waits is dropped."""
        while not self._jobs.empty():
            self._jobs.get()
        self._jobs.put(None)
        self._thread.join(LONGEST_STOP)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            job(self._forecaster)
