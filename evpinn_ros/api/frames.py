"""Series and scores of a replay as DataFrames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from evpinn_ros.replays.driven import rising
from evpinn_ros.replays.forecasts import forecast_outcomes
from evpinn_ros.replays.history import Drive, PowerSeries
from evpinn_ros.replays.scoring import measured_at, running_total

TIME = "t_s"
PARAMETER_COLUMNS = ("value", "std", "prior_share", "lower", "upper", "state")
AMOUNT_COLUMNS = ("kwh", "sigma_kwh", "kwh_per_100km", "share")
FORECAST_COLUMNS = ("begin_s", "end_s", "measured_j", "forecast_j", "sigma_j", "covered")


def power(drive: Drive) -> pd.DataFrame:
    """Speed, measured power and both predictions, at the times of either prediction."""
    both = _predictions(drive.newest, "predicted").join(
        _predictions(drive.smoothed, "smoothed"), how="outer"
    )
    time = both.index.to_numpy()
    measured, known = measured_at(drive, time)
    both.insert(0, "speed_mps", np.interp(time, *rising(drive.speed).T))
    both.insert(1, "measured_w", np.where(known, measured, np.nan))
    return both


def _predictions(series: PowerSeries, name: str) -> pd.DataFrame:
    columns = {f"{name}_w": series.power, f"{name}_sigma_w": series.sigma}
    found = pd.DataFrame(columns, index=pd.Index(series.time, name=TIME))
    return found[~found.index.duplicated()]


def energy(drive: Drive) -> pd.DataFrame:
    """Measured and predicted energy at the times of the prediction."""
    time, predicted, rknn, sigma = drive.energy.T
    columns = {
        "measured_j": _measured_energy(drive.measured, time),
        "predicted_j": predicted,
        "predicted_sigma_j": sigma,
        "rknn_j": rknn,
    }
    return pd.DataFrame(columns, index=pd.Index(time, name=TIME))


def _measured_energy(measured: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Integral of measured power up to some times, J; NaN before the first and after the last."""
    if len(measured) < 2:
        return np.full(len(time), np.nan)
    total = running_total(*measured.T)
    found: np.ndarray = np.interp(time, measured[:, 0], total, left=np.nan, right=np.nan)
    return found


def parameters(found: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """The metrics under `parameters`, a row each."""
    return _rows(found, "parameter", PARAMETER_COLUMNS)


def learning(drive: Drive) -> pd.DataFrame:
    """Parameters over time."""
    columns = {
        name: pd.DataFrame(rows[:, 1:], rows[:, 0], ["value", "std", "prior_share"])
        for name, rows in drive.parameters.items()
    }
    return pd.concat(columns, axis=1).rename_axis(TIME)


def breakdown(found: Mapping[str, Any]) -> pd.DataFrame:
    """The metrics under `breakdown`, a row a part."""
    parts = {name: part for name, part in found.items() if isinstance(part, dict)}
    return _rows(parts, "part", AMOUNT_COLUMNS)


def forecasts(drive: Drive, air_density: float) -> pd.DataFrame:
    """Forecast against outcome, a row a part of the drive."""
    rows = [
        (*each.span, each.measured, each.forecast, each.sigma, each.covered)
        for each in forecast_outcomes(drive, air_density)
    ]
    return pd.DataFrame(rows, columns=list(FORECAST_COLUMNS))


def _rows(
    found: Mapping[str, Mapping[str, Any]], name: str, columns: tuple[str, ...]
) -> pd.DataFrame:
    table = pd.DataFrame.from_dict(found, orient="index", columns=list(columns))
    numbers = [column for column in columns if column != "state"]
    return table.astype(dict.fromkeys(numbers, float)).rename_axis(name)
