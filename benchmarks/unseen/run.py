"""Scores every method on every car; each pair is a task for a process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import lru_cache, partial
import importlib.util
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.truth import VEHICLES
from benchmarks.unseen.baselines import BASELINES
from benchmarks.unseen.drives import UnseenCar, load_car
from benchmarks.unseen.method import Factory, OnlineChain
from benchmarks.unseen.protocols import run_car
from benchmarks.unseen.summary import summary
from benchmarks.unseen.truth import DRIVES, KINDS, SECONDS, errors, run_truth, truth_summary
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.errors import InputError, known_names, near_names
from evpinn_ros.common.opener import check_file

CORE, WEAK_LS = "core", "weak_ls"
INTERFACE = ("add_reading", "begin_next_drive", "combinations")
METHODS: Mapping[str, Factory] = {**BASELINES, CORE: OnlineChain}


class Task(NamedTuple):
    """One method on one car."""

    data: str
    car: str
    method: str


class TaskResult(NamedTuple):
    """Result of a task, for the table and the JSON."""

    task: Task
    vehicle: str
    drives: int
    hours: float
    scores: dict[str, Any]


def find_method(name: str) -> Factory:
    """A method of this package by its name, or the class in `FILE.py:CLASS`.

    Raises:
        InputError: there is no such method.
    """
    if name in METHODS:
        return METHODS[name]
    path, _, attribute = name.rpartition(":")
    spec = importlib.util.spec_from_file_location("user_method", path) if path else None
    if spec is None or spec.loader is None:
        raise InputError(
            f"no method '{name}', which may be FILE.py:CLASS{known_names(name, METHODS)}"
        )
    check_file(Path(path))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not hasattr(module, attribute):
        raise InputError(f"{path}: holds no '{attribute}'{near_names(attribute, vars(module))}")
    method: Factory = getattr(module, attribute)
    missing = [n for n in INTERFACE if isinstance(method, type) and not hasattr(method, n)]
    if missing:
        raise InputError(f"{path}: {attribute} has no {', '.join(missing)} (CONTRIBUTING.md)")
    return method


def run_task(task: Task, tell: Callable[[float], None] = lambda share: None) -> TaskResult:
    """Score one method on one car; `tell` takes the finished share."""
    limit_blas_threads()
    factory = find_method(task.method)
    if task.car in KINDS:
        scores: dict[str, Any] = {"truth": run_truth(task.car, factory)}
        return TaskResult(task, ", ".join(VEHICLES), DRIVES, DRIVES * SECONDS / 3600.0, scores)
    car = _car(task.data, task.car)
    run = run_car(car, factory, tell)
    scores = summary(run)
    if car.truth:
        scores["truth"] = truth_summary([errors(run.combinations, car.truth)])
        scores["true"] = car.truth
    return TaskResult(task, car.vehicle.key, len(car.drives), car.hours, scores)


def run_tasks(
    tasks: Sequence[Task], jobs: int, tell: Callable[[float], None]
) -> Iterator[TaskResult]:
    """Yields the result of each task as it ends, from `jobs` processes; 1: from this process.

    In this process, `tell` takes the number of finished tasks, with the share of the present one.
    """
    if jobs == 1:
        for number, task in enumerate(tasks):
            yield run_task(task, partial(_tell_share, tell, number))
        return
    with ProcessPoolExecutor(jobs) as pool:
        running = [pool.submit(run_task, task) for task in tasks]
        try:
            for future in as_completed(running):
                yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _tell_share(tell: Callable[[float], None], number: int, share: float) -> None:
    tell(number + share)


@lru_cache(maxsize=1)
def _car(data: str, key: str) -> UnseenCar:
    """Cached, because successive tasks are on the same car."""
    return load_car(data, key)
