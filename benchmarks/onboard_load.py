"""Load of all three nodes in one process on a vehicle computer: memory and processor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from benchmarks.processor import processor_seconds
from benchmarks.soak import SEED, VEHICLE, resident_mb
from evpinn_ros.can.logs import write_log
from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.processes import interrupt, own_network
from evpinn_ros.simulation.drive import DriveKind
from evpinn_ros.simulation.simulate import simulate
from evpinn_ros.vehicle.files import load_vehicle

SETTLE = 30.0  # s in which everything is loaded and the first windows are learned
LOOK = 1.0  # s between two looks


@dataclass(frozen=True, slots=True)
class OnboardLoad:
    """`evpinn run` on a drive with 10 Hz speed and 10 Hz battery, in real time."""

    seconds: float  # that were watched
    resident_mb: float  # largest memory of the process
    core_share: float  # of one core, on average


def measure_onboard(seconds: float, progress: Callable[[float], None]) -> OnboardLoad:
    """Run the three nodes on a simulated drive in town.

    They are watched for so many seconds after `SETTLE`; `progress` takes the seconds done.

    Raises:
        InputError: the nodes ended, or no /proc here.
    """
    own_network()
    vehicle = load_vehicle(VEHICLE)
    drive = simulate(DriveKind.URBAN, vehicle, SETTLE + seconds + 60.0, SEED)
    with TemporaryDirectory() as folder:
        log = Path(folder) / "drive.log"
        write_log(log, drive.frames)
        settings = Path(folder) / "nodes.param.yaml"
        settings.write_text(f"/**:\n  ros__parameters:\n    log_file: {log}\n    log_rate: 1.0\n")
        command = [sys.executable, "-m", "evpinn_ros", "run", "--vehicle", VEHICLE]
        with subprocess.Popen(
            [*command, "--params", str(settings)], stderr=subprocess.DEVNULL
        ) as process:
            try:
                return _watched(process, seconds, progress)
            finally:
                interrupt(process)


def _watched(
    process: subprocess.Popen[bytes], seconds: float, progress: Callable[[float], None]
) -> OnboardLoad:
    time.sleep(SETTLE)
    largest, begin = 0.0, time.monotonic()
    if process.poll() is not None:
        raise InputError("the nodes ended before the end of the drive")
    cpu = processor_seconds(process.pid)
    while (elapsed := time.monotonic() - begin) < seconds:
        time.sleep(LOOK)
        if process.poll() is not None:
            raise InputError("the nodes ended before the end of the drive")
        largest = max(largest, resident_mb(process.pid))
        progress(elapsed)
    share = (processor_seconds(process.pid) - cpu) / (time.monotonic() - begin)
    return OnboardLoad(elapsed, largest, share)
