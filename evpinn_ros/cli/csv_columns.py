"""What was made of the columns of a CSV file, in words."""

from __future__ import annotations

from evpinn_ros.cli.console import note
from evpinn_ros.drives.column import Column
from evpinn_ros.drives.open_drive import DriveSource
from evpinn_ros.replay.sources import Source


def explain_columns(source: Source) -> None:
    """Say what was guessed of a CSV file; nothing where all names are ours."""
    if not isinstance(source, DriveSource):
        return
    drive = source.drive
    guessed = [rule for rule in drive.rules if rule.why]
    if not guessed:
        return
    note(f"{source.path}: columns were found by their names and values:")
    for rule in drive.rules:
        note(f"  {_line(rule)}")
    if drive.ignored:
        note(f"  not used: {', '.join(drive.ignored)}")
    note("  if one is wrong: --column speed='NAME:km/h', --column current='NAME:-A', ...")


def _line(rule: Column) -> str:
    told = f", {rule.unit}, {rule.why}" if rule.why else ""
    return f"{rule.quantity}: {rule.name!r}{told}"
