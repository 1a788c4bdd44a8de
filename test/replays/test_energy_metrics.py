"""Account of a car as JSON, in units for people."""

import math

import pytest

from evpinn_ros.core.energy.account import AccountSummary, EnergyTotals
from evpinn_ros.core.energy.charge import Uncertain
from evpinn_ros.core.energy.remaining import Remaining
from evpinn_ros.replays.energy_metrics import account_metrics

KWH = 3.6e6


def summary(remaining: Remaining | None) -> AccountSummary:
    return AccountSummary(
        stamp_ns=1,
        since_reset=EnergyTotals(12 * KWH, 2 * KWH, KWH**2, 50_000.0),
        lifetime=EnergyTotals(900 * KWH, 100 * KWH),
        consumption={"10": 720.0},
        charge=Uncertain(0.8, math.nan),
        projected=False,
        capacity=Uncertain(75 * KWH, KWH),
        usable=Uncertain(60 * KWH, KWH),
        remaining=remaining,
    )


def test_energy_is_kwh_consumption_kwh_per_100_km_and_range_km() -> None:
    metrics = account_metrics(summary(Remaining(300_000.0, 1.0, 250_000.0, 350_000.0)))
    assert metrics["energy"] == {
        **{"trip_kwh": 10.0, "trip_sigma_kwh": 1.0, "trip_km": 50.0, "unmeasured_s": 0.0},
        **{"drawn_kwh": 900.0, "regenerated_kwh": 100.0},
    }
    assert metrics["consumption"] == {"10": pytest.approx(20.0)}
    assert metrics["range"] == {
        **{"charge_percent": 80.0, "charge_projected": False, "usable_kwh": 60.0},
        **{"capacity_kwh": 75.0, "range_km": 300.0, "lower_km": 250.0, "upper_km": 350.0},
    }
