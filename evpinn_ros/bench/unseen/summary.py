"""Sums of a method's scores on one car: the numbers that the table and the JSON hold."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np

from evpinn_ros.bench.unseen.protocols import CarRun, Scored
from evpinn_ros.bench.unseen.scores import AGES, MEANS, QUANTILE_90, PartScore

ONLINE_AGE = "0.1"


def summary(run: CarRun) -> dict[str, Any]:
    """The scores of one method on one car; null where there is none."""
    # Before the first drive nothing is known of the car, so it counts only where it is alone.
    carried = run.carried[1:] if len(run.carried) > 1 else run.carried
    return {
        "carried": _energies(carried),
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


def _energies(parts: Sequence[Scored]) -> dict[str, Any] | None:
    """Scores over parts; None when a method left one of them out or there is none.

    Errors of energy are percent without their sign: of net energy by the measured net energy and
    by the measured gross energy of the part. `rmse_w` is the mean over the parts, `rmse_pooled_w`
    and those of means are over all samples.
    """
    scores = [each.score for each in parts if each.score.gross > 0]
    if not scores or not all(score.valid for score in scores):
        return None
    by_net = np.array([100 * abs(one.error / one.net) if one.net else math.nan for one in scores])
    by_gross = np.array([100 * abs(one.error) / one.gross for one in scores])
    widths = [200 * QUANTILE_90 * one.sigma / one.gross for one in scores]
    known = [one for one in scores if math.isfinite(one.sigma)]
    inside = 100 * np.mean([one.inside_90 for one in known]) if known else math.nan
    return {
        "parts": len(scores),
        "net_median_percent": _number(np.nanmedian(by_net)),
        "net_mean_percent": _number(np.nanmean(by_net)),
        "gross_median_percent": _number(np.median(by_gross)),
        "gross_mean_percent": _number(np.mean(by_gross)),
        "bias_percent": _number(100 * sum(o.error for o in scores) / sum(o.gross for o in scores)),
        "inside_90_percent": _number(inside),
        "width_90_percent": _number(np.median(widths)),
        "rmse_w": _number(np.mean([one.rmse for one in scores])),
        "rmse_pooled_w": _pooled([one.squares for one in scores]),
        "means_w": {
            f"{length:g}": _pooled([one.means[length] for one in scores]) for length in MEANS
        },
    }


def _online(run: CarRun) -> dict[str, Any] | None:
    """Errors of power while the battery is measured; its energy is then no prediction."""
    found = _energies(run.online)
    return found and {name: found[name] for name in ("parts", "rmse_pooled_w", "means_w")}


def _by_age(run: CarRun) -> dict[str, dict[str, float | None] | None]:
    """RMSE, W, and error of the energy since the last battery sample, percent of gross."""
    found: dict[str, dict[str, float | None] | None] = {ONLINE_AGE: None}
    online = [each.score for each in run.online if each.score.gross > 0]
    if online and all(score.valid for score in online):
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


def _one(each: Scored) -> dict[str, Any]:
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


def _number(value: float | np.floating[Any]) -> float | None:
    """A number that JSON can hold, to six digits."""
    return float(f"{float(value):.6g}") if math.isfinite(value) else None
