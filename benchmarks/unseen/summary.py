"""Sums up a method's scores on one car, for table and JSON."""

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
    # Nothing is known of the car before its first drive, which counts only if there is no other.
    carried = run.carried[1:] if len(run.carried) > 1 else run.carried
    return {
        "carried": _energies(carried),
        "carried_logs": _by_log(carried),
        "withheld": _energies(run.withheld),
        "dropout_600": _energies(run.long),
        "online": _online(run),
        "by_battery_age": _by_age(run),
        "drives": [_one(part) for part in run.carried],
        "cuts": [_one(part) for part in (*run.withheld, *run.long)],
        "combinations": {
            name: list(map(_number, pair)) for name, pair in run.combinations.items()
        },
    }


def _energies(parts: Sequence[ScoredPart]) -> dict[str, Any] | None:
    """Scores over parts; None when a method left out more than `MOST_LEFT_OUT` of them.

    Errors of energy are percent without their sign: of net energy by the measured net energy and
    by the measured gross energy of the part. `rmse_w` is the mean over the parts, `rmse_pooled_w`
    and those of means are over all samples.
    """
    known = [part.score for part in parts if part.score.gross > 0]
    scores = [score for score in known if score.valid]
    if not scores or len(scores) < (1 - MOST_LEFT_OUT) * len(known):
        return None
    by_net = np.array(
        [100 * abs(score.error / score.net) if score.net else math.nan for score in scores]
    )
    by_gross = np.array([100 * abs(score.error) / score.gross for score in scores])
    widths = [200 * QUANTILE_90 * score.sigma / score.gross for score in scores]
    bounded = [score for score in scores if math.isfinite(score.sigma)]
    inside = 100 * np.mean([score.inside_90 for score in bounded]) if bounded else math.nan
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
        "crps_percent": _mean([100 * score.crps / score.gross for score in bounded]),
        "log_score": _mean([score.log_score for score in bounded]),
        "rmse_w": _number(np.mean([score.rmse for score in scores])),
        "rmse_pooled_w": _pooled([score.squares for score in scores]),
        "means_w": {
            f"{length:g}": _pooled([score.means[length] for score in scores]) for length in MEANS
        },
    }


def _by_log(carried: Sequence[ScoredPart]) -> dict[str, float | None] | None:
    """Errors of the net energy of whole logs, percent; None unless logs have several drives.

    A drive downhill has a net energy near zero, of which a percentage means nothing.
    """
    logs: dict[str, list[PartScore]] = {}
    known = [part for part in carried if part.score.valid]
    for part in known:
        logs.setdefault(part.drive.split(LOG_PART)[0], []).append(part.score)
    if len(known) < (1 - MOST_LEFT_OUT) * len(carried) or len(logs) in (0, len(known)):
        return None
    errors = [
        100 * abs(sum(score.error for score in scores) / sum(score.net for score in scores))
        for scores in logs.values()
    ]
    return {
        "logs": len(logs),
        "net_median_percent": _number(np.median(errors)),
        "net_mean_percent": _number(np.mean(errors)),
    }


def _online(run: CarRun) -> dict[str, Any] | None:
    """Errors of power while the battery is measured; the energy is not predicted then."""
    energies = _energies(run.online)
    return energies and {name: energies[name] for name in ("parts", "rmse_pooled_w", "means_w")}


def _by_age(run: CarRun) -> dict[str, dict[str, float | None] | None]:
    """RMSE, W, and error of the energy since the last battery sample, percent of gross."""
    by_age: dict[str, dict[str, float | None] | None] = {ONLINE_AGE: None}
    online = [part.score for part in run.online if part.score.valid]
    if online:
        absolute, gross = (
            sum(getattr(score, n) for score in online) for n in ("absolute", "gross")
        )
        by_age[ONLINE_AGE] = {
            "rmse_w": _pooled([score.squares for score in online]),
            "energy_percent": _number(100 * absolute / gross),
        }
    scores = [part.score for part in (*run.withheld, *run.long)]
    for age in AGES:
        by_age[f"{age:g}"] = _at_age(scores, age)
    return by_age


def _at_age(scores: Sequence[PartScore], age: float) -> dict[str, float | None] | None:
    ages = [score.ages[age] for score in scores if age in score.ages]
    gross = sum(at_age.gross for at_age in ages)
    if not gross:
        return None
    return {
        "rmse_w": _pooled([(at_age.squares, at_age.samples) for at_age in ages]),
        "energy_percent": _number(100 * sum(at_age.energy_error for at_age in ages) / gross),
    }


def _one(part: ScoredPart) -> dict[str, Any]:
    score = part.score
    return {
        "drive": part.drive,
        "from_s": round(part.span.begin, 3),
        "to_s": round(part.span.end, 3),
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
