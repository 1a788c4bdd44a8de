"""Where tasks run: real processes, and a real Dask cluster of one worker."""

from functools import partial
import math
import operator
import os
import socket
import threading

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.extras.fleet.executor import DaskExecutor, LocalExecutor
from test.waiting import wait_until


@pytest.fixture(scope="module")
def dask():
    """The address of a scheduler with one worker in a process of its own."""
    distributed = pytest.importorskip("distributed", reason="the extra fleet is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(params=["local", "dask"])
def executor(request):
    if request.param == "local":
        made = LocalExecutor(1)
    else:
        made = DaskExecutor(request.getfixturevalue("dask"))
    yield made
    made.close()


def test_every_task_has_its_outcome(executor):
    outcomes = {
        outcome.task: outcome for outcome in executor.outcomes(math.sqrt, [4.0, -1.0, 9.0])
    }
    assert outcomes[4.0].result == 2.0 and outcomes[9.0].result == 3.0
    assert outcomes[-1.0].result is None and "ValueError" in outcomes[-1.0].problem


def test_a_worker_that_dies_costs_its_own_task_alone():
    end, roots = partial(os._exit, 1), [partial(math.sqrt, x) for x in (4.0, 9.0, 16.0)]
    executor = LocalExecutor(2)
    call = operator.methodcaller("__call__")
    outcomes = list(executor.outcomes(call, [end, roots[0], end, *roots[1:]]))
    executor.close()
    assert [outcome.task for outcome in outcomes if outcome.problem].count(end) == 2
    assert sorted(outcome.result for outcome in outcomes if outcome.problem is None) == [
        2.0,
        3.0,
        4.0,
    ]


def test_what_does_not_answer_leaves_nothing_that_a_later_cluster_could_wait_for(monkeypatch):
    pytest.importorskip("distributed", reason="the extra fleet is not installed")
    monkeypatch.setattr("evpinn_ros.extras.fleet.executor.PATIENCE", 1)
    before = threading.active_count()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        for address in (f"tcp://127.0.0.1:{silent.getsockname()[1]}", "tcp://127.0.0.1:1", "no"):
            with pytest.raises(InputError, match=r"no scheduler answers: ."):
                DaskExecutor(address)
    wait_until(lambda: threading.active_count() == before)
