"""Words for readings that were not used."""

from __future__ import annotations

from collections.abc import Mapping

from evpinn_ros.core.signals.time_jump import SECOND_PUBLISHER

# Not lost: a state of charge without voltage and current is used.
NO_LOSS = ("battery_unmeasured",)
WORDS = {
    "acceleration_impossible": "speeds that change faster than tyres allow",
    "battery_beyond_car": "battery readings beyond what this car can give",
    "battery_doubled": "battery readings with the same time as another",
    "both_lie_on_straight_lines": "rows in which speed and battery lie on straight lines",
    "both_stand_still": "rows in which speed and battery stand still while the car moves",
    "current_stands_still": "currents that stand still while the car does not",
    "battery_late": "battery readings that came too late",
    "battery_out_of_range": "impossible voltages or currents",
    "engine_on": "rows in which the engine turns",
    "no_time": "rows without a time",
    "power_stands_still": "powers that stand still while the car does not",
    SECOND_PUBLISHER: "readings from a second source of the same signal",
    "soc_pct_out_of_range": "states of charge outside of 0 to 100 %",
    "speed_doubled": "speeds with the same time as another",
    "speed_leaps": "speeds that jump as no car can",
    "speed_late": "speeds that came too late",
    "speed_out_of_range": "impossible speeds",
    "speed_stands_still": "speeds that stand still while the car does not",
    "stamp_leaps": "readings whose time jumps",
    "t_s_not_a_number": "rows whose time cannot be read",
    "time_not_increasing": "readings that are not later than the one before",
    "time_out_of_range": "rows with an impossible date",
    "voltage_not_positive": "battery readings without a voltage",
    "voltage_stands_still": "voltages that are not of the traction battery",
    "wrong_number_of_cells": "incomplete rows",
}


def dropped_text(dropped: Mapping[str, int]) -> str:
    """Counts of lost readings by reason, joined by commas; empty if none was lost."""
    lost = ((count, reason) for reason, count in dropped.items() if reason not in NO_LOSS)
    return ", ".join(f"{_words(reason)} ({count})" for count, reason in lost if count)


def _words(reason: str) -> str:
    """Words for a reason; a reason that has spaces is kept."""
    signal, _, value = reason.partition("_sentinel_")
    if value:
        return f"readings of {value} in place of a {signal}"
    return WORDS.get(reason, reason if " " in reason else reason.replace("_", " "))
