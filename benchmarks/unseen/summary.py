"""Sums of a method's scores on one car: the numbers that the table and the JSON hold."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np

from benchmarks.unseen.drives import LOG_PART
from benchmarks.unseen.protocols import CarRun, ScoredPart
from benchmarks.unseen.scores import AGES, MEANS, QUANTILE_90, PartScore

MOST_LEFT_OUT = 0.1  # share of the parts that a method may leave without a prediction
ONLINE_AGE = "0.1"


def summary(run: CarRun) -> dict[str, Any]:
    """The scores of one method on one car; null where there is none."""
    # Before the first drive nothing is known of the car, so it counts only where it is alone.
    carried = run.carried[1:] if len(run.carried) > 1 else run.carried
    return {
        "carried": _energies(carried),
        "carried_logs": _by_log(carried),
        "withheld": _energies(run.withheld),
        "dropout_600": _energies(run.long),
        "online": _online(run),
        "by_battery_age": _by_age(run),
        "drives": [_one(each) for each in run.carried],
        "cuts": [_one(each) for each in (*run.withheld, *run.long)],
        "combinations": {
            name: list(map(_number, each)) for name, each in run.combinations.items()
        },
    }


def _energies(parts: Sequence[ScoredPart]) -> dict[str, Any] | None:
    """Scores over parts; None when a method left out more than `MOST_LEFT_OUT` of them.

    Errors of energy are percent without their sign: of net energy by the measured net energy and
    by the measured gross energy of the part. `rmse_w` is the mean over the parts, `rmse_pooled_w`
    and those of means are over all samples.
    """
    known = [each.score for each in parts if each.score.gross > 0]
    scores = [score for score in known if score.valid]
    if not scores or len(scores) < (1 - MOST_LEFT_OUT) * len(known):
        return None
    by_net = np.array([100 * abs(one.error / one.net) if one.net else math.nan for one in scores])
    by_gross = np.array([100 * abs(one.error) / one.gross for one in scores])
    widths = [200 * QUANTILE_90 * one.sigma / one.gross for one in scores]
    bounded = [one for one in scores if math.isfinite(one.sigma)]
    inside = 100 * np.mean([one.inside_90 for one in bounded]) if bounded else math.nan
    return {
        "parts": len(scores),
        "left_out": len(known) - len(scores),
        "net_median_percent": _number(np.nanmedian(by_net)),
        "net_mean_percent": _number(np.nanmean(by_net)),
        "gross_median_percent": _number(np.median(by_gross)),
        "gross_mean_percent": _number(np.mean(by_gross)),
        "bias_percent": _number(100 * sum(o.error for o in scores) / sum(o.gross for o in scores)),
        "inside_90_percent": _number(inside),
        "width_90_percent": _number(np.median(widths)),
        "crps_percent": _mean([100 * one.crps / one.gross for one in bounded]),
        "log_score": _mean([one.log_score for one in bounded]),
        "rmse_w": _number(np.mean([one.rmse for one in scores])),
        "rmse_pooled_w": _pooled([one.squares for one in scores]),
        "means_w": {
            f"{length:g}": _pooled([one.means[length] for one in scores]) for length in MEANS
        },
    }


def _by_log(carried: Sequence[ScoredPart]) -> dict[str, float | None] | None:
    """Errors of the net energy of whole logs, percent, where a log holds several drives.

    Drives that run downhill have a net energy near zero, which no percentage is of use for.
    """
    logs: dict[str, list[PartScore]] = {}
    known = [each for each in carried if each.score.valid]
    for each in known:
        logs.setdefault(each.drive.split(LOG_PART)[0], []).append(each.score)
    if len(known) < (1 - MOST_LEFT_OUT) * len(carried) or len(logs) in (0, len(known)):
        return None
    errors = [
        100 * abs(sum(one.error for one in scores) / sum(one.net for one in scores))
        for scores in logs.values()
    ]
    return {
        "logs": len(logs),
        "net_median_percent": _number(np.median(errors)),
        "net_mean_percent": _number(np.mean(errors)),
    }


def _online(run: CarRun) -> dict[str, Any] | None:
    """Errors of power while the battery is measured; its energy is then no prediction."""
    found = _energies(run.online)
    return found and {name: found[name] for name in ("parts", "rmse_pooled_w", "means_w")}


def _by_age(run: CarRun) -> dict[str, dict[str, float | None] | None]:
    """RMSE, W, and error of the energy since the last battery sample, percent of gross."""
    found: dict[str, dict[str, float | None] | None] = {ONLINE_AGE: None}
    online = [each.score for each in run.online if each.score.valid]
    if online:
        absolute, gross = (sum(getattr(one, n) for one in online) for n in ("absolute", "gross"))
        found[ONLINE_AGE] = {
            "rmse_w": _pooled([one.squares for one in online]),
            "energy_percent": _number(100 * absolute / gross),
        }
    scores = [each.score for each in (*run.withheld, *run.long)]
    for age in AGES:
        found[f"{age:g}"] = _at_age(scores, age)
    return found


def _at_age(scores: Sequence[PartScore], age: float) -> dict[str, float | None] | None:
    ages = [score.ages[age] for score in scores if age in score.ages]
    gross = sum(one.gross for one in ages)
    if not gross:
        return None
    return {
        "rmse_w": _pooled([(one.squares, one.samples) for one in ages]),
        "energy_percent": _number(100 * sum(one.energy_error for one in ages) / gross),
    }


def _one(each: ScoredPart) -> dict[str, Any]:
    score = each.score
    return {
        "drive": each.drive,
        "from_s": round(each.span.begin, 3),
        "to_s": round(each.span.end, 3),
        "covered": _number(score.covered),
        "net_j": _number(score.net),
        "gross_j": _number(score.gross),
        "error_j": _number(score.error),
        "sigma_j": _number(score.sigma),
        "rmse_w": _number(score.rmse),
    }


def _pooled(sums: Sequence[tuple[float, int]]) -> float | None:
    squares, count = (sum(column) for column in zip(*sums, strict=True))
    return _number(math.sqrt(squares / count)) if count else None


def _mean(values: Sequence[float]) -> float | None:
    return _number(np.mean(values)) if values else None


def _number(value: float | np.floating[Any]) -> float | None:
    """A number that JSON can hold, to six digits."""
    return float(f"{float(value):.6g}") if math.isfinite(value) else None
