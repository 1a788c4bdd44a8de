"""`evpinn convert`: any recorded drive into a rosbag2 MCAP of our topics."""

from __future__ import annotations

from collections import Counter
from itertools import chain, islice
from pathlib import Path
from typing import Annotated

import typer

from evpinn_ros.bags.convert import write_readings
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.cli.console import note, results
from evpinn_ros.errors import InputError
from evpinn_ros.replay.sources import CsvSource, open_source
from evpinn_ros.vehicle.files import load_vehicle


def convert(
    source_path: Annotated[
        Path,
        typer.Argument(
            metavar="IN", help="CSV, CAN log (.log, .asc, ...), bag of topics or of CAN frames."
        ),
    ],
    out: Annotated[Path, typer.Argument(help="Folder of the new bag.")],
    vehicle: Annotated[
        str, typer.Option(help="Vehicle by name or path; CAN logs need it.")
    ] = "generic",
    can_profile: Annotated[
        str | None, typer.Option(help="CAN profile, if not the vehicle's own.")
    ] = None,
    trust_profile: Annotated[
        bool, typer.Option("--trust-profile", help="Use it even if the traffic contradicts it.")
    ] = False,
) -> None:
    """Convert a recorded drive into a rosbag2 MCAP bag.

    A CSV file has the columns t_s, speed_mps, voltage_v, current_a (positive = discharge) or
    power_w, and optionally elevation_m, ambient_c, heating_w, aircon_w, soc_pct.

    Example: evpinn convert drive.csv out/drive --vehicle bmw_i3
    """
    car = load_vehicle(vehicle)
    source = open_source(source_path, car, can_profile, trust_profile=trust_profile)
    readings = source.readings()
    # What gives no reading at all is refused here, before there is an empty bag of it.
    begun = list(islice(readings, 1))
    try:
        with BagWriter(out) as writer:
            dropped: Counter[str] = write_readings(chain(begun, readings), writer)
    except OSError as error:  # the disk is full
        raise InputError(f"{out}: {error.strerror}; the bag is cut there") from error
    dropped.update(source.dropped)
    if isinstance(source, CsvSource):
        _explain_csv(source, car.nominal_voltage)
    for reason, count in sorted(dropped.items()):
        note(f"{source_path}: {count} readings dropped: {reason}")
    if source.problem:
        raise InputError(f"{source.problem}; what could be read is in {out}")
    results.print(f"{out}", markup=False, soft_wrap=True)


def _explain_csv(source: CsvSource, nominal_voltage: float) -> None:
    drive = source.drive
    if drive.ignored:
        note(f"{source.path}: columns not used: {', '.join(drive.ignored)}")
    if drive.at_nominal_voltage:
        note(
            f"{source.path}: {drive.at_nominal_voltage} battery readings hold power alone; "
            f"their voltage is the nominal {nominal_voltage:g} V"
        )
