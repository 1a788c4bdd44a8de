"""Scores of a replayed drive: the `--metrics` of design.md, section 2.3.

Every score is predict-then-update: no prediction knew the sample it is held against. The nulls
beside them say what a score is worth: holding the last value, and, for what a random split of one
drive proves, interpolation in time.
"""

from __future__ import annotations

from collections.abc import Mapping
import resource
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.energy.quadrature import EnergyIntegral
from evpinn_ros.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.estimation.estimator import EstimatorStatus
from evpinn_ros.replay.history import Drive, PowerSeries
from evpinn_ros.signals.readings import NANOSECONDS

MAX_MEASURED_STEP = 2.5  # s; power is not held to be known between readings further apart
NULL_HOLD_OUT = 0.2  # share held out in the random split
NULL_SEED = 0


class Span(NamedTuple):
    """Part of a drive that is scored, s since its start: after `begin`, up to `end`."""

    begin: float
    end: float

    def holds(self, time: np.ndarray) -> np.ndarray:
        """Which times lie in it."""
        return (time > self.begin) & (time <= self.end)


def power_score(drive: Drive, series: PowerSeries, span: Span) -> dict[str, float | None]:
    """RMSE, MAE, R2 and coverage of the 90 % bands against measured power, null if unknown."""
    measured, known = measured_at(drive, series.time)
    chosen = known & span.holds(series.time)
    if not chosen.any():
        return dict.fromkeys(("rmse_w", "mae_w", "r2", "coverage_90"))
    truth, sigma = measured[chosen], series.sigma[chosen]
    error = series.power[chosen] - truth
    variance = float(np.var(truth))
    return {
        "rmse_w": float(np.sqrt(np.mean(error**2))),
        "mae_w": float(np.mean(np.abs(error))),
        "r2": 1.0 - float(np.mean(error**2)) / variance if variance > 0 else None,
        "coverage_90": float(np.mean(np.abs(error) <= GAUSSIAN_QUANTILE * sigma)),
    }


def energy_score(drive: Drive, span: Span) -> dict[str, float | None]:
    """Measured, predicted and RKNN energy over the same part of the drive, J."""
    inside = span.holds(drive.energy[:, 0])
    keys = ("measured_j", "predicted_j", "rknn_j", "error_percent", "rknn_error_percent")
    if inside.sum() < 2:
        return dict.fromkeys(keys)
    rows = drive.energy[inside]
    # Only where the battery was measured too, when it was: what is compared must be the same.
    heard = drive.measured[span.holds(drive.measured[:, 0]), 0]
    time = rows[:, 0]
    if len(heard) and heard[0] < time[-1] and heard[-1] > time[0]:
        time = np.clip(time, heard[0], heard[-1])
    ends = Span(time[0], time[-1])
    predicted, rknn = (np.diff(np.interp(ends, rows[:, 0], column))[0] for column in rows.T[1:])
    measured = _measured_energy(drive, ends)
    score: dict[str, float | None] = dict.fromkeys(keys)
    score.update(measured_j=measured, predicted_j=float(predicted), rknn_j=float(rknn))
    if measured:
        score["error_percent"] = 100.0 * (float(predicted) - measured) / abs(measured)
        score["rknn_error_percent"] = 100.0 * (float(rknn) - measured) / abs(measured)
    return score


def null_scores(drive: Drive, span: Span) -> dict[str, float | None]:
    """RMSE, W, of predictions that know nothing of cars.

    `last_value`: the battery reading before, one reading ahead. `interpolation`: between
    neighbours in time, under a random split of the readings, the split of the paper.
    """
    rows = drive.measured[span.holds(drive.measured[:, 0])]
    if len(rows) < 10:
        return {"last_value": None, "interpolation": None}
    held_out = np.random.default_rng(NULL_SEED).random(len(rows)) < NULL_HOLD_OUT
    held_out[[0, -1]] = False
    guess = np.interp(rows[held_out, 0], rows[~held_out, 0], rows[~held_out, 1])
    return {
        "last_value": float(np.sqrt(np.mean(np.diff(rows[:, 1]) ** 2))),
        "interpolation": float(np.sqrt(np.mean((guess - rows[held_out, 1]) ** 2))),
    }


def metrics(
    *,
    path: str,
    vehicle: str,
    mode: str,
    drive: Drive,
    status: EstimatorStatus,
    dropped: Mapping[str, int],
    warm_up: float,
    withheld_from: float | None,
    wall: float,
) -> dict[str, Any]:
    """All scores of one drive under the contract's keys; JSON holds it as it is."""
    found: dict[str, Any] = {
        "input": {
            "path": path,
            "duration_s": drive.duration,
            "samples": len(drive.smoothed.time),
            "dropped": dict(dropped),
        },
        "vehicle": vehicle,
        "mode": mode,
        **drive_scores(drive, warm_up, withheld_from),
    }
    found["parameters"] = _parameters(drive)
    found["updates"] = _updates(status)
    found["replay"] = {
        "wall_s": wall,
        "realtime_factor": drive.duration / wall if wall > 0 else None,
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }
    return found


def drive_scores(
    drive: Drive, warm_up: float, withheld_from: float | None = None
) -> dict[str, Any]:
    """Scores of power and energy; those of a withheld part apart from what came before it."""
    end = drive.duration if withheld_from is None else withheld_from
    found = _part(drive, Span(warm_up, end), Span(-1.0, end))
    if withheld_from is not None:
        rest = Span(withheld_from, drive.duration)
        found["withheld"] = {"from_s": withheld_from, **_part(drive, rest, rest)}
    return found


def _part(drive: Drive, power: Span, energy: Span) -> dict[str, Any]:
    lag = float(np.median(drive.smoothed.lag)) if len(drive.smoothed.lag) else None
    return {
        "power": {"lag_s": lag, **power_score(drive, drive.smoothed, power)},
        "power_now": power_score(drive, drive.newest, power),
        "energy": energy_score(drive, energy),
    }


def measured_at(drive: Drive, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Measured power at times, W, and where it is known; shape (n,) each."""
    rows = drive.measured
    if len(rows) < 2:
        return np.full(len(time), np.nan), np.zeros(len(time), dtype=bool)
    after = np.clip(np.searchsorted(rows[:, 0], time), 1, len(rows) - 1)
    inside = (time >= rows[0, 0]) & (time <= rows[-1, 0])
    near = rows[after, 0] - rows[after - 1, 0] <= MAX_MEASURED_STEP
    return np.interp(time, rows[:, 0], rows[:, 1]), inside & near


def _measured_energy(drive: Drive, span: Span) -> float | None:
    """Integral of measured power from begin to end of a span, J; None when not measured."""
    rows = drive.measured
    ends = np.array([span.begin, span.end])
    power, known = measured_at(drive, ends)
    if not known.all():
        return None
    inner = rows[(rows[:, 0] > span.begin) & (rows[:, 0] < span.end)]
    integral = EnergyIntegral(MAX_MEASURED_STEP)
    for time, watts in np.vstack(([ends[0], power[0]], inner, [ends[1], power[1]])):
        integral.push(round(time * NANOSECONDS) + 1, float(watts))
    return integral.energy


def _parameters(drive: Drive) -> dict[str, dict[str, Any]]:
    if drive.final is None:
        return {}
    return {
        name: {
            "value": p.value,
            "std": p.std,
            "prior_share": p.prior_share,
            "lower": p.lower,
            "upper": p.upper,
            "state": p.state.value,
        }
        for name, p in drive.final.parameters.items()
    }


def _updates(status: EstimatorStatus) -> dict[str, Any]:
    times = 1000.0 * np.array(status.durations)
    return {
        "count": status.updates,
        "accepted": status.accepted,
        "rejected": dict(status.rejected),
        "p50_ms": float(np.percentile(times, 50)) if len(times) else None,
        "p99_ms": float(np.percentile(times, 99)) if len(times) else None,
    }
