"""Columns of log apps whose names alone do not tell their meaning."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import re
from typing import NamedTuple


class App(NamedTuple):
    """An app, recognised by columns that no other app has."""

    marks: tuple[str, ...]  # names of columns that only this app writes
    columns: Mapping[str, str]  # column to use by quantity, regardless of other names
    units: Mapping[str, str]  # by column, as `QUANTITIES` spells them
    could_be: Mapping[str, tuple[str, ...]] = {}  # by column, other units that a setting selects


# LeafSpy writes the ambient temperature in degrees F beside packs in both ("LeafSpy Log file
# format", lstech.io). Its Speed is the phone's GPS, which freezes or stops in a pocket; Speed2
# is the car's own, in 0.01 km/h: it agrees with the odometer within 1 % ("Reading logs of apps" in
# docs/project/benchmarks.md).
# Its A/C Pwr is the sum of two estimates and would count the heater's twice.
APPS = (
    App(
        ("Gids",),
        {"speed": "Speed2", "aircon": "Est Pwr A/C(50w)", "heating": "Est Pwr Htr(250w)"},
        {"Ambient": "f", "Speed2": "0.01 km/h"},
        {"Ambient": ("c",)},
    ),
    # The VESC Tool logs one controller, and next to it the sums of all (`_setup`).
    App(
        ("ms_today", "current_in_setup"),
        {"time": "ms_today", "current": "current_in_setup"},
        {"ms_today": "ms", "speed_meters_per_sec": "m/s"},
    ),
    # Trolley buses of Zurich (README of the ZTBus dataset, ETH Zurich): angles in rad.
    App(
        ("electric_powerDemand", "odometry_vehicleSpeed"),
        {"power": "electric_powerDemand", "speed": "odometry_vehicleSpeed"},
        {
            "electric_powerDemand": "w",
            "odometry_vehicleSpeed": "m/s",
            "temperature_ambient": "k",
            "gnss_altitude": "m",
            "gnss_latitude": "rad",
            "gnss_longitude": "rad",
        },
    ),
    # SUMO's trajectories as its `xml2csv.py` writes them ("FCDOutput", sumo.dlr.de).
    App(
        ("timestep_time", "vehicle_speed"),
        {"elevation": "vehicle_z"},
        {"timestep_time": "s", "vehicle_speed": "m/s", "vehicle_slope": "deg", "vehicle_z": "m"},
    ),
)

ANNOTATIONS = ("#group", "#datatype", "#default")  # InfluxDB's rows above the names


def app_of(header: Collection[str]) -> App | None:
    """The app of `APPS` that writes these columns; None for others."""
    return next((app for app in APPS if set(app.marks) <= set(header)), None)


# LeafSpy: the columns of its logs of 2017 and 2018, in three versions of the app.
_CELLS = 96
_LEAFSPY_BEGIN = [
    *("Date/Time", "Lat", "Long", "Elv", "Speed", "Gids", "SOC", "AHr", "Pack Volts"),
    *("Pack Amps", "Max CP mV", "Min CP mV", "Avg CP mV", "CP mV Diff", "Judgment Value"),
    *(f"Pack T{number} {unit}" for number in range(1, 5) for unit in "FC"),
]
_LEAFSPY_END = [
    *("12v Bat Amps", "VIN", "Hx", "12v Bat Volts", "Odo(km)", "QC", "L1/L2"),
    *("TP-FL", "TP-FR", "TP-RR", "TP-RL", "Ambient", "SOH", "RegenWh", "BLevel", "epoch time"),
    *("Motor Pwr(w)", "Aux Pwr(100w)", "A/C Pwr(250w)", "A/C Comp(0.1MPa)"),
    *("Est Pwr A/C(50w)", "Est Pwr Htr(250w)", "Plug State", "Charge Mode", "OBC Out Pwr"),
    *("Gear", "HVolt1", "HVolt2", "GPS Status", "Power SW", "BMS", "OBC", "Debug"),
    *("Motor Temp", "Inverter 2 Temp", "Inverter 4 Temp"),
]
_LEAFSPY_LATER = ("Speed1", "Speed2", "Wiper Status", "Torque Nm")
_DATE_TIME = re.compile(r"\d\d/\d\d/\d{4} \d{1,2}:\d\d:\d\d")
_CELL_MILLIVOLTS = range(2000, 4500)


def layout_of(row: Sequence[str]) -> list[str]:
    """Column names of a LeafSpy row without a header; empty for other rows."""
    begin = len(_LEAFSPY_BEGIN)
    base = begin + _CELLS + len(_LEAFSPY_END)
    most = base + len(_LEAFSPY_LATER) + 1  # newest logs have a cell beyond their header
    if not base <= len(row) <= most or not _DATE_TIME.match(row[0]):
        return []
    # A minus before a cell voltage marks balancing.
    cells = [cell.strip().lstrip("-") for cell in row[begin : begin + _CELLS]]
    if not all(cell.isdigit() and int(cell) in _CELL_MILLIVOLTS for cell in cells):
        return []
    names = (f"CP{number + 1}" for number in range(_CELLS))
    return [*_LEAFSPY_BEGIN, *names, *_LEAFSPY_END, *_LEAFSPY_LATER][: len(row)]
