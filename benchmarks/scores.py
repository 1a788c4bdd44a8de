"""Scores of the methods on one log, and on all logs together.

Every number comes from `replay.scoring`; here they are put side by side and added up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
from typing import Any, TypeAlias

import numpy as np

from benchmarks.online import RANDOM_SPLIT, Run
from evpinn_ros.replays.history import Drive, PowerSeries
from evpinn_ros.replays.scoring import (
    Span,
    baseline_scores,
    common_stretches,
    drive_scores,
    running_total,
    scored,
    whole_stretches,
)

Score: TypeAlias = dict[str, Any]

MEANS = ("mae_w", "coverage_90")
WINDOW, WINDOW_STEP = 300.0, 10.0  # s, of the worst stretch of energy


def log_scores(run: Run, names: Iterable[str], warm_up: float) -> dict[str, Score]:
    """For each method of a log its scores after `warm_up` s; JSON holds them as they are.

    `samples` counts what was scored, null where nothing was; energy is that of the whole drive, as
    in `evpinn replay`. `now` is the prediction of the newest moment, without smoothing.
    """
    found = {}
    for name in names:
        if name == RANDOM_SPLIT:
            found[name] = _split_score(run, warm_up)
        elif name in run.predicted:
            found[name] = _score(run, name, warm_up)
    return found


def total_scores(logs: Sequence[Mapping[str, Score]]) -> dict[str, Score]:
    """Scores of each method over all logs that it has a score for, weighted by samples.

    The energy error is the sum of the errors of the logs, each without its sign, over the sum of
    their energies: a log too high and one too low do not cancel. The worst five minutes are those
    of all logs.
    """
    names = dict.fromkeys(name for log in logs for name in log)
    return {name: _total([log[name] for log in logs if name in log]) for name in names}


def _score(run: Run, name: str, warm_up: float) -> Score:
    drive = run.predicted[name]
    found = drive_scores(drive, warm_up)
    seconds = run.method_s.get(name)
    energy = found["energy"]
    return {
        **_part(drive, drive.smoothed, found["power"], warm_up),
        "energy_error_percent": energy["error_percent"],
        "worst_5min_percent": worst_window(drive),
        "measured_j": energy["measured_j"],
        "predicted_j": energy["predicted_j"],
        "now": _part(drive, drive.newest, found["power_now"], warm_up),
        "us_per_sample": 1e6 * seconds / run.moments if seconds and run.moments else None,
    }


def worst_window(drive: Drive) -> float | None:
    """Largest error of predicted energy over any `WINDOW`, percent of what went in and out.

    None for a drive without that long a stretch of both.
    """
    rows = drive.energy
    stretches = common_stretches(
        whole_stretches(rows[:, 0]), whole_stretches(drive.measured[:, 0])
    )
    time, power = drive.measured.T
    net, gross = running_total(time, power), running_total(time, np.abs(power))
    worst: float | None = None
    for begin, end in stretches:
        begins = np.arange(begin, end - WINDOW, WINDOW_STEP)
        measured, moved, predicted = (
            np.interp(begins + WINDOW, *series) - np.interp(begins, *series)
            for series in ((time, net), (time, gross), (rows[:, 0], rows[:, 1]))
        )
        errors = 100.0 * np.abs(predicted - measured)[moved > 0] / moved[moved > 0]
        worst = max([*errors.tolist(), *([] if worst is None else [worst])], default=None)
    return worst


def _part(
    drive: Drive, series: PowerSeries, power: Mapping[str, float | None], warm_up: float
) -> Score:
    samples = int(scored(drive, series, Span(warm_up, drive.duration)).sum())
    return {"samples": samples, **{key: power[key] for key in ("rmse_w", *MEANS)}}


def _split_score(run: Run, warm_up: float) -> Score:
    """Interpolation under a random split: RMSE alone, of battery readings held out."""
    span = Span(warm_up, run.drive.duration)
    readings = int(span.holds(run.drive.measured[:, 0]).sum())
    rmse = baseline_scores(run.drive, span)["interpolation"]
    unknown = dict.fromkeys(MEANS)
    return {
        **{"samples": readings, "rmse_w": rmse, **unknown},
        **dict.fromkeys(
            ("energy_error_percent", "worst_5min_percent", "measured_j", "predicted_j")
        ),
        "now": {"samples": 0, "rmse_w": None, **unknown},
        "us_per_sample": None,
    }


def _total(scores: Sequence[Score]) -> Score:
    energies = [
        (score["predicted_j"], score["measured_j"])
        for score in scores
        if score["measured_j"] is not None
    ]
    worst = [score["worst_5min_percent"] for score in scores]
    measured = sum(abs(joules) for _, joules in energies)
    errors = sum(abs(predicted - joules) for predicted, joules in energies)
    return {
        **_total_part(scores),
        "energy_error_percent": 100.0 * errors / measured if measured else None,
        "worst_5min_percent": max((one for one in worst if one is not None), default=None),
        "measured_j": measured if energies else None,
        "predicted_j": sum(predicted for predicted, _ in energies) if energies else None,
        "now": _total_part([score["now"] for score in scores]),
        "us_per_sample": _mean(scores, "us_per_sample"),
    }


def _total_part(scores: Sequence[Score]) -> Score:
    squares = [{**score, "rmse_w": score["rmse_w"] and score["rmse_w"] ** 2} for score in scores]
    mean_square = _mean(squares, "rmse_w")
    return {
        "samples": sum(score["samples"] for score in scores),
        "rmse_w": None if mean_square is None else math.sqrt(mean_square),
        **{key: _mean(scores, key) for key in MEANS},
    }


def _mean(scores: Sequence[Score], key: str) -> float | None:
    """Mean over the logs that have this score, weighted by samples; None without any."""
    known = [(score["samples"], score[key]) for score in scores if score[key] is not None]
    samples = sum(weight for weight, _ in known)
    return sum(weight * value for weight, value in known) / samples if samples else None
