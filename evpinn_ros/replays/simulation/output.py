"""Writes a simulated drive: the bag, its truth and, if wanted, the CAN log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
import yaml

from evpinn_ros.bags.convert import write_readings
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.can.logs import write_log
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.writer import write_file
from evpinn_ros.core.signals.progress import reported
from evpinn_ros.core.signals.readings import MotorReading
from evpinn_ros.replays.simulation.simulate import SimulatedDrive
from evpinn_ros.replays.simulation.truth import DEFINITIONS
from evpinn_ros.replays.simulation.truth_file import TRUTH_FILE


def write(
    drive: SimulatedDrive,
    folder: Path,
    can_log: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write a drive as the bag `folder` with `truth.yaml`, and as the candump log `can_log`.

    `progress` takes the written seconds of the drive.

    Raises:
        InputError: the bag cannot be written; nothing of it is left.
    """
    bag = BagWriter(folder)
    try:
        with bag:
            write_readings(reported(drive.readings, progress), bag)
        text = yaml.safe_dump(truth_document(drive), sort_keys=False, width=99)
        write_file(folder / TRUTH_FILE, text)
    except OSError as error:
        rmtree(folder, ignore_errors=True)
        raise InputError(f"{folder}: {error.strerror or error}; it was removed") from error
    if can_log is not None:
        write_log(can_log, drive.frames)


def truth_document(drive: SimulatedDrive) -> dict[str, Any]:
    """Content of `truth.yaml`, to six digits; estimators must not read `hidden`."""
    truth = drive.truth
    drive_of = {
        "vehicle": drive.vehicle.key,
        "kind": drive.kind.value,
        "duration_s": drive.duration_s,
        "seed": drive.seed,
        "parameters": _plain(truth.parameters._asdict()),
    }
    if drive.equation is not None:
        # The data determine these parameters in a form of eq. 21; it is part of the definition.
        return {**drive_of, "definitions": f"eq. 21, regen_form {drive.equation.value}"}
    return {
        **drive_of,
        "identifiable": _plain(truth.identifiable._asdict()),
        "definitions": dict(DEFINITIONS),
        "hidden": _plain(_hidden(drive)),
    }


def _hidden(drive: SimulatedDrive) -> dict[str, float]:
    car, trace = drive.car, drive.trace
    braking = trace.wheel_power < 0
    offered = -float(np.sum(trace.wheel_power[braking]))
    inverter = any(isinstance(reading, MotorReading) for reading in drive.readings)
    return {
        "auxiliary_load_w": float(np.mean(trace.auxiliary)),
        "no_load_loss_w": float(np.mean(trace.no_load_loss)),
        "friction_brake_share": float(np.sum(trace.friction_power)) / offered if offered else 0.0,
        "rms_grade": float(np.sqrt(np.mean(trace.motion.grade**2))),
        "mean_head_wind_mps": float(np.mean(trace.head_wind)),
        "air_density": car.air_density,
        "rotating_mass_factor": car.rotating_mass_factor,
        "battery_resistance_ohm": car.battery.resistance,
        **({"torque_gain": car.torque_gain} if inverter else {}),
    }


def _plain(values: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(f"{value:.6g}") for name, value in values.items()}
