"""Text of parameters: decimals, units and a word for each. Light, for the live view loads it."""

from __future__ import annotations

DECIMALS = {"eta": 3, "mu": 3, "mass": 0, "c_rr": 5, "c_d": 4, "p_aux": 0}
UNITS = {"mass": " kg", "p_aux": " W"}
MEANINGS = {
    "eta": "motor efficiency",
    "mu": "regeneration",
    "mass": "all aboard",
    "c_rr": "rolling",
    "c_d": "drag",
    "p_aux": "auxiliary",
}


def number(name: str, value: float) -> str:
    """A parameter with its digits and unit."""
    return f"{value:.{DECIMALS[name]}f}{UNITS.get(name, '')}"
