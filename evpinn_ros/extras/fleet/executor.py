"""Run tasks on the cores of this machine, or on a Dask cluster.

Both executors hold few tasks at a time, and yield each with its result as it ends; a task that
fails, or kills its worker, yields a problem.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
import multiprocessing
import os
import signal
import threading
from typing import Any, Generic, TypeAlias, TypeVar

from evpinn_ros.common.errors import InputError, one_line, with_kind
from evpinn_ros.common.optional import optional_imports

Task = TypeVar("Task")
Result = TypeVar("Result")

PATIENCE = 10  # s for a cluster to answer
WORKER_PATIENCE = 10  # s to wait for a worker of a cluster


@dataclass(frozen=True, slots=True)
class TaskOutcome(Generic[Task, Result]):
    """A task with its result, or with the problem in one line."""

    task: Task
    result: Result | None
    problem: str | None


class LocalExecutor:
    """Runs tasks in processes, each in its own pool, so that a killed one loses only its task."""

    def __init__(self, workers: int | None = None) -> None:
        self._count = workers or len(os.sched_getaffinity(0))
        self._pools: set[ProcessPoolExecutor] = set()

    def outcomes(
        self, work: Callable[[Task], Result], tasks: Iterable[Task]
    ) -> Iterator[TaskOutcome[Task, Result]]:
        """Outcome of each task, in order of their ends."""
        left = iter(tasks)
        running: dict[Future[Result], tuple[ProcessPoolExecutor, Task]] = {}
        for task in islice(left, self._count):
            pool = self._worker()
            running[pool.submit(work, task)] = (pool, task)
        while running:
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                pool, task = running.pop(future)
                error = future.exception()
                for following in islice(left, 1):
                    if isinstance(error, BrokenProcessPool):
                        pool = self._worker()
                    running[pool.submit(work, following)] = (pool, following)
                yield _outcome(task, future, error)

    def close(self) -> None:
        """Start no more tasks, and wait for the running ones."""
        for pool in self._pools:
            pool.shutdown()

    def _worker(self) -> ProcessPoolExecutor:
        """Starts a worker that ignores Ctrl-C and exits with its parent."""
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(1, mp_context=context, initializer=_end_with_parent)
        self._pools.add(pool)
        with _interrupts_ignored():
            pool.submit(int)
        return pool


class DaskExecutor:
    """Runs tasks on Dask workers, which must see the same files under the same paths."""

    def __init__(self, address: str) -> None:
        """Connect to a scheduler; InputError if Dask, an answer or a worker is missing."""
        with optional_imports():
            from distributed import Client
        self._running: dict[Any, Any] = {}
        try:
            asyncio.run(_identify(address))
            self._client = Client(address, timeout=PATIENCE, set_as_default=False)
        except Exception as error:  # an unknown server may send any answer
            why = f"no scheduler answers: {one_line(error)}"
            raise InputError(f"--scheduler {address}: {why}") from error
        try:
            self._client.wait_for_workers(1, timeout=WORKER_PATIENCE)
        except asyncio.TimeoutError as error:
            self._client.close()
            raise InputError(
                f"--scheduler {address}: has no worker; start some with "
                f"`dask worker {address} --nthreads 1`"
            ) from error

    def outcomes(
        self, work: Callable[[Task], Result], tasks: Iterable[Task]
    ) -> Iterator[TaskOutcome[Task, Result]]:
        """Outcome of each task, in order of their ends."""
        from distributed import as_completed

        left = iter(tasks)
        window = 2 * sum(self._client.nthreads().values())
        self._running = {self._begin(work, task): task for task in islice(left, window)}
        finished = as_completed(list(self._running), loop=self._client.loop)
        for future in finished:
            task = self._running.pop(future)
            for following in islice(left, 1):
                begun = self._begin(work, following)
                self._running[begun] = following
                finished.add(begun)
            error: BaseException | None = RuntimeError("the scheduler lost the task")
            if future.status in ("finished", "error"):
                error = future.exception()
            yield _outcome(task, future, error)

    def close(self) -> None:
        """Start no more tasks, and wait for the running ones, which would disturb the next run."""
        from distributed import wait as wait_for

        begun = list(self._running)
        if begun:
            with suppress(Exception, asyncio.CancelledError), self._client.as_current():
                wait_for(begun, timeout=PATIENCE)
        self._client.cancel(begun)
        self._client.close()

    def _begin(self, work: Callable[[Task], Any], task: Task) -> Any:
        return self._client.submit(work, task, pure=False)


Executor: TypeAlias = LocalExecutor | DaskExecutor


async def _identify(address: str) -> None:
    """Check that a scheduler answers, because a client without a connection cannot be closed."""
    from distributed import rpc
    from distributed.security import Security

    keys = Security().get_connection_args("client")  # from Dask's configuration, as in a client
    async with rpc(address, timeout=PATIENCE, connection_args=keys) as scheduler:
        await asyncio.wait_for(scheduler.identity(), PATIENCE)


def _outcome(task: Task, future: Any, error: BaseException | None) -> TaskOutcome[Task, Any]:
    if error is None:
        return TaskOutcome(task, future.result(), None)
    if isinstance(error, BrokenProcessPool):
        return TaskOutcome(task, None, "the worker died; is there enough memory?")
    return TaskOutcome(task, None, with_kind(error))


def _end_with_parent() -> None:
    """End this process when its parent ends, also if that is killed."""

    def watch() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Ignore Ctrl-C in a block, and always in processes started in it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
