"""`evpinn convert`: any recorded drive into a rosbag2 MCAP of our topics."""

from __future__ import annotations

from collections import Counter
from itertools import chain, islice, takewhile
from pathlib import Path
from typing import Annotated

import typer

from evpinn_ros.bags.convert import reported, write_readings
from evpinn_ros.bags.csv_columns import QUANTITIES
from evpinn_ros.bags.metadata import told_seconds
from evpinn_ros.bags.storage import Storage, change_storage
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.cli.console import note, progress_bar, say, writing
from evpinn_ros.cli.csv_columns import explain_columns
from evpinn_ros.cli.interruption import Interruption
from evpinn_ros.cli.options import CanProfileOption, complete_vehicle
from evpinn_ros.errors import InputError
from evpinn_ros.replay.sources import CsvSource, Source, open_source
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
        str,
        typer.Option(
            help="Vehicle by name or path; CAN logs need it.", autocompletion=complete_vehicle
        ),
    ] = "generic",
    can_profile: CanProfileOption = None,
    trust_profile: Annotated[
        bool, typer.Option("--trust-profile", help="Use it even if the traffic contradicts it.")
    ] = False,
    column: Annotated[
        list[str] | None,
        typer.Option(
            help="Of a CSV file: speed=NAME or speed=NAME:km/h; current=NAME:-A is negative while "
            "it discharges. " + f"Quantities: {', '.join(QUANTITIES)}."
        ),
    ] = None,
    storage: Annotated[
        Storage | None,
        typer.Option(help="Keep a bag as it is, every topic, and change its storage alone."),
    ] = None,
) -> None:
    """Convert a recorded drive into a rosbag2 bag: MCAP of our topics.

    Columns of a CSV file are found by their names and values; what was taken for what is told.
    The names t_s, speed_mps, voltage_v, current_a (positive = discharge) or power_w, and
    optionally elevation_m, ambient_c, heating_w, aircon_w, soc_pct are taken as they are.

    Example: evpinn convert drive.csv out/drive --vehicle bmw_i3

    Example: evpinn convert out/drive out/drive_sqlite3 --storage sqlite3
    """
    if storage is not None:
        _change_storage(source_path, out, storage)
        return
    car = load_vehicle(vehicle)
    source = open_source(
        source_path, car, can_profile, trust_profile=trust_profile, columns=column or ()
    )
    explain_columns(source)
    with Interruption() as interruption:
        dropped = _write(source, out, interruption)
        dropped.update(source.dropped)
        if isinstance(source, CsvSource):
            _explain_csv(source, car.nominal_voltage)
        for reason, count in sorted(dropped.items()):
            note(f"{source_path}: {count} readings dropped: {reason}")
        if source.problem:
            raise InputError(f"{source.problem}; what could be read is in {out}")
        say(f"{out}")


def _write(source: Source, out: Path, interruption: Interruption) -> Counter[str]:
    """Write the readings up to an interruption; gives those left out, by reason."""
    with progress_bar(source.path.name, told_seconds(source.path)) as progress:
        readings = reported(source.readings(), progress)
        # What gives no reading at all is refused here, before there is an empty bag of it.
        begun = list(islice(readings, 1))
        if not begun:
            reasons = ", ".join(f"{n} {reason}" for reason, n in sorted(source.dropped.items()))
            raise InputError(f"{source.path}: no reading in it; dropped: {reasons or 'nothing'}")
        kept = takewhile(lambda _: not interruption.asked, chain(begun, readings))
        with writing(out), BagWriter(out) as writer:
            return write_readings(kept, writer)


def _explain_csv(source: CsvSource, nominal_voltage: float) -> None:
    drive = source.drive
    if drive.ignored and not any(rule.why for rule in drive.rules):  # else it is told already
        note(f"{source.path}: columns not used: {', '.join(drive.ignored)}")
    if drive.at_nominal_voltage:
        note(
            f"{source.path}: {drive.at_nominal_voltage} battery readings hold power alone; "
            f"their voltage is the nominal {nominal_voltage:g} V"
        )


def _change_storage(source: Path, out: Path, storage: Storage) -> None:
    with Interruption() as interruption:
        with writing(out), progress_bar(source.name, told_seconds(source)) as progress:
            change_storage(source, out, storage, progress, lambda: interruption.asked)
        say(f"{out}")
