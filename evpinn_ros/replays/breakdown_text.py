"""Breakdown of the energy of a drive as metrics, and these as rows and sentences for people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

from evpinn_ros.common.units import METRIC, Units
from evpinn_ros.estimation.breakdown import REGAINED, UNEXPLAINED, Amount, Breakdown
from evpinn_ros.estimation.energy_parts import WHOLE, Part
from evpinn_ros.estimation.estimator import Mode

NAMES = tuple(part.name.lower() for part in list(Part)[WHOLE])
MEANINGS: Mapping[str, str] = {
    "air": "air and wind",
    "tyres": "tyres",
    "slope": "slopes, up less down",
    "speed": "speed the car now has",
    "brakes": "lost while braking",
    "drivetrain": "motor and drivetrain",
    "climate": "heating and cooling",
    "standing": "other standing load",
    UNEXPLAINED: "unexplained",
    "measured": "measured",
    REGAINED: "brought back by braking",
}
LEFT_OUT = (MEANINGS["speed"], UNEXPLAINED)
COLUMNS = ("where it went", "kWh", "1-sigma", METRIC.rate, "share")
WORTH_SAYING = 0.1  # of a drive: from here on heating comes first, for it can be turned down
PAPER = "mode paper: eq. 21 alone does not tell losses and loads apart"
NOTHING = "the battery was measured over no interval that could be learned from"


def breakdown_metrics(found: Breakdown | None, mode: str) -> dict[str, Any]:
    """The values of `--metrics` under `breakdown`; null with the reason where nothing is known."""
    if found is None:
        nothing = dict.fromkeys(Amount.__dataclass_fields__)
        rows: dict[str, Any] = {name: dict(nothing) for name in MEANINGS}
        why = PAPER if mode == Mode.PAPER.value else NOTHING
        return {**rows, "together": [], "distance_m": None, "duration_s": None, "unknown": why}
    amounts = {**found.amounts(), "measured": found.total()}
    return {
        **{name: asdict(amounts[name]) for name in MEANINGS},
        "together": [
            {"parts": [part.name.lower() for part in group], **asdict(found.of(*group))}
            for group in found.together()
        ],
        "distance_m": found.distance,
        "duration_s": found.seconds,
        "unknown": None,
    }


def shown(found: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """The parts by the names people read; those that data do not separate as one.

    What no input tells of is left out: heating of a car that knows no temperature, say.

    Args:
        found: the metrics under `breakdown`.
    """
    groups = {group["parts"][0]: group for group in found["together"]}
    hidden = {name for group in found["together"] for name in group["parts"]}
    rows = []
    for name in (*NAMES, UNEXPLAINED):
        if name in groups:
            rows.append((_together(groups[name]["parts"]), groups[name]))
        elif name not in hidden and (found[name]["kwh"] or found[name]["sigma_kwh"]):
            rows.append((MEANINGS[name], found[name]))
    return rows


def breakdown_rows(found: Mapping[str, Any], units: Units = METRIC) -> list[tuple[str, ...]]:
    """Rows of text under `COLUMNS`: what is `shown`, what was measured, what was brought back."""
    if found["unknown"] is not None:
        return []
    beside = [(MEANINGS[name], found[name]) for name in ("measured", REGAINED)]
    return [_row(name, amount, units) for name, amount in (*shown(found), *beside)]


def breakdown_lines(found: Mapping[str, Any]) -> list[str]:
    """Sentences for people: what is worth saying, if anything is, and what the figures are of."""
    if found["unknown"] is not None:
        return [f"Where the energy went: {found['unknown']}."]
    return [line for line in (breakdown_sentence(found), *breakdown_notes(found)) if line]


def breakdown_notes(found: Mapping[str, Any], units: Units = METRIC) -> list[str]:
    """Sentences on a known breakdown: what is given together, and of how much driving."""
    lines = [
        f"Cannot be separated on this drive, so given together: {_together(group['parts'])}."
        for group in found["together"]
    ]
    minutes, far = found["duration_s"] / 60, found["distance_m"] / units.metres
    driven = f"{far:.1f} {units.distance} and {minutes:.0f} min"
    return [*lines, f"Of the {driven} whose battery was measured."]


def breakdown_sentence(found: Mapping[str, Any]) -> str:
    """Sentence on what is worth saying: of the rows known to two sigmas the largest.

    Heating comes first where it took `WORTH_SAYING`; speed, which stops to be, and what is
    unexplained are left out. Empty where nothing is known so well.
    """
    known = [
        (name, part)
        for name, part in shown(found)
        if name not in LEFT_OUT and part["kwh"] > 2 * part["sigma_kwh"] and part["share"]
    ]
    if not known:
        return ""
    heating = [row for row in known if row[0] == MEANINGS["climate"]]
    first = [row for row in heating if row[1]["share"] > WORTH_SAYING]
    name, most = max(first or known, key=lambda row: row[1]["kwh"])
    digits = 1 if most["sigma_kwh"] >= 0.095 else 2 if most["sigma_kwh"] >= 0.0095 else 3
    amount = f"{most['kwh']:.{digits}f} +- {most['sigma_kwh']:.{digits}f} kWh"
    return f"{name.capitalize()} took {amount}, {_share(most['share'])} of this drive."


def _share(share: float) -> str:
    """A share in words where a plain one is within 2 percent of the whole, else in percent."""
    plain = {1 / 10: "a tenth", 1 / 5: "a fifth", 1 / 4: "a quarter", 1 / 3: "a third"}
    plain |= {1 / 2: "half", 2 / 3: "two thirds", 3 / 4: "three quarters"}
    near = min(plain, key=lambda each: abs(each - share))
    return plain[near] if abs(near - share) < 0.02 else f"{100 * share:.0f} %"


def _together(names: Iterable[str]) -> str:
    return name_of(Part[name.upper()] for name in names)


def name_of(parts: Iterable[Part]) -> str:
    """The name of a part, or of some that are not separated."""
    return " + ".join(MEANINGS[part.name.lower()] for part in parts)


def _row(name: str, amount: Mapping[str, float | None], units: Units) -> tuple[str, ...]:
    def text(value: float | None, form: str) -> str:
        return "-" if value is None else format(round(value, 6) + 0.0, form)

    share, rate = amount["share"], amount["kwh_per_100km"]
    rate = None if rate is None else rate * METRIC.rate_joules / units.rate_joules
    return (
        name,
        text(amount["kwh"], ".3f"),
        text(amount["sigma_kwh"], ".3f"),
        text(rate, ".2f" if units is METRIC else ".1f"),
        text(None if share is None else 100 * share, ".1f") + (" %" if share is not None else ""),
    )
