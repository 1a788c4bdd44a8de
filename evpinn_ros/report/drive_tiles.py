"""The figures of a drive that stand first: a value and what it is, each."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import timedelta

from evpinn_ros.common.units import JOULES_PER_KWH, Units
from evpinn_ros.estimation.breakdown import LEAST_DISTANCE
from evpinn_ros.replays.driven import DrivenSteps, charged
from evpinn_ros.replays.history import Drive
from evpinn_ros.replays.owner_text import LEAST_CHARGED, NEARLY_WHOLE


def drive_tiles(
    drive: Drive, travelled: DrivenSteps, measured: DrivenSteps, units: Units
) -> Iterator[tuple[str, str]]:
    """Energy over distance, then the rest that is known of the drive."""
    far, energy = float(travelled.distance.sum()), float(measured.energy.sum())
    known = float(measured.distance.sum())
    if known >= LEAST_DISTANCE:
        part = "" if known > NEARLY_WHOLE * far else f", over {_distance(known, units)} measured"
        yield units.consumption(energy, known), f"{units.economy}{part}"
    if len(measured.energy):
        yield f"{energy / JOULES_PER_KWH:.3g} kWh", "from the battery"
    taken = charged(drive)
    if taken >= LEAST_CHARGED:
        yield (
            f"{taken / JOULES_PER_KWH:.3g} kWh",
            "charged while parked, not included elsewhere",
        )
    seconds = float(travelled.seconds.sum())
    mean = far / seconds * units.speeds if seconds else 0.0
    time = clock(drive.duration)
    if seconds < NEARLY_WHOLE * drive.duration:
        time = f"{clock(seconds)} recorded of {time}"
    yield _distance(far, units), f"in {time}, {mean:.0f} {units.speed} on average"
    if len(drive.charge):
        begin, end = 100 * drive.charge[0, 1], 100 * drive.charge[-1, 1]
        yield f"{begin:.0f} to {end:.0f} %", "state of charge"
    if len(drive.altitude):
        heights = drive.altitude[:, 1] / units.height_metres
        rise = f"{heights[-1] - heights[0]:+.0f} {units.height}"
        yield rise, f"end over begin; {heights.min():.0f} to {heights.max():.0f} {units.height}"
    if len(drive.temperature):
        celsius = drive.temperature[:, 1]
        low, high = (each * units.degrees + units.zero for each in (celsius.min(), celsius.max()))
        degrees = f"{low:.0f}" if round(low) == round(high) else f"{low:.0f} to {high:.0f}"
        yield f"{degrees} {units.temperature}", "outside"


def clock(seconds: float) -> str:
    """A duration as h:mm:ss."""
    return str(timedelta(seconds=round(seconds)))


def _distance(metres: float, units: Units) -> str:
    return f"{metres / units.metres:.1f} {units.distance}"
