"""Sentences and rows on a replayed drive for the car's owner: distance, energy, largest part."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, Units, fixed, kwh_digits
from evpinn_ros.common.units import counted as counted_text
from evpinn_ros.core.energy.charge import ChargeGauge
from evpinn_ros.core.estimation.breakdown import CONSUMPTION_METRES
from evpinn_ros.core.estimation.posterior import SPARSE
from evpinn_ros.core.signals.road import HEATED_BELOW
from evpinn_ros.core.vehicle.files import Vehicle
from evpinn_ros.replays.driven import Counted, counted, without_lone
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.vehicle_fit import size_note, vehicle_doubt
from evpinn_ros.report.breakdown_text import (
    CONTRADICTED,
    SHORT,
    SHORTEST_MINUTES,
    TOGETHER,
    duration_text,
    largest_part,
)
from evpinn_ros.report.tables import signed_percent, watts

NEARLY_WHOLE = 0.99  # share of distance or time from which on nothing is reported as missing
SPARSE_BATTERY = 10.0  # s between currents from which on the energy errs by some percent
LEAST_HEATING = 300.0  # W; less reported heating is not mentioned
LARGEST_PERCENT = 100.0  # error of energy; larger ones are shown in kWh
SCORES = (
    "RMSE (of power) and error of energy say how well each drive was predicted, moment by moment, "
    "before it was learned from."
)
IN_KWH = " kWh"  # ends an error of energy that is not in percent
LEAST_CHARGED = 0.05 * JOULES_PER_KWH  # J; less charged energy is not mentioned


def drives_columns(units: Units = METRIC) -> tuple[str, ...]:
    """Titles of `drives_rows`."""
    trip = ("drive", "kWh", units.economy, units.distance, "min")
    return (*trip, "took most", "RMSE", "error of energy")


def owner_line(drive: Drive, metrics: Mapping[str, Any], units: Units = METRIC) -> str:
    """Sentences on a drive's distance, time and energy, which is predicted if not measured."""
    total = counted(drive)
    kwh, consumption, far, _ = _texts(_figures(drive, total, metrics), units)
    how = "predicted" if metrics["energy"]["measured_j"] is None else "from the battery"
    if kwh.startswith("-") and how != "predicted":  # more came back downhill than was drawn
        kwh, how = kwh[1:], "back into the battery"
    read = total.seconds if how == "predicted" else total.measured
    if read < NEARLY_WHOLE * drive.driven_s:
        how += f" in the {part_text(read, drive.driven_s)} that could be read"
    per_distance = f", {consumption} {units.economy}" if consumption != "-" else ""
    if per_distance and 0.0 < total.known < NEARLY_WHOLE * total.distance:
        per_distance += f" over the {total.known / units.metres:.1f} {units.distance} measured"
    time, charged = duration_text(drive.driven_s), total.charged / JOULES_PER_KWH
    line = f"{far} {units.distance} in {time}: {kwh} kWh {how}{per_distance}."
    line += f" {lone}" if (lone := lone_note(drive, units)) else ""
    line += f" Doubtful: {drive.doubts[0]}." if drive.doubts else ""
    plugged = f" Charged while it stood: {charged:.2f} kWh, not included above."
    return line + (plugged if total.charged >= LEAST_CHARGED else "")


def lone_note(drive: Drive, units: Units = METRIC) -> str | None:
    """Sentence on lone outliers among the readings, if they change the totals; else None."""
    without = without_lone(drive)
    if without is None:
        return None
    kept, number = without
    kwh = "" if math.isnan(kept.energy) else f" and {kept.energy / JOULES_PER_KWH:.2f} kWh"
    readings = counted_text(number, "reading")
    return (
        f"Doubtful: without {readings} that leapt away and back, the totals are "
        f"{kept.distance / units.metres:.1f} {units.distance}{kwh}."
    )


def part_text(seconds: float, whole: float) -> str:
    """A part of a duration, s, such as "11 of 15 min", with a digit more if both round alike."""
    unit, name = (60.0, "min") if whole >= SHORTEST_MINUTES else (1.0, "s")
    digits = 0 if round(seconds / unit) != round(whole / unit) else 1
    return f"{seconds / unit:.{digits}f} of {whole / unit:.{digits}f} {name}"


def owner_notes(vehicle: Vehicle, drive: Drive, metrics: Mapping[str, Any]) -> list[str]:
    """Sentences on what to doubt in a drive and its metrics."""
    notes = (
        size_note(vehicle, drive),
        vehicle_doubt(vehicle, drive),
        sparse_note(drive),
        heating_note(drive, metrics["breakdown"]),
    )
    return [note for note in notes if note]


def scores_note(rows: Sequence[Sequence[str]]) -> str:
    """Sentences on the scores in `drives_rows`."""
    above = any(row[-1].endswith(IN_KWH) for row in rows)
    return f"{SCORES} Errors above 100 % are in kWh." if above else SCORES


def health_line(gauge: ChargeGauge, drives: Iterable[Drive]) -> str:
    """Sentence on the state of health of the battery, or on why the drives do not show it."""
    unknown = "State of health of the battery: not known yet"
    if not gauge.learned:
        if not any(len(drive.charge) for drive in drives):
            return f"{unknown}: the log has no state of charge."
        least = f"{100 * gauge.least_change:.0f} %"
        return f"{unknown}: no drive or charge of {least} was measured without a gap."
    kwh, sigma = (joules / JOULES_PER_KWH for joules in gauge.capacity)
    holds = f"a full battery gives {kwh:.1f} +- {sigma:.1f} kWh by energy and state of charge"
    health = gauge.health
    if not health.known:
        return f"{unknown}: {holds}, and its vehicle file has no battery_capacity to compare."
    rated = f"{kwh / health.value:.1f} kWh of its vehicle file"
    if gauge.contradicted:
        return f"{unknown}: {holds}, more than the {rated}, so one of the two is wrong."
    percent, spread = (100 * share for share in health)
    health_text = f"State of health of the battery: {percent:.0f} +- {spread:.0f} % of the {rated}"
    return f"{health_text}: {holds}."


def heating_note(drive: Drive, breakdown: Mapping[str, Any]) -> str | None:
    """Sentence on heating reported on a warm day that the battery does not show; else None."""
    if breakdown["unknown"] is not None or not (len(drive.heating) and len(drive.temperature)):
        return None
    power, celsius = (
        float(np.mean(series[:, 1])) for series in (drive.heating, drive.temperature)
    )
    reported = power * breakdown["duration_s"] / JOULES_PER_KWH
    climate = breakdown["climate"]
    if celsius < HEATED_BELOW or power < LEAST_HEATING:
        return None
    if climate["kwh"] + CONTRADICTED * climate["sigma_kwh"] > reported:
        return None
    return (
        f"The car reports {power / 1e3:.1f} kW of heating at {celsius:.0f} °C outside, which the "
        "battery does not show. It is not counted as heating."
    )


def sparse_note(drive: Drive) -> str | None:
    """Sentence on readings too far apart to show the driving between them; else None."""
    step, of_battery = (
        float(np.median(np.diff(rows[:, 0]))) if len(rows) > 1 else 0.0
        for rows in (drive.speed, drive.measured)
    )
    if step > SPARSE:
        return (
            f"The log has a speed every {step:.1f} s. Speeding up and braking in between are not "
            "seen, so parameters are rough, and predicted energy tends to be too low."
        )
    if of_battery > SPARSE_BATTERY:
        return (
            f"The log has voltage and current every {of_battery:.0f} s. What flows in between is "
            "not seen, so the energy is rough."
        )
    return None


def drives_rows(
    drives: Sequence[tuple[str, Drive, Mapping[str, Any]]],
    breakdown: Mapping[str, Any] | None,
    units: Units = METRIC,
) -> list[tuple[str, ...]]:
    """A row under `drives_columns` for each (name, drive, metrics); if several, then their sum.

    `breakdown` is of all drives together.
    """
    figures = [_figures(drive, counted(drive), metrics) for _, drive, metrics in drives]
    rows: list[tuple[str, ...]] = [
        (
            name,
            *_texts(of_drive, units),
            _most(metrics["breakdown"]),
            watts(metrics["power"]["rmse_w"]),
            _error(metrics["energy"]),
        )
        for (name, _, metrics), of_drive in zip(drives, figures, strict=True)
    ]
    if len(rows) > 1:
        total = Figures(*np.nansum(figures, axis=0).tolist())
        rows.append((f"all {len(rows)}", *_texts(total, units), _most(breakdown), "-",
                     signed_percent(_predicted(metrics for *_, metrics in drives))))  # fmt: skip
    return rows


def _error(energy: Mapping[str, Any]) -> str:
    """Error in percent, or in kWh above `LARGEST_PERCENT`: a drive may take nearly no energy."""
    percent = energy["error_percent"]
    if percent is None or abs(percent) <= LARGEST_PERCENT:
        return signed_percent(percent)
    kwh = (energy["predicted_j"] - energy["measured_j"]) / JOULES_PER_KWH
    return f"{fixed(kwh, kwh_digits(kwh, 2), '+')}{IN_KWH}"


def _predicted(metrics: Iterable[Mapping[str, Any]]) -> float | None:
    energies = [drive["energy"] for drive in metrics if drive["energy"]["measured_j"] is not None]
    measured = sum(energy["measured_j"] for energy in energies)
    predicted = sum(energy["predicted_j"] for energy in energies)
    return 100.0 * (predicted - measured) / abs(measured) if measured else None


class Figures(NamedTuple):
    """Figures of a drive, or sums of them."""

    distance: float  # m
    duration: float  # s
    joules: float  # measured, else predicted; NaN if neither is known
    metres: float  # m over which `joules` were drawn


def _figures(drive: Drive, total: Counted, metrics: Mapping[str, Any]) -> Figures:
    metres, joules = total.known, total.energy
    if metrics["energy"]["measured_j"] is None:
        metres, joules = total.distance, metrics["energy"]["predicted_j"]
    if joules is None:
        metres, joules = 0.0, math.nan
    return Figures(total.distance, drive.driven_s, joules, metres)


def _texts(figures: Figures, units: Units) -> tuple[str, str, str, str]:
    distance, duration, joules, metres = figures
    kwh = joules / JOULES_PER_KWH
    return (
        "-" if math.isnan(joules) else fixed(kwh, kwh_digits(kwh, 2)),
        "-" if metres < CONSUMPTION_METRES else units.consumption(joules, metres),
        f"{distance / units.metres:.1f}",
        f"{duration / 60:.0f}",
    )


def _most(breakdown: Mapping[str, Any] | None) -> str:
    most = None if not breakdown or breakdown["unknown"] else largest_part(breakdown)
    if most is None:
        return "-"
    name = TOGETHER.join(SHORT.get(part, part) for part in most.name.split(TOGETHER))
    return f"{name}, {100 * most.share:.0f} %"
