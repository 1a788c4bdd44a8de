"""A whole fleet: every car a task, what came of them on disk, one run at a time."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from evpinn_ros.common.errors import as_input_error
from evpinn_ros.common.writer import Held, mark
from evpinn_ros.extras.fleet.car import CarDone, CarTask, learn_car
from evpinn_ros.extras.fleet.executor import Executor, TaskOutcome
from evpinn_ros.extras.fleet.manifest import CarDrives

CARS, LOCK, STOP = "cars", ".lock", ".stop"


@contextmanager
def claimed(out: Path) -> Iterator[None]:
    """Make the folder of the results, for this run alone.

    Raises:
        InputError: it cannot be made, or another run writes there.
    """
    with as_input_error(out):
        out.mkdir(parents=True, exist_ok=True)
    with as_input_error(out / LOCK):
        lock = Held(out / LOCK, f"{out}: another evpinn fleet writes there")
    with lock:
        with as_input_error(out):
            (out / STOP).unlink(missing_ok=True)
        yield


def car_folder(out: Path, car: CarDrives) -> Path:
    """Folder of a car's files."""
    return out / CARS / car.folder_name


def learn_fleet(
    cars: Sequence[CarDrives], out: Path, executor: Executor
) -> Generator[TaskOutcome[CarTask, CarDone], None, None]:
    """Learn every car; whatever ends the iteration, what was begun ends soon after, in order."""
    tasks = (CarTask(car, car_folder(out, car), out / STOP) for car in cars)
    try:
        yield from executor.outcomes(learn_car, tasks)
    except BaseException:
        mark(out / STOP)
        raise
    finally:
        executor.close()
