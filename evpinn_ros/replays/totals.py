"""Totals of replayed drives for all texts and pages, and the battery's state of health."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
import csv
from datetime import datetime, timezone
from io import StringIO
from itertools import chain
import math
from typing import Any

from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.core.energy.charge import ChargeGauge
from evpinn_ros.core.estimation.breakdown import CONSUMPTION_METRES
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.replays.driven import counted
from evpinn_ros.replays.energy_metrics import KWH_PER_100KM
from evpinn_ros.replays.history import Drive


def totals(drives: Sequence[Drive]) -> dict[str, Any]:
    """Values of `--metrics` under `totals`, of one or several drives in order."""
    sums = [counted(drive) for drive in drives]
    energies = [total.energy for total in sums if not math.isnan(total.energy)]
    measured_m = math.fsum(total.known for total in sums)
    energy = math.fsum(energies) if energies else None
    charges = [drive.charge[:, 1] for drive in drives if len(drive.charge)]
    per_metre = (
        energy / measured_m if energy is not None and measured_m >= CONSUMPTION_METRES else None
    )
    return {
        "start": _start(drives[0]),
        "distance_m": math.fsum(total.distance for total in sums),
        "duration_s": math.fsum(drive.driven_s for drive in drives),
        "energy_kwh": _kwh(energy),
        "measured_m": measured_m,
        "kwh_per_100km": None if per_metre is None else per_metre / KWH_PER_100KM,
        "charged_kwh": _kwh(math.fsum(total.charged for total in sums)),
        "charge_first_percent": 100.0 * float(charges[0][0]) if charges else None,
        "charge_last_percent": 100.0 * float(charges[-1][-1]) if charges else None,
    }


def _start(drive: Drive) -> str | None:
    """Start of a drive by ISO 8601, without a zone if the clock is local; None if undated."""
    if not drive.dated:
        return None
    moment = datetime.fromtimestamp(drive.start_ns // NANOSECONDS, tz=timezone.utc)
    return (moment if drive.zoned else moment.replace(tzinfo=None)).isoformat()


def health(gauge: ChargeGauge) -> dict[str, float | None]:
    """Values of `--metrics` under `health`: None until the charge has changed enough.

    The percentage is also None where the vehicle file contradicts it, as in the texts.
    """
    if not gauge.learned:
        return dict.fromkeys(("percent", "sigma_percent", "capacity_kwh", "capacity_sigma_kwh"))
    told = gauge.health.known and not gauge.contradicted
    percent, spread = (100.0 * share if told else None for share in gauge.health)
    capacity, sigma = map(_kwh, gauge.capacity)
    return {
        "percent": percent,
        "sigma_percent": spread,
        "capacity_kwh": capacity,
        "capacity_sigma_kwh": sigma,
    }


def with_left_out(breakdown: Mapping[str, Any], total: Mapping[str, Any]) -> dict[str, Any]:
    """A breakdown with `left_out_kwh`: energy of the totals outside it; None if unknown."""
    energy, measured = total["energy_kwh"], breakdown["measured"]["kwh"]
    left = None if energy is None or measured is None else energy - measured
    return {**breakdown, "left_out_kwh": left}


FIRST = ("input.path", "totals", "health")  # columns of the table that an owner looks for


def metrics_csv(drives: Sequence[Mapping[str, Any]]) -> str:
    """The metrics as CSV: a row for each drive and one for all; columns have dotted keys."""
    alone = ({key: value for key, value in d.items() if key != "together"} for d in drives)
    rows = [dict(_leaves(drive)) for drive in alone]
    if (together := drives[-1].get("together")) is not None:
        of_all = {"input": {"path": f"all {len(drives)}"}, **together}
        rows.append(dict(_leaves({**of_all, "health": drives[-1]["health"]})))
    keys = dict.fromkeys(chain.from_iterable(rows))
    columns = [key for first in FIRST for key in keys if f"{key}.".startswith(f"{first}.")]
    return _csv(rows, [*dict.fromkeys((*columns, *keys))])


def trends_csv(drives: Sequence[Mapping[str, Any]]) -> str | None:
    """The trends of all drives as CSV, a row for each group; None if there are none."""
    trends = (drives[-1].get("together") or {}).get("trends")
    return _csv(trends, list(trends[0])) if trends else None


def _csv(rows: Iterable[Mapping[str, Any]], columns: Sequence[str]) -> str:
    table = csv.DictWriter(text := StringIO(), columns)
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def _leaves(metrics: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Yields values with their dotted keys; lists are left out."""
    for key, value in metrics.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{path}{key}.")
        elif not isinstance(value, list | tuple):
            finite = not isinstance(value, float) or math.isfinite(value)
            yield f"{path}{key}", value if finite else None


def _kwh(joules: float | None) -> float | None:
    return None if joules is None else joules / JOULES_PER_KWH
