"""Where the energy went, for people: rows that add up, parts given together, plain sentences."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, US
from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.terms import COUNT, Part
from evpinn_ros.replays.energy_metrics import NOTHING, PAPER, breakdown_metrics
from evpinn_ros.report.breakdown_text import (
    NAMES,
    breakdown_lines,
    breakdown_notes,
    breakdown_rows,
    shown,
)


def breakdown(correlation: float = 0.0) -> Breakdown:
    """Heating takes 2 of 10 kWh; air and drivetrain are separated, or not."""
    energy = np.array([3.0, 2.0, -0.5, 0.0, 1.0, 1.5, 2.0, 0.9, 4.0]) * JOULES_PER_KWH
    covariance = np.diag(np.full(COUNT, (0.02 * JOULES_PER_KWH) ** 2))
    big = (0.5 * JOULES_PER_KWH) ** 2
    for part in (Part.AIR, Part.DRIVETRAIN, Part.TYRES):
        covariance[part, part] = big
    covariance[Part.AIR, Part.DRIVETRAIN] = correlation * big
    covariance[Part.DRIVETRAIN, Part.AIR] = correlation * big
    totals = 10.0 * JOULES_PER_KWH, 0.0, 5e4, 3000.0
    return Breakdown(*totals, energy=energy, covariance=covariance)


def test_rows_add_up_to_what_was_measured():
    for correlation in (0.0, -0.99):
        found = breakdown_metrics(breakdown(correlation), "hybrid")
        assert sum(part["kwh"] for _, part in shown(found)) == pytest.approx(10.0)
        assert found["unexplained"]["kwh"] == pytest.approx(0.1)
        assert found["air"]["kwh_per_100km"] == pytest.approx(6.0)


def test_what_cannot_be_told_apart_is_one_row_and_says_so():
    found = breakdown_metrics(breakdown(-0.99), "hybrid")
    names = [row[0] for row in breakdown_rows(found)]
    assert "air and wind + motor and drivetrain" in names
    assert "air and wind" not in names
    assert any("cannot separate" in line for line in breakdown_lines(found))
    apart = breakdown_metrics(breakdown(), "hybrid")
    assert not any("cannot separate" in line for line in breakdown_lines(apart))


def test_a_sentence_tells_of_heating_where_it_took_much_else_of_the_largest_part():
    found = breakdown_metrics(breakdown(), "hybrid")
    sentence = "Heating and cooling took 1.97 to 2.03 kWh (9 times in 10), a fifth of this drive."
    assert breakdown_lines(found)[0] == sentence
    found["speed"] = found["speed"] | {"kwh": 4.0, "sigma_kwh": 0.1}
    found["measured"] = found["measured"] | {"kwh": 14.0}
    for less in ({"kwh": 0.9}, {"sigma_kwh": 1.5}):
        found["climate"] = found["climate"] | less
        sentence = "Air and wind took 2.2 to 3.8 kWh (9 times in 10), a fifth of this drive."
        assert breakdown_lines(found)[0] == sentence


def test_a_drive_that_went_down_is_told_by_what_was_spent_and_what_came_back():
    """Ten kWh spent and eight given back: heating took a fifth of what was spent, not all."""
    down = breakdown()
    energy = down.energy.copy()
    energy[Part.SLOPE] -= 8.0 * JOULES_PER_KWH
    found = breakdown_metrics(replace(down, energy=energy, measured=2 * JOULES_PER_KWH), "hybrid")
    assert breakdown_lines(found)[0] == (
        "Heating and cooling took 1.97 to 2.03 kWh (9 times in 10), a fifth of what was spent. "
        "The way down gave back 8.47 to 8.53 kWh (9 times in 10)."
    )
    found["brakes"] = found["brakes"] | {"kwh": 9.0, "sigma_kwh": 1.0}
    found["climate"] = found["climate"] | {"kwh": 0.1}
    assert breakdown_lines(found)[0].startswith(
        "Braking lost 7.4 to 10.6 kWh (9 times in 10), 54 % of what was"
    )


def test_parts_that_are_not_separated_take_together():
    found = breakdown_metrics(breakdown(), "hybrid")
    group = {"kwh": 5.0, "sigma_kwh": 0.2, "kwh_per_100km": 10.0, "share": 0.5}
    found["together"] = [{"parts": ["brakes", "drivetrain"], **group}]
    found["climate"] = found["climate"] | {"kwh": 0.0}
    begin = "Braking and drivetrain together took "
    assert breakdown_lines(found)[0].startswith(begin)
    found["together"] = [{"parts": ["air", "tyres", "standing"], **group}]
    begin = "Air, tyres and standing load together took "
    assert breakdown_lines(found)[0].startswith(begin)


def test_what_rounds_to_nothing_has_no_sign():
    found = breakdown_metrics(breakdown(), "hybrid")
    found["speed"] = {"kwh": -4e-4, "sigma_kwh": 0.1, "kwh_per_100km": -4e-3, "share": -4e-5}
    (row,) = [row for row in breakdown_rows(found) if row[0].startswith("kinetic")]
    assert row[1:] == ("0.000", "0.100", "0.00", "0.0 %")


def test_rows_in_other_units_are_the_same_energy():
    found = breakdown_metrics(breakdown(), "hybrid")
    metric, us = (float(breakdown_rows(found, units)[0][3]) for units in (METRIC, US))
    assert us == pytest.approx(metric * 1000 / 100 * 1.609344, rel=1e-3)
    assert "31.1 mi" in breakdown_notes(found, US)[-1]


@pytest.mark.parametrize(("mode", "why"), [("paper", PAPER), ("hybrid", NOTHING)])
def test_no_breakdown_is_null_with_the_reason(mode, why):
    found = breakdown_metrics(None, mode)
    assert found["unknown"] == why
    assert all(found[name]["kwh"] is None for name in NAMES)
    assert breakdown_rows(found) == []
    assert why in breakdown_lines(found)[0]


def test_what_the_model_does_not_account_for_is_said():
    found = breakdown_metrics(breakdown(), "hybrid")
    assert not any(line.startswith("Unexplained") for line in breakdown_lines(found))
    found["unexplained"] |= {"kwh": -0.22, "sigma_kwh": 0.02}
    assert any(
        line.startswith("Unexplained: -0.25 to -0.19 kWh") for line in breakdown_lines(found)
    )


def test_a_log_without_heights_says_where_a_climb_would_appear():
    found = breakdown_metrics(breakdown(), "hybrid")
    assert not any("No heights" in line for line in breakdown_lines(found))
    flat = breakdown_metrics(replace(breakdown(), unseen=5e4), "hybrid")
    assert any(line.startswith("No heights in this log") for line in breakdown_lines(flat))
