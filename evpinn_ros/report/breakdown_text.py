"""Rows and sentences on where the energy of a drive went."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import math
from typing import Any, NamedTuple

from evpinn_ros.common.units import METRIC, Units, fixed, kwh_digits
from evpinn_ros.core.estimation.breakdown import MOSTLY_UNSEEN, REGAINED, UNEXPLAINED
from evpinn_ros.core.estimation.calibration import GAUSSIAN_QUANTILE
from evpinn_ros.core.estimation.terms import LOSSES, WHOLE, Part
from evpinn_ros.replays.energy_metrics import MEANINGS

NAMES = tuple(part.name.lower() for part in list(Part)[WHOLE])
TOGETHER = " + "  # between the names of parts that are not separated
LEFT_OUT = (MEANINGS["speed"], UNEXPLAINED)
_LOSSES = {MEANINGS[part.name.lower()] for part in LOSSES}
SHORT = {  # in a column of a table
    MEANINGS["slope"]: "climb",
    MEANINGS["air"]: "air",
    MEANINGS["brakes"]: "braking",
    MEANINGS["drivetrain"]: "drivetrain",
    MEANINGS["climate"]: "heating",
    MEANINGS["standing"]: "standing load",
}
# How a sentence on a part begins.
TOOK = {MEANINGS["slope"]: "climbing took", MEANINGS["brakes"]: "braking lost"}
SHORTEST_MINUTES = 90.0  # s; what is shorter is given in seconds
WORTH_SAYING = 0.1  # share of heating from which on it is mentioned: it can be turned down
# Above this ratio, shares refer to all energy that was spent: a drive downhill takes little in
# sum, and each of its parts is a multiple of that.
GAVE_BACK = 1.1  # spent over measured energy
CONTRADICTED = 3.0  # sigmas of unexplained energy from which on a warning is shown


class KnownPart(NamedTuple):
    """A part that took energy, above zero by more than two sigmas."""

    name: str
    kwh: float
    sigma_kwh: float
    share: float  # of `_whole`


def shown(breakdown: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """(name, amount) of each part that is not zero; parts that the data do not separate joined."""
    groups = {group["parts"][0]: group for group in breakdown["together"]}
    hidden = {name for group in breakdown["together"] for name in group["parts"]}
    rows = []
    for name in (*NAMES, UNEXPLAINED):
        if name in groups:
            rows.append((_together(groups[name]["parts"]), groups[name]))
        elif name not in hidden and (breakdown[name]["kwh"] or breakdown[name]["sigma_kwh"]):
            rows.append((MEANINGS[name], breakdown[name]))
    return rows


def breakdown_columns(units: Units = METRIC) -> tuple[str, ...]:
    """Titles of `breakdown_rows`."""
    return ("where it went", "kWh", "1-sigma", units.rate, "share")


def breakdown_rows(breakdown: Mapping[str, Any], units: Units = METRIC) -> list[tuple[str, ...]]:
    """Rows of text under `breakdown_columns`: the `shown` parts, the total, what was regained."""
    if breakdown["unknown"] is not None:
        return []
    totals = [(MEANINGS[name], breakdown[name]) for name in ("measured", REGAINED)]
    digits = kwh_digits(breakdown["measured"]["kwh"], 3)
    return [_row(name, amount, units, digits) for name, amount in (*shown(breakdown), *totals)]


def breakdown_lines(breakdown: Mapping[str, Any], units: Units = METRIC) -> list[str]:
    """`breakdown_sentence` and `breakdown_notes`, or why there is no breakdown."""
    if breakdown["unknown"] is not None:
        return [f"Where the energy went: {breakdown['unknown']}."]
    return [
        line
        for line in (breakdown_sentence(breakdown), *breakdown_notes(breakdown, units))
        if line
    ]


def breakdown_notes(breakdown: Mapping[str, Any], units: Units = METRIC) -> list[str]:
    """Sentences on doubts about a breakdown, and on the driving that it covers."""
    lines = [
        f"These data show {listed([MEANINGS[part] for part in group['parts']])} only as one sum."
        for group in breakdown["together"]
    ]
    left = breakdown[UNEXPLAINED]
    if abs(left["kwh"]) > CONTRADICTED * left["sigma_kwh"]:
        amount = _amount(left["kwh"], left["sigma_kwh"])
        lines.append(
            f"Unexplained: {amount}. The model of the car does not account for it, so "
            "doubt its parts: a signal or --vehicle may be wrong."
        )
    if breakdown["without_height_m"] > MOSTLY_UNSEEN * breakdown["distance_m"]:
        lines.append(
            "No heights in this log: a climb would appear as air and tyres, so the intervals of "
            "these are wide."
        )
    far = breakdown["distance_m"] / units.metres
    driven = f"{far:.1f} {units.distance} and {duration_text(breakdown['duration_s'])}"
    based = f"Based on {driven} with usable battery data."
    return [*lines, based + _others(breakdown)]


def _others(breakdown: Mapping[str, Any]) -> str:
    """Sentence on energy outside the breakdown; empty if the rounded total does not show it."""
    rest, measured = breakdown.get("left_out_kwh"), breakdown["measured"]["kwh"]
    if rest is None:
        return ""
    digits = kwh_digits(measured + rest, 2)
    total, parts = (f"{kwh:.{digits}f}" for kwh in (measured + rest, measured))
    if total == parts:
        return ""
    return f" Another {rest:.{kwh_digits(rest, 2)}f} of {total} kWh is not broken down."


def duration_text(seconds: float) -> str:
    """A duration in minutes, below 1.5 minutes in seconds."""
    return f"{seconds / 60:.0f} min" if seconds >= SHORTEST_MINUTES else f"{seconds:.0f} s"


def known_parts(breakdown: Mapping[str, Any]) -> list[KnownPart]:
    """Parts above zero by more than two sigmas."""
    whole, _ = _whole(breakdown)
    return [
        KnownPart(name, part["kwh"], part["sigma_kwh"], part["kwh"] / whole)
        for name, part in shown(breakdown)
        if part["kwh"] > 2 * part["sigma_kwh"]
    ]


def _whole(breakdown: Mapping[str, Any]) -> tuple[float, str]:
    """Energy to which shares refer, kWh, and its name: what was measured, or what was spent."""
    spent = sum(max(part["kwh"], 0.0) for _, part in shown(breakdown))
    measured = breakdown["measured"]["kwh"]
    return (measured, "the whole") if spent < GAVE_BACK * measured else (spent, "what was spent")


def largest_part(breakdown: Mapping[str, Any]) -> KnownPart | None:
    """The largest part, except `LEFT_OUT`; None if it is below two sigmas."""
    parts = [row for row in shown(breakdown) if row[0] not in LEFT_OUT]
    name, _ = max(parts, key=lambda row: row[1]["kwh"], default=("", {}))
    return next((part for part in known_parts(breakdown) if part.name == name), None)


def breakdown_sentence(breakdown: Mapping[str, Any]) -> str:
    """Sentences on the largest part, much heating, and descents; empty if none is known."""
    _, whole = _whole(breakdown)
    heating = MEANINGS["climate"]
    warmed = [
        part
        for part in known_parts(breakdown)
        if part.name == heating and part.share > WORTH_SAYING
    ]
    said = dict.fromkeys(filter(None, (largest_part(breakdown), *warmed)))
    sentences = [
        f"{_took(part.name).capitalize()} {_amount(part.kwh, part.sigma_kwh)}, "
        f"{_share(part.share)} of {whole}."
        for part in said
    ]
    slope = dict(shown(breakdown)).get(MEANINGS["slope"], {"kwh": 0.0, "sigma_kwh": 0.0})
    if said and whole != "the whole" and slope["kwh"] < -2 * slope["sigma_kwh"]:
        back = _amount(-slope["kwh"], slope["sigma_kwh"])
        sentences.append(f"The way down gave back {back}.")
    return " ".join(sentences)


def least_of(name: str) -> float:
    """Lower limit of the energy of a part or of joined parts: 0 for losses, else -inf."""
    return 0.0 if set(name.split(TOGETHER)) <= _LOSSES else -math.inf


def _took(name: str) -> str:
    if TOGETHER not in name:
        return TOOK.get(name, f"{name} took")
    return f"{listed([SHORT.get(part, part) for part in name.split(TOGETHER)])} together took"


def _amount(kwh: float, sigma_kwh: float) -> str:
    half = GAUSSIAN_QUANTILE * sigma_kwh
    digits = next((i for i, least in enumerate((0.495, 0.0095, 0.00095), 1) if half >= least), 4)
    low, high = (fixed(limit, digits) for limit in (kwh - half, kwh + half))
    return f"{low} to {high} kWh (9 times in 10)"


def _share(share: float) -> str:
    """A share in words if within 0.02 of a simple fraction, else in percent."""
    plain = {1 / 10: "a tenth", 1 / 5: "a fifth", 1 / 4: "a quarter", 1 / 3: "a third"}
    plain |= {1 / 2: "half", 2 / 3: "two thirds", 3 / 4: "three quarters"}
    near = min(plain, key=lambda share_of_whole: abs(share_of_whole - share))
    return plain[near] if abs(near - share) < 0.02 else f"{100 * share:.0f} %"


def listed(words: Sequence[str]) -> str:
    """Words as a sentence lists them: `a, b and c`."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _together(names: Iterable[str]) -> str:
    return name_of(Part[name.upper()] for name in names)


def name_of(parts: Iterable[Part]) -> str:
    """The name of a part, or of joined parts."""
    return TOGETHER.join(MEANINGS[part.name.lower()] for part in parts)


def _row(
    name: str, amount: Mapping[str, float | None], units: Units, digits: int
) -> tuple[str, ...]:
    def text(value: float | None, places: int) -> str:
        return "-" if value is None else fixed(value, places)

    share, rate = amount["share"], amount["kwh_per_100km"]
    rate = None if rate is None else rate * METRIC.rate_joules / units.rate_joules
    return (
        name,
        text(amount["kwh"], digits),
        text(amount["sigma_kwh"], digits),
        text(rate, 2 if units is METRIC else 1),
        text(None if share is None else 100 * share, 1) + (" %" if share is not None else ""),
    )
