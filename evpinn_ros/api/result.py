"""Result of a replay from Python."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from evpinn_ros.common.optional import pandas
from evpinn_ros.common.saved_fields import figures
from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.power_model import PowerModel
from evpinn_ros.core.estimation.breakdown import Amount
from evpinn_ros.core.estimation.car_model import CarModel
from evpinn_ros.core.estimation.estimate import FIGURES, TRACKED
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.replays.driven import rising
from evpinn_ros.replays.forecasts import forecast_outcomes, known_model
from evpinn_ros.replays.history import PowerSeries
from evpinn_ros.replays.run import Replayed, ReplayOptions
from evpinn_ros.replays.scoring import known_at, running_total
from evpinn_ros.report.owner_text import owner_line

if TYPE_CHECKING:
    import pandas as pd

TIME = "t_s"
FORECAST_COLUMNS = ("begin_s", "end_s", "measured_j", "forecast_j", "sigma_j", "covered")


@dataclass(frozen=True, repr=False)
class Result:
    """One replayed drive: its scores, and its series as DataFrames.

    Times `t_s` count from the first reading, s; after a jump of the clock they go on a minute
    later. Power and energy are positive when drawn from the battery. Unknown values are NaN.

    Attributes:
        replayed: what the tables are made from.
        vehicle: the vehicle of the drive.
        options: of the replay.
        car: the learned car at the end; None in mode paper.
        rested: the same as it starts its next drive.
        account: energy counted until the end, with what is known about the battery.
    """

    replayed: Replayed
    vehicle: Vehicle
    options: ReplayOptions
    car: CarModel | None
    rested: CarModel | None
    account: EnergyAccount

    def __repr__(self) -> str:
        """Summary of the drive in one line."""
        path = self.metrics["input"]["path"]
        line = owner_line(self.replayed.drive, self.metrics)
        return f"<Result of {path}, {self.vehicle.key}: {line}>"

    @property
    def metrics(self) -> dict[str, Any]:
        """All scores, under the keys of `evpinn replay --metrics`."""
        return self.replayed.metrics

    @property
    def problem(self) -> str | None:
        """Why part of the drive could not be read, in one line; None if all was read."""
        return self.replayed.problem

    @cached_property
    def power(self) -> pd.DataFrame:
        """Power over time, W, by `t_s`.

        Columns: `speed_mps`, m/s; `measured_w`; `predicted_w` and `predicted_sigma_w`, made at
        once (`power/predicted`); `smoothed_w` and `smoothed_sigma_w`, made as soon as the speed
        shortly afterwards is known (`power/smoothed`). No prediction uses a battery value of its
        own or a later time.
        """
        drive = self.replayed.drive
        frame = _predictions(drive.newest, "predicted").join(
            _predictions(drive.smoothed, "smoothed"), how="outer"
        )
        time = frame.index.to_numpy()
        measured, is_measured = known_at(drive.measured, time)
        frame.insert(0, "speed_mps", np.interp(time, *rising(drive.speed).T))
        frame.insert(1, "measured_w", np.where(is_measured, measured, np.nan))
        return frame

    @cached_property
    def energy(self) -> pd.DataFrame:
        """Energy since the start, J, by `t_s`.

        Columns: `measured_j`, which does not count gaps; `predicted_j`, `predicted_sigma_j`; and
        `rknn_j`, the predicted power integrated by the Runge-Kutta network.
        """
        drive = self.replayed.drive
        time, predicted, rknn, sigma = drive.energy.T
        measured = np.full(len(time), np.nan)
        if len(drive.measured) > 1:
            total = running_total(*drive.measured.T)
            measured = np.interp(time, drive.measured[:, 0], total, left=np.nan, right=np.nan)
        columns = {
            "measured_j": measured,
            "predicted_j": predicted,
            "predicted_sigma_j": sigma,
            "rknn_j": rknn,
        }
        pd = pandas()
        return pd.DataFrame(columns, index=pd.Index(time, name=TIME))

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """Parameters at the end, one row each: value, std, prior_share, lower, upper, state."""
        return parameter_frame(self.metrics["parameters"])

    @cached_property
    def learning(self) -> pd.DataFrame:
        """Parameters over time, by `t_s`: columns (parameter; value, std or prior_share)."""
        pd = pandas()
        columns = {
            name: pd.DataFrame(rows[:, 1:], rows[:, 0], [*TRACKED])
            for name, rows in self.replayed.drive.parameters.items()
        }
        return pd.concat(columns, axis=1).rename_axis(TIME)

    @cached_property
    def breakdown(self) -> pd.DataFrame:
        """Parts into which the energy went, a row each: kwh, sigma_kwh, kwh_per_100km, share."""
        return breakdown_frame(self.metrics["breakdown"])

    @cached_property
    def forecasts(self) -> pd.DataFrame:
        """Measured energy of parts of the drive, beside its forecast made when the part began.

        Columns: `begin_s`, `end_s`, `measured_j`, `forecast_j`, `sigma_j`, and `covered`, True
        if the 90 % band contains the measured energy. Empty in mode paper, and if no part is
        complete.
        """
        rows = [
            (*outcome.span, outcome.measured, outcome.forecast, outcome.sigma, outcome.covered)
            for outcome in forecast_outcomes(self.replayed.drive)
        ]
        return pandas().DataFrame(rows, columns=list(FORECAST_COLUMNS))

    @property
    def model(self) -> PowerModel:
        """The learned car, for `core.energy.forecast`; `ev.forecast` takes the result."""
        return known_model(self.car, self.replayed.drive.final, self.vehicle)

    @property
    def next_model(self) -> PowerModel:
        """The learned car as it starts its next drive: the one in its state file."""
        return known_model(self.rested, self.replayed.drive.final, self.vehicle)

    def write_report(self, path: str | os.PathLike[str]) -> None:
        """Write the HTML report of `evpinn replay --report`; OSError if it cannot be written."""
        # Imported here: pictures take longer to import than everything else together.
        from evpinn_ros.report.drive_page import write_replayed

        write_replayed(
            Path(path),
            [self.replayed],
            self.vehicle,
            self.options,
            "evpinn_ros.replay",
            gauge=self.account.gauge,
            record=None if self.rested is None else self.rested.record.sentence,
        )


def _predictions(series: PowerSeries, name: str) -> pd.DataFrame:
    columns = {f"{name}_w": series.power, f"{name}_sigma_w": series.sigma}
    pd = pandas()
    frame = pd.DataFrame(columns, index=pd.Index(series.time, name=TIME))
    return frame[~frame.index.duplicated()]


def parameter_frame(parameters: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """The metrics under `parameters`, one row each."""
    return _rows(parameters, "parameter", tuple(FIGURES))


def breakdown_frame(breakdown: Mapping[str, Any]) -> pd.DataFrame:
    """The metrics under `breakdown`, one row for each part."""
    parts = {name: part for name, part in breakdown.items() if isinstance(part, dict)}
    return _rows(parts, "part", tuple(figures(Amount)))


def _rows(
    values: Mapping[str, Mapping[str, Any]], name: str, columns: tuple[str, ...]
) -> pd.DataFrame:
    table = pandas().DataFrame.from_dict(values, orient="index", columns=list(columns))
    numbers = [column for column in columns if column != "state"]
    return table.astype(dict.fromkeys(numbers, float)).rename_axis(name)
