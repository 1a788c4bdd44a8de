"""Learns one car from its drives in order of time, each from the state after the previous one.

Every drive starts from the saved state, never from memory, so a stopped run gives the same numbers
and a failing drive changes nothing. The folder of the car has `state.json` for `evpinn replay
--state`, and `result.json`: rows with the fingerprint of their input, and the evidence. A later
run continues, or starts anew if an earlier drive changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import hashlib
from itertools import product
import json
from pathlib import Path
import time
from typing import Any

from evpinn_ros import __version__
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.errors import InputError, as_input_error, with_kind
from evpinn_ros.core.estimation.estimate import TRACKED, Trust
from evpinn_ros.core.estimation.estimator import EstimatorSettings, evidence_of_state
from evpinn_ros.core.estimation.evidence import NO_EVIDENCE
from evpinn_ros.core.estimation.learner import STATE_VERSION
from evpinn_ros.core.estimation.state_file import read_state, write_state
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.extras.fleet.manifest import CarDrives
from evpinn_ros.logs.sources import open_source
from evpinn_ros.replays.chain import Chain
from evpinn_ros.replays.run import Replayed, ReplayOptions, replay
from evpinn_ros.replays.trends import DrivePoint, drive_point

NUMBERS = {
    "duration_s": ("input", "duration_s"),
    "power_rmse_w": ("power", "rmse_w"),
    "power_coverage_90": ("power", "coverage_90"),
    "energy_measured_j": ("energy", "measured_j"),
    "energy_predicted_j": ("energy", "predicted_j"),
    "energy_error_percent": ("energy", "error_percent"),
}
"""Columns of scores, with the keys of each in the metrics."""
POINT = DrivePoint._fields
PARAMETERS = {
    name + ("" if figure == "value" else f"_{figure}"): (name, figure)
    for figures in (TRACKED, ("state",))
    for name, figure in product(PARAMETER_NAMES, figures)
}
"""Columns of parameters: name and figure of each."""


def drive_row(replayed: Replayed) -> dict[str, Any]:
    """The scores of a drive and the parameters of the car after it."""
    metrics, point = replayed.metrics, drive_point(replayed.drive)
    parameters = metrics["parameters"]
    return {
        "problem": replayed.problem,
        "samples": metrics["input"]["samples"],
        **{column: metrics[part][name] for column, (part, name) in NUMBERS.items()},
        **({} if point is None else point._asdict()),
        **{
            column: parameters[name][figure]
            for column, (name, figure) in PARAMETERS.items()
            if name in parameters
        },
    }


def failed_row(problem: str) -> dict[str, Any]:
    """The row of a failed drive; other columns than the problem are unknown."""
    return {"problem": problem, "samples": 0}


def point_of(row: Mapping[str, Any]) -> DrivePoint | None:
    """Point of a drive for trends, from its row; None if short or failed."""
    known = row.get("distance_m") is not None
    return DrivePoint(*(row[name] for name in POINT)) if known else None


def impossible(row: Mapping[str, Any]) -> list[str]:
    """Names of parameters that are invalid after a drive."""
    return [name for name in PARAMETER_NAMES if row.get(f"{name}_state") == Trust.INVALID.value]


STATE_FILE, RESULT_FILE = "state.json", "result.json"
LAYOUT = 2  # of the result file


class StoppedError(Exception):
    """The user stopped the run."""


@dataclass(frozen=True, slots=True)
class CarTask:
    """Task of a worker: one car."""

    drives: CarDrives  # of the car
    folder: Path  # of its files; every worker must see it, and the drives
    stop: Path  # a file that ends the task once it exists


@dataclass(frozen=True, slots=True)
class CarDone:
    """Numbers of drives of a car."""

    car: str
    learned: int  # in this run
    kept: int  # learned in earlier runs
    failed: int  # of all


def car_folder(out: Path, car: CarDrives) -> Path:
    """Folder of a car's files, in the folder of the results."""
    return out / "cars" / car.folder_name


def learn_car(task: CarTask) -> CarDone:
    """Learn the drives not learned yet.

    Raises:
        StoppedError: the user stopped the run.
        InputError: the car's files cannot be written.
    """
    limit_blas_threads()
    _stop_if(task.stop)
    vehicle = task.drives.vehicle
    learned = _CarFiles(task.folder, vehicle)
    inputs = [_Input.of(path, learned) for path in task.drives.drives]
    ordered = sorted((drive for drive in inputs if drive.problem is None), key=_Input.order)
    kept = learned.keep([drive.fingerprint for drive in ordered])
    for drive in ordered[kept:]:
        learned.add(drive, *_learn(drive, vehicle, learned.state, lambda _: _stop_if(task.stop)))
    learned.note_unreadable([drive for drive in inputs if drive.problem is not None])
    failed = len(inputs) - sum(row["samples"] > 0 for row in learned.rows)
    return CarDone(task.drives.car, len(ordered) - kept, kept, failed)


@dataclass(frozen=True, slots=True)
class _Input:
    path: Path
    fingerprint: str
    start_ns: int
    problem: str | None

    @classmethod
    def of(cls, path: Path, learned: _CarFiles) -> _Input:
        """Input of a drive; its start is known from earlier results, or read."""
        try:
            fingerprint = _fingerprint(path)
            start = learned.starts.get(fingerprint)
            start_ns = start if start is not None else _first_stamp(path, learned.vehicle)
            return cls(path, fingerprint, start_ns, None)
        except Exception as error:  # must not stop the other drives
            return cls(path, "", 0, with_kind(error))

    def order(self) -> tuple[int, str]:
        return self.start_ns, str(self.path)

    def row(self) -> dict[str, Any]:
        return {"path": str(self.path), "fingerprint": self.fingerprint, "start_ns": self.start_ns}


class _CarFiles:
    """The files of a car: reads existing results, and adds new ones."""

    def __init__(self, folder: Path, vehicle: Vehicle) -> None:
        self.vehicle, self._folder = vehicle, folder
        self._basis = _basis(vehicle)
        before = read_result(folder, vehicle)
        self.rows: list[dict[str, Any]] = before.get("drives", [])
        self.state: dict[str, Any] | None = None
        self._written = before
        self.starts: dict[str, int] = {r["fingerprint"]: r["start_ns"] for r in self.rows}

    def keep(self, fingerprints: list[str]) -> int:
        """Keep existing results of the first drives, or start anew; returns the number kept."""
        learned = [row["fingerprint"] for row in self.rows]
        if fingerprints == learned:
            return len(learned)
        state = _read(self._folder / STATE_FILE)
        is_same = self._written.get("state") == _digest_of(state)
        if is_same and fingerprints[: len(learned)] == learned:
            self.state = state or None
        else:
            self.rows, self._written = [], {}
        return len(self.rows)

    def add(self, drive: _Input, row: dict[str, Any], state: dict[str, Any] | None) -> None:
        """Write the files after another drive; `state` is None if it failed."""
        self.rows.append({**drive.row(), **row})
        self.state = state or self.state
        evidence = evidence_of_state(self.vehicle, self.state) if self.state else NO_EVIDENCE
        self._write(
            state,
            {
                "basis": self._basis,
                "state": _digest_of(self.state or {}),
                "precision": evidence.precision.tolist(),
                "information": evidence.information.tolist(),
                "drives": self.rows,
                "unreadable": self._written.get("unreadable", []),
            },
        )

    def note_unreadable(self, inputs: list[_Input]) -> None:
        """Write which drives could not be opened; every run tries them again."""
        rows = [{**drive.row(), **failed_row(drive.problem or "")} for drive in inputs]
        if self._written.get("unreadable", []) != rows or not self._written:
            nothing = {"basis": self._basis, "state": _digest_of({}), "drives": []}
            self._write(None, {**nothing, **self._written, "unreadable": rows})

    def _write(self, state: dict[str, Any] | None, result: dict[str, Any]) -> None:
        with as_input_error(self._folder):
            if state is not None:
                write_state(self._folder / STATE_FILE, state)
            write_state(self._folder / RESULT_FILE, result)
        self._written = result


def _learn(
    drive: _Input,
    vehicle: Vehicle,
    state: dict[str, Any] | None,
    progress: Callable[[float], None],
) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """The row of a drive and the state after it, None if it failed."""
    progress(0.0)
    settings = EstimatorSettings()
    chain = Chain(vehicle, settings, InlineWorker(time.perf_counter))
    try:
        if state is not None:
            chain.estimator.restore(state)
            chain.begin_next_drive()
        replayed = replay(
            open_source(drive.path, vehicle),
            chain,
            ReplayOptions(),
            vehicle=vehicle.key,
            mode=settings.mode.value,
            progress=progress,
        )
        # As JSON, so that a run continues from the same state whether read back or not.
        return drive_row(replayed), json.loads(
            json.dumps(chain.estimator.export(), allow_nan=False)
        )
    except StoppedError:
        raise
    except Exception as error:  # must not stop the other drives
        return failed_row(with_kind(error)), None


def read_result(folder: Path, vehicle: Vehicle) -> dict[str, Any]:
    """Saved result; empty if none, or if made by another version or from another vehicle file."""
    result = _read(folder / RESULT_FILE)
    return result if result.get("basis") == _basis(vehicle) else {}


def _basis(vehicle: Vehicle) -> str:
    return _digest([repr(vehicle), __version__, str(STATE_VERSION), str(LAYOUT)])


def _stop_if(file: Path) -> None:
    if file.exists():
        raise StoppedError


def _first_stamp(path: Path, vehicle: Vehicle) -> int:
    readings = open_source(path, vehicle).readings()
    for reading in readings:
        return reading.stamp_ns
    raise InputError(f"{path}: holds no reading")


def _fingerprint(path: Path) -> str:
    """Fingerprint of a drive's files by their names, sizes and times."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    stats = [(file.name, file.stat()) for file in files if file.is_file()]
    return _digest([str(path), *(f"{n} {s.st_size} {s.st_mtime_ns}" for n, s in stats)])


def _digest(parts: list[str]) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:32]


def _digest_of(state: dict[str, Any]) -> str:
    return _digest([json.dumps(state, sort_keys=True)])


def _read(path: Path) -> dict[str, Any]:
    try:
        return read_state(path) or {}
    except InputError:
        return {}
