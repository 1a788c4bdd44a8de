"""`evpinn reproduce`: repeats the paper's experiment on a recorded drive."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from evpinn_ros.cli.options import VehicleOption, with_read_options
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper.settings import OptimizerName, Settings
from evpinn_ros.logs.read_options import READ_DEFAULTS, ReadOptions


class Device(str, Enum):
    """Device to train on."""

    CPU = "cpu"
    CUDA = "cuda"


@with_read_options
def reproduce(
    log: Annotated[Path, typer.Argument(help="CSV, bag or CAN log of one drive.")],
    vehicle: VehicleOption,
    optimizer: Annotated[
        OptimizerName | None,
        typer.Option(
            help="Optimizer of the power network; if not given, adam, or gauss_newton (--quick).",
            show_default=False,
        ),
    ] = None,
    epochs: Annotated[
        int | None,
        typer.Option(
            min=1, help="Epochs of the power network; if not given, 10000 for adam, else fewer."
        ),
    ] = None,
    regen_form: Annotated[RegenForm, typer.Option(help="Form of eq. 21.")] = RegenForm.RECOVERY,
    seed: Annotated[int, typer.Option(min=0, help="Seed of split, networks and batches.")] = 0,
    device: Annotated[Device, typer.Option(help="Device to train on.")] = Device.CPU,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="A first look, with a faster training than the paper's.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for report, results and trainings; else out/reproduce/LOG."),
    ] = None,
    read_options: ReadOptions = READ_DEFAULTS,
) -> None:
    """Repeat the experiment of the EV-PINN paper on a drive, and check every claim.

    Shows the tables II, IV, V and VI and the figures 5, 8 and 9 (for a Model S table III and
    figures 6, 8 and 10) beside the numbers of the paper. Adds what the paper leaves out: a
    baseline, a chronological split, the published parameters on this drive, and least squares. It
    takes half an hour on one core, with --quick up to five minutes. If you stop it, the same
    command continues.

    Example: evpinn reproduce drive.csv --vehicle tesla_model_3_lr --quick
    """
    from evpinn_ros.extras.paper.run import run_reproduction

    settings = Settings.chosen(
        optimizer, epochs, quick, seed=seed, device=device.value, form=regen_form
    )
    run_reproduction(log, vehicle, settings, out, read_options, quick=quick)
