"""The live view as an object for scripts: what `evpinn watch --json` prints once a second.

SI units; None or NaN where nothing is known. The current keeps the sign of `battery/state`; power
and energy are positive when drawn from the battery.
"""

from __future__ import annotations

import math
from typing import Any

from evpinn_ros import topics
from evpinn_ros.live.screen import RATES
from evpinn_ros.live.state import POWERS, LiveState


def as_json(state: LiveState, now: float) -> dict[str, Any]:
    """State of the system, ready for `json_text`."""
    battery = state.fresh_battery(now)
    parts, sigmas = state.vector(topics.ENERGY_BREAKDOWN), state.sigmas(topics.ENERGY_BREAKDOWN)
    return {
        "speed_mps": state.fresh_speed(now),
        "voltage_v": battery.voltage if battery else None,
        "current_a": battery.current if battery else None,
        "power_w": {name: _estimate(*state.power(topic, now)) for topic, name in POWERS.items()},
        "receiving": state.received,
        "state_of_charge": state.charge(),
        "wh_per_km": state.consumption(),
        "energy_j": state.vector(topics.ENERGY_STATE),
        "breakdown_j": {
            name: _estimate(value, sigmas.get(name, math.nan)) for name, value in parts.items()
        },
        "consumption": state.vector(topics.ENERGY_CONSUMPTION),
        "range_m": state.vector(topics.ENERGY_RANGE),
        "parameters": {
            row.name: {
                **_estimate(row.value, row.sigma),
                "prior_share": row.prior_share,
                "lower": row.lower,
                "upper": row.upper,
                "state": row.state or None,
            }
            for row in state.parameters()
        },
        "per_second": {name: state.rate(topic, now) for name, topic in RATES.items()},
        "doing": state.activity(now) or None,
        "problems": [
            {"level": level.name.lower(), "text": text} for level, text in state.problems(now)
        ],
    }


def _estimate(value: float, std: float) -> dict[str, float]:
    return {"value": value, "std": std}
