from dataclasses import replace
import threading

import pytest

from evpinn_ros.core.estimation.worker import InlineWorker, ThreadWorker
from evpinn_ros.core.signals.readings import NANOSECONDS
from test.waiting import HANG_S, wait_until


def ticking():
    """A clock that goes on by a second each time it is looked at."""
    return iter(range(10**9)).__next__


@pytest.fixture
def thread_worker():
    """Threads that are stopped at the end."""
    made = []

    def make(**settings) -> ThreadWorker:
        made.append(ThreadWorker(ticking(), **settings))
        return made[-1]

    yield make
    for worker in made:
        worker.close()


@pytest.fixture
def readings(drive):
    all_of_it = drive(1, 240.0).readings
    return [r for r in all_of_it if r.stamp_ns < all_of_it[0].stamp_ns + 25 * NANOSECONDS]


def test_a_stop_does_not_wait_for_the_update_under_way(thread_worker):
    worker, go, ran = thread_worker(), threading.Event(), threading.Event()
    worker.submit(lambda: (go.wait(HANG_S), ran.set()))
    worker.close()
    assert not ran.is_set()
    go.set()
    assert ran.wait(HANG_S)


def test_a_thread_never_makes_the_caller_wait(thread_worker):
    worker, go, ran = thread_worker(), threading.Event(), threading.Event()

    def work() -> str:
        assert go.wait(HANG_S)
        ran.set()
        return threading.current_thread().name

    worker.submit(work)
    assert worker.collect() is None
    go.set()
    assert ran.wait(HANG_S)
    result = wait_until(worker.collect)
    assert result.startswith("update") and worker.collect() is None
    assert list(worker.durations) == [1]


def test_cancelled_work_runs_out_unseen(thread_worker):
    worker, go, begun = thread_worker(wait=True), threading.Event(), threading.Event()

    def work() -> str:
        begun.set()
        assert go.wait(HANG_S)
        return "unseen"

    worker.submit(work)
    assert begun.wait(HANG_S)
    worker.cancel()
    assert worker.collect() is None
    worker.submit(lambda: "seen")
    go.set()
    assert worker.collect() == "seen"


def test_an_update_that_fails_is_counted_and_the_next_begins(new_estimator, play, readings):
    class Failing(InlineWorker):
        def submit(self, work) -> None:
            def fails() -> None:
                raise ArithmeticError("singular")

            super().submit(fails)

    estimator = new_estimator(Failing(ticking()))
    assert len(play(estimator, readings)) > 700
    status = estimator.status()
    assert status.updates > 1  # one for each interval of 10 s
    assert set(status.rejected) == {"failed_ArithmeticError"}
    assert status.rejected["failed_ArithmeticError"] >= status.updates - 1


@pytest.mark.slow
def test_a_thread_that_is_waited_for_gives_the_numbers_of_a_replay(
    new_estimator, play, thread_worker, readings
):
    inline = play(new_estimator(), readings)
    threaded = play(new_estimator(thread_worker(wait=True)), readings)
    assert [repr(o) for o in threaded] == [repr(o) for o in inline]
    assert len(inline) > 700


def test_updates_that_take_too_long_are_counted(new_estimator, play, thread_worker, readings):
    """The thread is held up: each second that passes is an overrun, and nothing else begins."""
    worker, go = thread_worker(), threading.Event()
    worker.submit(lambda: go.wait(HANG_S))  # what the update has to wait for
    estimator = new_estimator(worker)
    play(estimator, readings)
    status = estimator.status()
    assert (status.updates, status.accepted) == (1, 0)
    # The first interval ends after some seconds; then each of the last seconds is one.
    assert status.rejected["overrun"] >= 10
    assert set(status.rejected) == {"overrun"}
    go.set()
    worker._executor.submit(int).result(HANG_S)  # the update is done before this
    last = readings[-1].stamp_ns
    speed = next(r for r in readings if hasattr(r, "speed"))
    later = [replace(speed, stamp_ns=last + k * NANOSECONDS // 2) for k in range(1, 4)]
    play(estimator, later)
    # It is taken at last, and the next begins.
    assert (estimator.status().updates, estimator.status().accepted) == (2, 1)
