"""Energy account of a car as JSON, in units for people."""

from __future__ import annotations

from typing import Any

from evpinn_ros.common.units import JOULES_PER_KWH
from evpinn_ros.energy.account import AccountSummary

KWH_PER_100KM = JOULES_PER_KWH / 1e5  # J/m


def account_metrics(found: AccountSummary) -> dict[str, dict[str, Any]]:
    """Values of an account under `energy`, `consumption` and `range`; NaN and None are unknown.

    Energies are kWh, consumptions kWh/100 km, distances km.
    """
    trip, life, remaining = found.since_reset, found.lifetime, found.remaining
    return {
        "energy": {
            "trip_kwh": trip.net.value / JOULES_PER_KWH,
            "trip_sigma_kwh": trip.net.sigma / JOULES_PER_KWH,
            "trip_km": trip.distance / 1e3,
            "drawn_kwh": life.drawn / JOULES_PER_KWH,
            "regenerated_kwh": life.regenerated / JOULES_PER_KWH,
            "unmeasured_s": trip.unmeasured_s,
        },
        "consumption": {name: value / KWH_PER_100KM for name, value in found.consumption.items()},
        "range": {
            "charge_percent": 100.0 * found.charge.value,
            "charge_projected": found.projected,
            "usable_kwh": found.usable.value / JOULES_PER_KWH,
            "capacity_kwh": found.capacity.value / JOULES_PER_KWH,
            "range_km": remaining and remaining.distance / 1e3,
            "lower_km": remaining and remaining.lower / 1e3,
            "upper_km": remaining and remaining.upper / 1e3,
        },
    }
