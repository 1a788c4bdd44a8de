"""The report of what was replayed: of a command, or from Python."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from evpinn_ros.common.units import METRIC, Units
from evpinn_ros.replays.run import Replayed, ReplayOptions
from evpinn_ros.report.drive_page import ReportedDrive, write_drives
from evpinn_ros.simulation.truth_file import read_truth
from evpinn_ros.vehicle.files import Vehicle


def write_replayed(
    path: Path,
    done: Sequence[Replayed],
    vehicle: Vehicle,
    options: ReplayOptions,
    command: str,
    units: Units = METRIC,
) -> None:
    """Write the report of replayed drives, with the truth that lies beside simulated ones."""
    drives = [
        ReportedDrive(
            drive=each.drive,
            found=each.metrics,
            vehicle=vehicle,
            warm_up=options.warm_up,
            withheld_from=options.withhold_battery_after,
            truth=read_truth(Path(each.metrics["input"]["path"])),
        )
        for each in done
    ]
    write_drives(path, drives, command, units)
