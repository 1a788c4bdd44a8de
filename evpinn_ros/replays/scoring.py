"""Scores of a replayed drive for `--metrics`; each prediction was made before its sample."""

from __future__ import annotations

from collections.abc import Mapping
import resource
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.core.energy.quadrature import trapezoid
from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.core.estimation.estimate import ParameterSet, Trust
from evpinn_ros.core.estimation.estimator import EstimatorStatus, Mode
from evpinn_ros.core.estimation.learner import CHARGING_POWER
from evpinn_ros.core.vehicle.physics import STANDSTILL_SPEED
from evpinn_ros.replays.energy_metrics import breakdown_metrics
from evpinn_ros.replays.history import Drive, PowerSeries

MAX_MEASURED_STEP = 2.5  # s; power is unknown between readings further apart
GAP_STEPS = 6.0  # for slow readings: that limit in their usual steps
# s since the last battery reading, the keys of `by_battery_age`: each extends half way (in
# logarithms) to its neighbours.
BATTERY_AGES = (0.1, 1.0, 10.0, 60.0, 600.0)
BASELINE_HOLD_OUT = 0.2  # share of validation data in the random split
BASELINE_SEED = 0
FLOOR_BINS = 50  # of speed, each with at least ten predictions


class Span(NamedTuple):
    """Scored part of a drive, s since its start: after `begin`, up to `end`."""

    begin: float
    end: float

    def holds(self, time: np.ndarray) -> np.ndarray:
        """Mask of the times within the span; shape as `time`."""
        return (time > self.begin) & (time <= self.end)


def power_score(drive: Drive, series: PowerSeries, span: Span) -> dict[str, float | None]:
    """RMSE, MAE, R2 and coverage of the 90 % bands against measured power, None if unknown."""
    chosen = scored(drive, series, span)
    if not chosen.any():
        return dict.fromkeys(("rmse_w", "mae_w", "r2", "coverage_90"))
    truth, sigma = known_at(drive.measured, series.time)[0][chosen], series.sigma[chosen]
    error = series.power[chosen] - truth
    variance = float(np.var(truth))
    return {
        "rmse_w": float(np.sqrt(np.mean(error**2))),
        "mae_w": float(np.mean(np.abs(error))),
        "r2": 1.0 - float(np.mean(error**2)) / variance if variance > 0 else None,
        "coverage_90": (
            float(np.mean(np.abs(error) <= GAUSSIAN_QUANTILE * sigma))
            if np.isfinite(sigma).any()
            else None
        ),
    }


def scored(drive: Drive, series: PowerSeries, span: Span) -> np.ndarray:
    """Mask of scored predictions: in the span, with power measured then; shape (n,)."""
    _, is_measured = known_at(drive.measured, series.time)
    chosen: np.ndarray = is_measured & span.holds(series.time)
    return chosen


def energy_score(drive: Drive, span: Span) -> dict[str, float | None]:
    """Measured, predicted and RKNN energy over the same part of the drive, J.

    Charging is excluded, because no speed predicts its energy.
    """
    inside = span.holds(drive.energy[:, 0])
    keys = ("measured_j", "predicted_j", "rknn_j", "error_percent", "rknn_error_percent")
    if inside.sum() < 2:
        return dict.fromkeys(keys)
    rows = drive.energy[inside]
    stretches = whole_stretches(rows[:, 0])
    time, power = drive.measured.T
    in_order = np.argsort(drive.speed[:, 0], kind="stable")
    speed, is_known = known_at(drive.speed[in_order], time)
    charges = is_known & (np.abs(speed) < STANDSTILL_SPEED) & (power < CHARGING_POWER)
    measured_spans = whole_stretches(time[span.holds(time) & ~charges])
    common = common_stretches(stretches, measured_spans) or stretches
    predicted, rknn = (_increase(rows[:, 0], column, common) for column in rows.T[1:3])
    measured = (
        measured_energy(drive, common) if common_stretches(stretches, measured_spans) else None
    )
    score: dict[str, float | None] = dict.fromkeys(keys)
    score.update(measured_j=measured, predicted_j=predicted, rknn_j=rknn)
    if measured:
        score["error_percent"] = 100.0 * (predicted - measured) / abs(measured)
        score["rknn_error_percent"] = 100.0 * (rknn - measured) / abs(measured)
    return score


def baseline_scores(drive: Drive, span: Span) -> dict[str, float | None]:
    """RMSE, W, of `last_value`, and of `interpolation` under the paper's random split."""
    rows = drive.measured[span.holds(drive.measured[:, 0])]
    if len(rows) < 10:
        return {"last_value": None, "interpolation": None}
    held_out = np.random.default_rng(BASELINE_SEED).random(len(rows)) < BASELINE_HOLD_OUT
    held_out[[0, -1]] = False
    guess = np.interp(rows[held_out, 0], rows[~held_out, 0], rows[~held_out, 1])
    return {
        "last_value": float(np.sqrt(np.mean(np.diff(rows[:, 1]) ** 2))),
        "interpolation": float(np.sqrt(np.mean((guess - rows[held_out, 1]) ** 2))),
    }


def held_scores(drive: Drive, span: Span) -> dict[float, float]:
    """RMSE, W, of measured power held for each of `BATTERY_AGES`, s."""
    rows = drive.measured[span.holds(drive.measured[:, 0])]
    if len(rows) < 10:
        return {}
    step = float(np.median(np.diff(rows[:, 0])))
    scores = {}
    for age in (step, *(age for age in BATTERY_AGES if 2.0 * step < age <= 10.0)):
        held, joined = known_at(drive.measured, rows[:, 0] - age)
        if joined.any():
            scores[age] = float(np.sqrt(np.mean((held - rows[:, 1])[joined] ** 2)))
    return scores


def speed_floor(drive: Drive, span: Span) -> float | None:
    """Lowest RMSE, W, that a function of speed alone can have on this drive; None if unknown.

    It uses means in `FLOOR_BINS` bins. Between updates, the network of `mode: paper` is such a
    function.
    """
    chosen = scored(drive, drive.smoothed, span)
    if chosen.sum() < 10 * FLOOR_BINS:
        return None
    time = drive.smoothed.time[chosen]
    power = known_at(drive.measured, time)[0]
    speed = drive.speed[np.argsort(drive.speed[:, 0], kind="stable")]
    order = np.argsort(np.interp(time, *speed.T), kind="stable")
    rest = [powers - powers.mean() for powers in np.array_split(power[order], FLOOR_BINS)]
    return float(np.sqrt(np.mean(np.concatenate(rest) ** 2)))


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
    breakdown: Breakdown | None = None,
) -> dict[str, Any]:
    """All scores of a drive under the keys of `--metrics`, as JSON values."""
    document: dict[str, Any] = {
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
    end = drive.duration if withheld_from is None else withheld_from
    floor = speed_floor(drive, Span(warm_up, end)) if mode == Mode.PAPER.value else None
    document["power"]["floor_w"] = floor
    document["by_battery_age"] = battery_age_scores(drive, warm_up, withheld_from)
    document["parameters"] = parameter_metrics(drive.final)
    mass = status.trust.get("mass", Trust.VALID).value
    document["breakdown"] = breakdown_metrics(breakdown, mode, mass)
    document["updates"] = _updates(status)
    document["replay"] = {
        "wall_s": wall,
        "realtime_factor": drive.duration / wall if wall > 0 else None,
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }
    return document


def drive_scores(
    drive: Drive, warm_up: float, withheld_from: float | None = None
) -> dict[str, Any]:
    """Scores of power and energy, separately before and while the battery is withheld."""
    end = drive.duration if withheld_from is None else withheld_from
    scores = _part(drive, Span(warm_up, end), Span(-1.0, end))
    if withheld_from is not None:
        rest = Span(withheld_from, drive.duration)
        scores["withheld"] = {"from_s": withheld_from, **_part(drive, rest, rest)}
    return scores


def _part(drive: Drive, power: Span, energy: Span) -> dict[str, Any]:
    lag = float(np.median(drive.smoothed.lag)) if len(drive.smoothed.lag) else None
    return {
        "power": {"lag_s": lag, **power_score(drive, drive.smoothed, power)},
        "power_now": power_score(drive, drive.newest, power),
        "energy": energy_score(drive, energy),
    }


def known_at(rows: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values of a series (rising time, value) at times, and mask of those outside gaps; (n,)."""
    if len(rows) < 2:
        return np.full(len(time), np.nan), np.zeros(len(time), dtype=bool)
    after = np.clip(np.searchsorted(rows[:, 0], time), 1, len(rows) - 1)
    inside = (time >= rows[0, 0]) & (time <= rows[-1, 0])
    near = rows[after, 0] - rows[after - 1, 0] <= longest_step(rows[:, 0])
    return np.interp(time, rows[:, 0], rows[:, 1]), inside & near


def longest_step(time: np.ndarray) -> float:
    """Longest step, s, between readings that is no gap, from their median step."""
    usual = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    return max(MAX_MEASURED_STEP, GAP_STEPS * usual)


def running_total(time: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Integral of a series since its start, by trapezoids, shape (n,); gaps add nothing."""
    steps = np.diff(time)
    used = steps * (rates[1:] + rates[:-1]) / 2 * (steps <= longest_step(time))
    return np.concatenate((np.zeros(min(len(time), 1)), np.cumsum(used)))


def battery_age_scores(
    drive: Drive, warm_up: float, withheld_from: float | None
) -> dict[str, dict[str, float | None]]:
    """RMSE and bias, W, by age of the last battery reading, and RMSE of its power held."""
    series, rows = drive.smoothed, drive.measured
    given = rows if withheld_from is None else rows[rows[:, 0] <= withheld_from]
    empty: dict[str, float | None] = dict.fromkeys(("rmse_w", "bias_w", "last_value_rmse_w"))
    scores_by_age = {f"{age:g}": dict(empty) for age in BATTERY_AGES}
    if len(given) < 2 or not len(series.time):
        return scores_by_age
    truth, is_measured = known_at(drive.measured, series.time)
    last = np.searchsorted(given[:, 0], series.time, side="right") - 1
    chosen = is_measured & (series.time > warm_up) & (last >= 0)
    age = series.time[chosen] - given[last[chosen], 0]
    edges = np.sqrt(np.array(BATTERY_AGES[1:]) * np.array(BATTERY_AGES[:-1]))
    group = np.searchsorted(edges, age)
    error = series.power[chosen] - truth[chosen]
    held = given[last[chosen], 1] - truth[chosen]
    for index, name in enumerate(scores_by_age):
        inside = group == index
        if inside.any():
            scores_by_age[name] = {
                "rmse_w": float(np.sqrt(np.mean(error[inside] ** 2))),
                "bias_w": float(np.mean(error[inside])),
                "last_value_rmse_w": float(np.sqrt(np.mean(held[inside] ** 2))),
            }
    return scores_by_age


def measured_energy(drive: Drive, stretches: list[Span]) -> float:
    """Integral of measured power over stretches without gaps, J."""
    time, power = drive.measured.T
    total = 0.0
    for begin, end in stretches:
        inner = time[(time > begin) & (time < end)]
        nodes = np.concatenate(([begin], inner, [end]))
        total += trapezoid(np.interp(nodes, time, power), nodes)
    return total


def whole_stretches(time: np.ndarray) -> list[Span]:
    """Parts without gaps of a series of times, s, shape (n,)."""
    if len(time) < 2:
        return []
    breaks = np.flatnonzero(np.diff(time) > longest_step(time))
    begins = np.concatenate(([0], breaks + 1))
    ends = np.concatenate((breaks, [len(time) - 1]))
    return [Span(float(time[i]), float(time[j])) for i, j in zip(begins, ends, strict=True)]


def common_stretches(some: list[Span], others: list[Span]) -> list[Span]:
    """Parts in which both series are known."""
    both = [Span(max(a.begin, b.begin), min(a.end, b.end)) for a in some for b in others]
    return [span for span in both if span.end > span.begin]


def _increase(time: np.ndarray, total: np.ndarray, stretches: list[Span]) -> float:
    return float(sum(np.diff(np.interp(span, time, total))[0] for span in stretches))


def parameter_metrics(final: ParameterSet | None) -> dict[str, dict[str, Any]]:
    """The values of `--metrics` under `parameters`."""
    if final is None:
        return {}
    return {name: estimate.figures() for name, estimate in final.parameters.items()}


def combination_metrics(parameter_set: ParameterSet) -> dict[str, dict[str, float]]:
    """Identifiable combinations of parameters: value and 1-sigma."""
    sums, stds = parameter_set.identifiable, parameter_set.identifiable_std
    return {
        name: {"value": float(value), "std": float(std)}
        for name, value, std in zip(sums._fields, sums, stds, strict=True)
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
