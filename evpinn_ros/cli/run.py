"""`evpinn run`: the three nodes in one process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
import math
from pathlib import Path
import shlex
import signal
import subprocess
import sys
from tempfile import TemporaryDirectory
import time
from typing import Annotated

import typer

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import FRAMES_TOPIC
from evpinn_ros.bags.writer import Split
from evpinn_ros.can.profile import load_profile
from evpinn_ros.cli.console import note
from evpinn_ros.cli.options import (
    CanProfileOption,
    Elm327Option,
    KeptStateOption,
    ParamsOption,
    ReportOption,
    TrustProfileOption,
    UnitsOption,
    VehicleOption,
    elm327_bus,
)
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import check_file
from evpinn_ros.common.stopping import stopped_by
from evpinn_ros.common.units import MEGABYTE, UnitSystem
from evpinn_ros.common.writer import check_outputs, copy_file
from evpinn_ros.core.estimation.estimator import Mode
from evpinn_ros.core.estimation.state_file import account_path
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.saved_state import state_path
from evpinn_ros.topics import BATTERY, SPEEDS
from evpinn_ros.topics.node_parameters import Value
from evpinn_ros.topics.parameter_file import read_parameter_file

POLL_S = 0.2
CUT_SHORT_S = 20.0
"""Time to finish the report after a signal to stop; a service manager kills after 90 s."""

SAME_SIGNAL_S = 1.0  # signals within this time count as one; a later one is passed on

TERMINATED = 143  # 128 + SIGTERM, the exit code of shells


@contextmanager
def reported(
    report: Path, record: Path | None, state: Path | None, options: Sequence[str]
) -> Iterator[Path]:
    """Yields the bag to record to; on exit, `evpinn replay` with `options` makes its report.

    Without `record` the bag is temporary, beside the report. The replay starts from a copy of
    `state` made before the drive.

    Raises:
        InputError: the report's folder cannot be made, or the state not be read.
        typer.Exit: the replay failed.
    """
    if report.is_dir():
        raise InputError(f"--report {report}: a folder is there; give the name of a file")
    with as_input_error():
        report.parent.mkdir(parents=True, exist_ok=True)
        beside = TemporaryDirectory(prefix=f".{report.stem}_", dir=report.parent)
        if state is not None and state.exists() and check_file(state):
            before = Path(beside.name, "state.json")
            copy_file(state, before)
            if account_path(state).exists():
                copy_file(account_path(state), account_path(before))
            options = (*options, "--state", str(before))
    with beside as folder:
        bag = record or Path(folder, "bag")
        occupied = bag.is_file() or (bag.is_dir() and any(bag.iterdir()))
        yield bag
        if occupied or not bag.exists() or _is_empty(bag):
            return  # nothing was recorded, and the nodes have logged the reason
        note(f"evpinn: writing {report}; Ctrl-C cuts it short")
        command = [sys.executable, "-m", "evpinn_ros", "replay", str(bag), *options]
        if code := _run([*command, "--report", str(report)]):
            if record is None:
                kept = bag.rename(report.parent / Path(folder).name.lstrip("."))
                note(f"evpinn: the report is incomplete; the drive is kept: {kept}")
            raise typer.Exit(code)


def _run(command: list[str]) -> int:
    """Run a command in its own session, and pass signals to stop on to it; its exit code."""
    asked_s: list[float] = []
    with stopped_by(lambda *_: asked_s.append(time.monotonic())):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True)
        signalled_s = -math.inf
        while True:
            try:
                code = process.wait(POLL_S)
            except subprocess.TimeoutExpired:
                if asked_s and time.monotonic() - asked_s[0] > CUT_SHORT_S:
                    process.kill()
                elif asked_s and asked_s[-1] - signalled_s > SAME_SIGNAL_S:
                    signalled_s = asked_s[-1]
                    process.send_signal(signal.SIGINT)
            else:
                return code if code >= 0 else TERMINATED


def _is_empty(bag: Path) -> bool:
    with BagReader(bag) as reader:
        return not any(True for _ in reader.log_times())


def _holds_readings(bag: Path) -> bool:
    """Whether a topic that a replay reads has messages; those that the nodes publish always do."""
    with BagReader(bag) as reader:
        return any(
            info.count and topic.endswith(REPLAYED) for topic, info in reader.topics.items()
        )


REPLAYED = *(topic.name for topic in (*SPEEDS, BATTERY)), FRAMES_TOPIC
BRIEF_S = 5.0  # nodes that end sooner failed, and have logged why


def learned_before(state: Path | None, params: Path | None) -> Path | None:
    """State file that the estimator starts from: `state`, else the one named in `params`."""
    if state is None and params is not None:
        return state_path(str(read_parameter_file(params, "estimator").get("state_file", "")))
    return state_path(str(state or ""))


def _say_what_is_kept(begun: float, vehicle: str, record: Path | None, state: Path | None) -> None:
    files = {"the drive": record, "what was learned": state}
    kept = {what: f for what, f in files.items() if f and f.exists() and f.stat().st_mtime > begun}
    if kept:
        note("evpinn: saved " + ", ".join(f"{what}: {file}" for what, file in kept.items()))
    elif time.time() - begun > BRIEF_S:
        note(
            "evpinn: nothing was saved. --record FOLDER keeps the drive, and --state FILE "
            "what was learned"
        )
    if record is not None and record in kept.values() and not _holds_readings(record):
        note("evpinn: no frame, speed or battery reading came, so there is nothing to replay")
    elif record in kept.values():
        of = shlex.join([str(record), "--vehicle", vehicle])
        note(f"evpinn: next: evpinn replay {of} --report drive.html")


def run(
    vehicle: VehicleOption,
    can_interface: Annotated[
        str | None,
        typer.Option(help="python-can interface of the bus; socketcan if not given."),
    ] = None,
    can_channel: Annotated[
        str | None,
        typer.Option(help="Channel of the bus, such as /dev/ttyACM0; can0 if not given."),
    ] = None,
    elm327: Elm327Option = None,
    bitrate: Annotated[
        int | None, typer.Option(min=0, help="Bit rate of the bus, bit/s; 500000 if not given.")
    ] = None,
    bus_option: Annotated[
        str | None,
        typer.Option("--bus-options", help="Options of the interface: 'name=value ...'."),
    ] = None,
    can_profile: CanProfileOption = None,
    trust_profile: TrustProfileOption = False,
    poll: Annotated[
        bool,
        typer.Option(
            "--poll",
            help="Also request values that the car does not broadcast. This keeps the car awake.",
        ),
    ] = False,
    mode: Annotated[
        Mode | None, typer.Option(help="Learning method; hybrid if not given.")
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Record all topics and CAN frames to this new bag.")
    ] = None,
    report: ReportOption = None,
    split_size: Annotated[
        float | None, typer.Option(min=0.1, help="Start a new file of the bag at this size, MB.")
    ] = None,
    split_time: Annotated[
        float | None, typer.Option(min=1.0, help="Start a new file of the bag after this time, s.")
    ] = None,
    params: ParamsOption = None,
    state: KeptStateOption = None,
    units: UnitsOption = UnitSystem.METRIC,
    no_view: Annotated[
        bool, typer.Option("--no-view", help="Print logs in place of the view.")
    ] = False,
) -> None:
    """Run the nodes CAN bridge, estimator and energy until Ctrl-C.

    Without --poll it only listens: nothing is sent to the car. A terminal shows a live view.

    Example: evpinn run --vehicle nissan_leaf --record out/today

    Example: evpinn run --vehicle bmw_i3 --elm327 tcp:192.168.0.10:35000 --poll
    """
    # Imported here: all other commands work where no ROS is.
    from evpinn_ros.nodes.all_in_one import run as run_nodes
    from evpinn_ros.nodes.live.view import live_view

    if elm327 is not None:
        can_interface, can_channel = elm327_bus(elm327, can_interface, can_channel)
    given: dict[str, Value | None] = {
        "vehicle": vehicle,
        "interface": can_interface,
        "channel": can_channel,
        "bitrate": bitrate,
        "bus_options": bus_option,
        "can_profile": can_profile,
        "trust_profile": trust_profile or None,
        "poll": poll or None,
        "mode": mode.value if mode is not None else None,
        "state_file": str(state) if state is not None else None,
        "energy_file": str(state) if state is not None else None,
    }
    if record is None and (split_size or split_time):
        raise typer.BadParameter("--split-size and --split-time need --record")
    if profile := can_profile or load_vehicle(vehicle).can_profile:
        load_profile(profile)  # opened here too, so that no output is written over it
    check_outputs((record, report, state), (params, Path(vehicle)))
    split = Split((split_size or math.inf) * MEGABYTE, split_time or math.inf)
    parameters = {name: value for name, value in given.items() if value is not None}
    ros_args = ["--params-file", str(params)] if params is not None else []
    with ExitStack() as beside:  # closed when the nodes have ended, before this process ends
        start = learned_before(state, params)
        beside.callback(_say_what_is_kept, time.time(), vehicle, record, start)
        if report is not None:
            given_here = {
                "--vehicle": vehicle,
                "--mode": mode and mode.value,
                "--params": params,
                "--units": units.value,
            }
            options = [str(word) for pair in given_here.items() if pair[1] for word in pair]
            record = beside.enter_context(reported(report, record, start, options))
        if not no_view and sys.stdout.isatty():
            beside.enter_context(live_view(units.units))
        code = run_nodes(
            parameters,
            record=record,
            split=split,
            beside=beside,
            ros_args=ros_args,
        )
    raise typer.Exit(code)
