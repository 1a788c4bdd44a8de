"""`evpinn can`: what is on a CAN bus."""

from __future__ import annotations

from contextlib import suppress
import math
from pathlib import Path
import threading
import time
from typing import Annotated, Any

import typer

from evpinn_ros.can.bus import BusReader
from evpinn_ros.can.inspection import BusReport, Inspection
from evpinn_ros.can.profile import bundled_profiles, load_profile
from evpinn_ros.cli.can_tables import as_json, show_report
from evpinn_ros.cli.console import note, progress_bar, show_json
from evpinn_ros.cli.lazy import ReadableCommand, ReadableGroup
from evpinn_ros.cli.options import Elm327Option, JsonTextOption, complete_profile, elm327_bus
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.progress import reported
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.logs.bus_sources import open_can_log
from evpinn_ros.topics.node_parameters import bus_options

BITRATE = 500_000  # bit/s, of every car in config/can
LISTEN = 10.0  # s, if not given otherwise
LONGEST = 1e6  # s
PERIOD = 0.2  # s between two looks at the clock while listening
LONGEST_STOP = 5.0  # s to wait for the driver

can = typer.Typer(cls=ReadableGroup, no_args_is_help=True)


@can.callback()
def group() -> None:
    """Inspect a CAN bus.

    Example: evpinn can inspect drive.log
    """


@can.command(cls=ReadableCommand)
def inspect(
    source: Annotated[
        Path | None,
        typer.Argument(help="CAN log or bag of raw frames; not for a live bus."),
    ] = None,
    interface: Annotated[
        str | None,
        typer.Option(
            "--interface",
            "--can-interface",
            help="Driver of a live bus's adapter; socketcan if not given.",
        ),
    ] = None,
    channel: Annotated[
        str | None,
        typer.Option(
            "--channel",
            "--can-channel",
            help="can0, /dev/ttyACM0... of a live bus.",
        ),
    ] = None,
    elm327: Elm327Option = None,
    bitrate: Annotated[
        int | None,
        typer.Option(min=1, help=f"Bit rate; {BITRATE} bit/s if not given."),
    ] = None,
    bus_option: Annotated[
        str,
        typer.Option("--bus-options", help="More for the driver, as 'name=value ...'."),
    ] = "",
    seconds: Annotated[
        float | None,
        typer.Option(
            help=f"Stop after N seconds; {LISTEN:g} for a live bus, all of a recorded one."
        ),
    ] = None,
    can_profile: Annotated[
        str | None,
        typer.Option(
            help="A profile of your own, to be ranked too.",
            autocompletion=complete_profile,
        ),
    ] = None,
    as_json_text: JsonTextOption = False,
) -> None:
    """Show what is on a CAN bus, and which profile fits, without sending.

    Example: evpinn can inspect drive.log

    Example: evpinn can inspect --channel can0 --seconds 20
    """
    profiles = {profile.key: profile for profile in bundled_profiles()}
    if can_profile is not None:
        own = load_profile(can_profile)
        profiles[own.key] = own
    inspection = Inspection(profiles.values(), bitrate or BITRATE)
    if elm327 is not None:
        interface, channel = elm327_bus(elm327, interface, channel)
    if (source is None) == (channel is None):
        raise typer.BadParameter("give either SOURCE, --channel or --elm327")
    if seconds is not None and not 0 < seconds <= LONGEST:
        raise typer.BadParameter(f"--seconds must be above 0 and at most {LONGEST:g}")
    if source is not None:
        name, end_ns, problem = str(source), None, _read(inspection, source, seconds)
    else:
        options: dict[str, Any] = bus_options(bus_option)
        if bitrate is not None:
            options["bitrate"] = bitrate
        interface = interface or "socketcan"
        reader = BusReader(interface, str(channel), inspection.add_frame, time.time_ns, **options)
        name, end_ns, problem = f"{interface} {channel}", *_listen(reader, seconds or LISTEN)
    _print(name, inspection.report(end_ns), bitrate or BITRATE, as_json_text)
    if problem is not None:
        raise InputError(problem)


def _read(inspection: Inspection, path: Path, seconds: float | None) -> str | None:
    """Take the frames of a recorded bus; gives what could not be read."""
    log = open_can_log(path)
    last_ns: float | None = None
    with progress_bar(path.name, seconds or log.seconds) as progress:
        for frame in reported(log.frames(), progress):
            if last_ns is None:
                last_ns = frame.stamp_ns + (seconds or math.inf) * NANOSECONDS
            if frame.stamp_ns > last_ns:
                break
            inspection.add_frame(frame)
    for kind, count in sorted(log.skipped.items()):
        note(f"{path}: {count} frames left out: {kind}")
    return log.problem


def _listen(reader: BusReader, seconds: float) -> tuple[int, str | None]:
    """Take the frames of a live bus; gives the end's time, and what is wrong with the bus.

    Raises:
        InputError: the bus cannot be opened, or no frame came.
    """
    reader.open()
    note(f"listening for {seconds:g} s; Ctrl-C ends sooner")
    thread = threading.Thread(target=reader.run, daemon=True)
    thread.start()
    begun = time.monotonic()
    with suppress(KeyboardInterrupt), progress_bar("listening", seconds, "s") as progress:
        while (done := time.monotonic() - begun) < seconds:
            progress(done)
            time.sleep(min(PERIOD, seconds - done))
    status, end_ns = reader.status(), time.time_ns()
    reader.stop()
    thread.join(LONGEST_STOP)
    if not status.counters.get("frames"):
        silent = (
            f"{status.condition.value}; many cars say nothing at the plug until asked "
            "(docs/explanation/can.md)"
        )
        raise InputError(f"no frame came: {status.problem or silent}")
    return end_ns, status.problem


def _print(name: str, report: BusReport, bitrate: int, as_json_text: bool) -> None:
    if as_json_text:
        document: dict[str, Any] = {"source": name, "bitrate": bitrate, **as_json(report)}
        show_json(document)
    else:
        show_report(name, report, bitrate)
