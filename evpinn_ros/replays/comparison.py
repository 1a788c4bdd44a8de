"""Compares drives of one car by breakdowns from one model, learned from all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.errors import InputError
from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units
from evpinn_ros.core.estimation.breakdown import CONSUMPTION_METRES, Breakdown, Breakdowns
from evpinn_ros.core.estimation.estimator import Mode
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.logs.source import Source
from evpinn_ros.replays.car import CarReplay
from evpinn_ros.replays.drive_names import short_names
from evpinn_ros.replays.driven import measured_steps, rising
from evpinn_ros.replays.energy_metrics import NOTHING, PAPER, breakdown_metrics
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.run import Progress
from evpinn_ros.replays.scoring import running_total


class DriveCurves(NamedTuple):
    """Values at even distances; shape (n,) each, NaN where unknown."""

    distance: np.ndarray  # km or miles
    # measured since the start, kWh; constant while the battery is not measured, or is charged
    energy: np.ndarray
    speed: np.ndarray  # mean since the point before, km/h or mi/h
    height: np.ndarray  # m or feet, if altitude was recorded


def distance_until(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Time, s, and distance driven by then, m, of each speed, without gaps; shape (n,) each."""
    time, speed = rising(drive.speed).T
    return time, running_total(time, np.abs(speed))


def over_distance(drive: Drive, points: int, units: Units = METRIC) -> DriveCurves:
    """Curves of a drive at `points` even distances."""
    time, metres = distance_until(drive)
    at = np.linspace(0.0, metres[-1], points)
    moments = np.interp(at, metres, time)
    speed = np.full(points, np.nan)
    speed[1:] = np.diff(at) / np.maximum(np.diff(moments), 1e-3) * units.speeds
    steps = measured_steps(drive)
    energy = _at(moments, steps.end, np.cumsum(steps.energy), left=0.0) / JOULES_PER_KWH
    height = _at(moments, *drive.altitude.T, left=np.nan, right=np.nan) / units.height_metres
    return DriveCurves(at / units.metres, energy, speed, height)


def _at(moments: np.ndarray, time: np.ndarray, values: np.ndarray, **ends: float) -> np.ndarray:
    if not len(time):
        return np.full(len(moments), np.nan)
    order = np.argsort(time, kind="stable")
    return np.asarray(np.interp(moments, time[order], values[order], **ends))


Bar = Callable[[Source], AbstractContextManager[Progress]]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Drives of one car; each other drive is compared with the first."""

    vehicle: Vehicle  # of all drives
    paths: tuple[Path, ...]  # input of each drive
    names: tuple[str, ...]  # short and unique
    drives: tuple[Drive, ...]  # series of each
    breakdowns: Breakdowns  # of each drive, by the final model, with their covariance
    problems: tuple[str, ...] = ()  # unreadable inputs

    def parts(self) -> list[Breakdown]:
        """The breakdown of each drive."""
        return [breakdown for i in range(len(self.drives)) if (breakdown := self.breakdowns.of(i))]

    def differences(self) -> list[Breakdown]:
        """Difference of every other drive from the first, for 100 km each."""
        return [self.breakdowns.difference(i, 0) for i in range(1, len(self.drives))]

    def metrics(self) -> dict[str, Any]:
        """The comparison as values for scripts; `breakdown` as in the metrics of a replay."""
        mode = Mode.HYBRID.value
        pairs = zip(self.names[1:], self.differences(), strict=True)
        return {
            "vehicle": self.vehicle.key,
            "drives": [
                {"name": name, "path": str(path), "breakdown": breakdown_metrics(breakdown, mode)}
                for name, path, breakdown in zip(self.names, self.paths, self.parts(), strict=True)
            ],
            "differences": [
                {
                    "drive": name,
                    "less": self.names[0],
                    "breakdown": breakdown_metrics(breakdown, mode),
                }
                for name, breakdown in pairs
            ],
        }


def compare(car: CarReplay, sources: Iterable[Source], *, progress: Bar) -> Comparison:
    """Replay all drives, the reference first, with a new `car` made with `keep_drives`.

    Raises:
        InputError: a drive is too short, its battery was not measured, or the mode is paper.
    """
    breakdowns = _breakdowns(car)
    paths: list[Path] = []
    owners: list[int] = []  # drive of each breakdown: a long stop begins another breakdown
    for number, source in enumerate(sources):
        with progress(source) as report:
            car.replay(source, progress=report)
        breakdowns = _breakdowns(car)
        new = breakdowns.drives[len(owners) :]
        owners += [number for drive in new if drive.seconds]
        if sum(drive.distance for drive in new) < CONSUMPTION_METRES:
            raise InputError(f"{source.path}: where its energy went is {NOTHING}")
        paths.append(source.path)
    return Comparison(
        vehicle=car.vehicle,
        paths=tuple(paths),
        names=short_names(paths),
        drives=tuple(replayed.drive for replayed in car.results),
        breakdowns=breakdowns.joined(
            owners + owners[-1:] * (len(breakdowns.drives) - len(owners))
        ),
        problems=tuple(replayed.problem for replayed in car.results if replayed.problem),
    )


def _breakdowns(car: CarReplay) -> Breakdowns:
    breakdowns = car.chain.estimator.breakdowns()
    if breakdowns is None:
        raise InputError(f"nothing to compare: where the energy went is {PAPER}")
    return breakdowns
