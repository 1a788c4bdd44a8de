"""Where the energy went, for people: rows that add up, parts given together, plain sentences."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest

from evpinn_ros.common.units import JOULES_PER_KWH, METRIC, fixed
from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.terms import COUNT, Part
from evpinn_ros.replays.energy_metrics import INVALID, NOTHING, PAPER, breakdown_metrics
from evpinn_ros.report.breakdown_text import NAMES, breakdown_lines, breakdown_rows, shown
from evpinn_ros.report.drive_charts import breakdown_values


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


@given(st.floats(-1e3, 1e3), st.integers(0, 4), st.sampled_from(["", "+"]))
def test_no_zero_has_a_minus(value, digits, sign):
    text = fixed(value, digits, sign)
    assert float(text) == round(value, digits)
    assert text.startswith("-") == (float(text) < 0.0)


def test_rows_add_up_to_what_was_measured():
    for correlation in (0.0, -0.99):
        metrics = breakdown_metrics(breakdown(correlation), "hybrid")
        assert sum(part["kwh"] for _, part in shown(metrics)) == pytest.approx(10.0)
        assert metrics["unexplained"]["kwh"] == pytest.approx(0.1)
        assert metrics["air"]["kwh_per_100km"] == pytest.approx(6.0)


def test_what_cannot_be_told_apart_is_one_row_and_says_so():
    metrics = breakdown_metrics(breakdown(-0.99), "hybrid")
    names = [row[0] for row in breakdown_rows(metrics)]
    assert "air and wind + motor and drivetrain" in names
    assert "air and wind" not in names
    assert any("only as one sum" in line for line in breakdown_lines(metrics))
    apart = breakdown_metrics(breakdown(), "hybrid")
    assert not any("only as one sum" in line for line in breakdown_lines(apart))


def test_no_interval_of_a_loss_begins_below_zero():
    """Tyres are 0.5 +- 0.5 kWh; a net climb may be negative, and so its interval."""
    energy, unsure = breakdown().energy.copy(), breakdown()
    energy[Part.TYRES], energy[Part.AIR] = 0.5 * JOULES_PER_KWH, 4.5 * JOULES_PER_KWH
    rows = breakdown_values(breakdown_metrics(replace(unsure, energy=energy), "hybrid"), METRIC)
    texts = {row["name"]: row for row in rows["parts"]}
    assert texts["tyres"]["text"].startswith("0.50 kWh (0.00 to 1.32)")
    assert texts["net climb"]["text"].startswith("-0.50 kWh (-0.53 to -0.47)")
    assert texts["tyres"]["from_"] == texts["tyres"]["zero"]


@pytest.mark.parametrize(
    ("mode", "mass", "why"),
    [("paper", "valid", PAPER), ("hybrid", "estimating", NOTHING), ("hybrid", "invalid", INVALID)],
)
def test_no_breakdown_is_null_with_the_reason(mode, mass, why):
    nothing = breakdown_metrics(None, mode, mass)
    assert nothing["unknown"] == why
    assert all(nothing[name]["kwh"] is None for name in NAMES)
    assert breakdown_rows(nothing) == []
    assert why in breakdown_lines(nothing)[0]
