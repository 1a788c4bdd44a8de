"""The live view as an object for scripts: what `evpinn watch --json` prints once a second.

SI units; None where nothing is known. The current keeps the sign of `battery/state`; power and
energy are positive when drawn from the battery.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from evpinn_ros import topics
from evpinn_ros.live.screen import RATES
from evpinn_ros.live.state import POWERS, LiveState


def as_json(state: LiveState, now: float) -> dict[str, Any]:
    """State of the system, ready for `json.dumps`."""
    battery = state.fresh_battery(now)
    return {
        "speed_mps": _known(state.fresh_speed(now)),
        "voltage_v": _known(battery.voltage) if battery else None,
        "current_a": _known(battery.current) if battery else None,
        "power_w": {name: _estimate(*state.power(topic, now)) for topic, name in POWERS.items()},
        "receiving": state.received,
        "state_of_charge": _known(state.charge()),
        "wh_per_km": _known(state.consumption()),
        "energy_j": _numbers(state.vector(topics.ENERGY_STATE)),
        "breakdown_j": {
            name: _estimate(value, state.sigmas(topics.ENERGY_BREAKDOWN).get(name, math.nan))
            for name, value in state.vector(topics.ENERGY_BREAKDOWN).items()
        },
        "consumption": _numbers(state.vector(topics.ENERGY_CONSUMPTION)),
        "range_m": _numbers(state.vector(topics.ENERGY_RANGE)),
        "parameters": {
            row.name: {
                **_estimate(row.value, row.sigma),
                "prior_share": _known(row.prior_share),
                "lower": _known(row.lower),
                "upper": _known(row.upper),
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


def _estimate(value: float, std: float) -> dict[str, float | None]:
    return {"value": _known(value), "std": _known(std)}


def _numbers(found: Mapping[str, float]) -> dict[str, float | None]:
    return {name: _known(value) for name, value in found.items()}


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
