"""`evpinn convert`: writes a recorded drive as a rosbag2 MCAP bag of this package's topics."""

from __future__ import annotations

from collections import Counter
from itertools import chain, islice, takewhile
from pathlib import Path
from typing import Annotated

import typer

from evpinn_ros.bags.convert import write_readings
from evpinn_ros.bags.metadata import stated_seconds
from evpinn_ros.bags.storage import Storage, change_storage
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.cli.console import note, progress_bar, say, writing
from evpinn_ros.cli.interruption import Interruption
from evpinn_ros.cli.options import complete_vehicle, with_read_options
from evpinn_ros.cli.table_columns import explain_columns, explain_notes
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.progress import reported
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions
from evpinn_ros.logs.source import Source
from evpinn_ros.logs.sources import open_source


@with_read_options
def convert(
    source_path: Annotated[
        Path,
        typer.Argument(
            metavar="IN",
            help="Log of an app (CSV, xlsx, ...), CAN log, or bag of topics or CAN frames.",
        ),
    ],
    out: Annotated[Path, typer.Argument(help="Folder of the new bag.")],
    vehicle: Annotated[
        str,
        typer.Option(
            help="Name or file of the vehicle; CAN logs need it.", autocompletion=complete_vehicle
        ),
    ] = "generic",
    read_options: ReadOptions = READ_DEFAULTS,
    storage: Annotated[
        Storage | None,
        typer.Option(help="Only change the storage format of a bag; every topic is kept."),
    ] = None,
) -> None:
    """Convert a recorded drive into a rosbag2 bag with the topics of this package.

    Columns of a table are found by their names and values, and the choice is printed. Names such
    as t_s, speed_mps, voltage_v and current_a (positive = discharge) are used without guessing.

    Example: evpinn convert drive.csv out/drive --vehicle bmw_i3

    Example: evpinn convert out/drive out/drive_sqlite3 --storage sqlite3
    """
    if storage is not None:
        seconds = stated_seconds(source_path)
        with Interruption() as interruption:
            with writing(out), progress_bar(source_path.name, seconds) as progress:
                change_storage(
                    source_path, out, storage, progress, lambda: interruption.asked, note
                )
            say(f"{out}")
        return
    car = load_vehicle(vehicle)
    source = open_source(source_path, car, read_options)
    explain_columns([source])
    with Interruption() as interruption:
        dropped = _write(source, out, interruption)
        dropped.update(source.dropped)
        explain_notes(source)
        for reason, count in sorted(dropped.items()):
            note(f"{source_path}: {count} readings dropped: {reason}")
        if source.problem:
            raise InputError(f"{source.problem}; what could be read is in {out}")
        say(f"{out}")


def _write(source: Source, out: Path, interruption: Interruption) -> Counter[str]:
    """Write the readings until an interruption; returns counts of dropped readings by reason."""
    with progress_bar(source.path.name, source.seconds) as progress:
        readings = reported(source.readings(), progress)
        # An input without readings is refused here, before an empty bag is created.
        first = list(islice(readings, 1))
        if not first:
            reasons = ", ".join(f"{n} {reason}" for reason, n in sorted(source.dropped.items()))
            raise InputError(f"{source.path}: no reading in it; dropped: {reasons or 'nothing'}")
        kept = takewhile(lambda _: not interruption.asked, chain(first, readings))
        with writing(out), BagWriter(out) as writer:
            return write_readings(kept, writer)
