"""`evpinn simulate`: writes a drive with known parameters as a bag and a CAN log."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated

import typer

from evpinn_ros.cli.console import progress_bar, say, writing
from evpinn_ros.cli.interruption import Interruption
from evpinn_ros.cli.options import CanProfileOption, VehicleOption
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.writer import check_outputs
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.output import write
from evpinn_ros.replays.simulation.simulate import EPOCH_NS, RMS_GRADE, SimulatedDrive
from evpinn_ros.replays.simulation.simulate import simulate as simulate_drive
from evpinn_ros.replays.simulation.truth_file import TRUTH_FILE

START = datetime.fromtimestamp(EPOCH_NS / NANOSECONDS, timezone.utc).replace(tzinfo=None)


def simulate(
    out: Annotated[Path, typer.Argument(help="Folder of the new bag.")],
    vehicle: VehicleOption = "tesla_model_3_lr",
    kind: Annotated[DriveKind, typer.Option(help="Kind of road.")] = DriveKind.URBAN,
    duration: Annotated[float, typer.Option(help="Length of the drive, s.")] = 600.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 1,
    true: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help=f"Set a true parameter; may be repeated. Names: {', '.join(PARAMETER_NAMES)}. "
            "Parameters not set are random.",
        ),
    ] = None,
    hills: Annotated[
        float, typer.Option(help="Root mean square grade of the road, %; 0 is flat.")
    ] = 100 * RMS_GRADE,
    start: Annotated[
        datetime, typer.Option(help="Start of the drive, UTC.", show_default=False)
    ] = START,
    altitude: Annotated[bool, typer.Option("--altitude", help="Record a barometer too.")] = False,
    temperature: Annotated[
        bool, typer.Option("--temperature", help="Record a thermometer too.")
    ] = False,
    motor_torque: Annotated[
        bool,
        typer.Option("--motor-torque", help="Record the motor's torque too, as cars estimate it."),
    ] = False,
    equation: Annotated[
        RegenForm | None,
        typer.Option(metavar="FORM", help="Obey this form of eq. 21 exactly, on a flat road."),
    ] = None,
    can_profile: CanProfileOption = None,
    can_log: Annotated[
        Path | None, typer.Option(help="Write the CAN frames too, as a candump .log.")
    ] = None,
) -> None:
    """Simulate a drive whose true parameters are known.

    The simulated car is more complex than the estimator's model: it has an efficiency map,
    friction brakes, wind, changing auxiliary loads, hills, and sensors with lag and noise. OUT
    is a bag with the true values in truth.yaml. The same arguments give the same drive.

    Example: evpinn simulate drive --kind mixed --seed 7 --true mass=2050
    """
    if equation is not None and hills != 100 * RMS_GRADE and hills != 0:
        raise InputError("--hills cannot be combined with --equation, which needs a flat road")
    drive = simulate_drive(
        kind,
        load_vehicle(vehicle),
        duration,
        seed,
        car=_parameters(true or []),
        rms_grade=hills / 100,
        can_profile=can_profile,
        altitude=altitude,
        temperature=temperature,
        motor_torque=motor_torque,
        start_ns=round(start.replace(tzinfo=timezone.utc).timestamp()) * NANOSECONDS,
        equation=equation,
    )
    check_outputs((out, can_log))
    with Interruption():  # never cut short: truth.yaml describes the whole drive
        with writing(out), progress_bar(out.name, total=duration) as progress:
            write(drive, out, can_log, progress)
        for line in _summary(drive, out):
            say(line)


def _parameters(given: list[str]) -> dict[str, float]:
    parameters = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            parameters[name] = float(value)
        except ValueError:
            raise InputError(f"--true {text}: expected NAME=VALUE") from None
    return parameters


def _summary(drive: SimulatedDrive, out: Path) -> list[str]:
    motion, truth = drive.trace.motion, drive.truth
    return [
        f"{out}: {drive.duration_s:g} s, {len(drive.readings)} readings, "
        f"top speed {motion.speed.max() * 3.6:.0f} km/h",
        *(f"  {name:20} {value:.6g}" for name, value in truth.parameters._asdict().items()),
        f"  definitions and other true values: {out / TRUTH_FILE}",
    ]
