"""`evpinn can`: inspection of a CAN bus."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict
import math
from pathlib import Path
import threading
import time
from typing import Annotated, Any

import typer

from evpinn_ros.can.bus import BusReader
from evpinn_ros.can.fit import MessageFit
from evpinn_ros.can.inspection import BusReport, IdStatus, Inspection, ProfileReport
from evpinn_ros.can.profile import bundled_profiles, load_profile
from evpinn_ros.cli.console import note, progress_bar, say, show, write_json
from evpinn_ros.cli.lazy import ReadableCommand, ReadableGroup
from evpinn_ros.cli.options import Elm327Option, JsonOption, complete_profile, elm327_bus
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.plain_table import PlainTable
from evpinn_ros.core.signals.progress import reported
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.logs.bus_sources import open_can_log
from evpinn_ros.topics.node_parameters import bus_options

BITRATE = 500_000  # bit/s, of every car in config/can
LISTEN = 10.0  # s on a live bus, without --seconds
LONGEST = 1e6  # s
PERIOD = 0.2  # s between updates of the progress bar
LONGEST_STOP = 5.0  # s to wait until the driver has closed

can = typer.Typer(cls=ReadableGroup, no_args_is_help=True)


@can.callback()
def group() -> None:
    """Inspect a CAN bus.

    Example: evpinn can inspect drive.log
    """


@can.command(cls=ReadableCommand)
def inspect(
    source: Annotated[
        Path | None, typer.Argument(help="CAN log, or bag of raw frames; none for a live bus.")
    ] = None,
    interface: Annotated[
        str | None,
        typer.Option(
            "--interface",
            "--can-interface",
            help="python-can interface of a live bus; socketcan if not given.",
        ),
    ] = None,
    channel: Annotated[
        str | None,
        typer.Option(
            "--channel", "--can-channel", help="Channel of a live bus: can0, /dev/ttyACM0..."
        ),
    ] = None,
    elm327: Elm327Option = None,
    bitrate: Annotated[
        int | None,
        typer.Option(min=1, help=f"Bit rate of the bus, bit/s; {BITRATE} if not given."),
    ] = None,
    bus_option: Annotated[
        str, typer.Option("--bus-options", help="Options of the interface: 'name=value ...'.")
    ] = "",
    seconds: Annotated[
        float | None,
        typer.Option(
            help=f"Stop after N seconds; if not given, {LISTEN:g} on a live bus, else at the end."
        ),
    ] = None,
    can_profile: Annotated[
        str | None, typer.Option(help="Rank this profile too.", autocompletion=complete_profile)
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """List the ids on a CAN bus and the profiles that fit them; sends nothing.

    Example: evpinn can inspect drive.log

    Example: evpinn can inspect --channel can0 --seconds 20
    """
    profiles = {profile.key: profile for profile in bundled_profiles()}
    if can_profile is not None:
        extra_profile = load_profile(can_profile)
        profiles[extra_profile.key] = extra_profile
    inspection = Inspection(profiles.values(), bitrate or BITRATE)
    if elm327 is not None:
        interface, channel = elm327_bus(elm327, interface, channel)
    if (source is None) == (channel is None):
        raise typer.BadParameter("give one of SOURCE, --channel and --elm327")
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
    bus = inspection.report(end_ns)
    show_report(name, bus, bitrate or BITRATE)
    if json_file is not None:
        write_json(json_file, {"source": name, "bitrate": bitrate or BITRATE, **as_json(bus)})
    if problem is not None:
        raise InputError(problem)


def _read(inspection: Inspection, path: Path, seconds: float | None) -> str | None:
    log = open_can_log(path)
    last_ns: float | None = None
    with progress_bar(path.name, seconds or log.seconds) as progress:
        for frame in reported(log.frames(), progress):
            if last_ns is None:
                last_ns = frame.stamp_ns + (seconds or math.inf) * NANOSECONDS
            if frame.stamp_ns > last_ns:
                break
            inspection.add_frame(frame)
    for line in log.notes:
        note(line)
    for kind, count in sorted(log.skipped.items()):
        note(f"{path}: {count} frames skipped: {kind}")
    return log.problem


def _listen(reader: BusReader, seconds: float) -> tuple[int, str | None]:
    """Inspect a live bus; returns (stamp of the end, problem); InputError if no frame came."""
    reader.open()
    note(f"listening for {seconds:g} s; Ctrl-C ends sooner")
    thread = threading.Thread(target=reader.run, daemon=True)
    thread.start()
    begun = time.monotonic()
    with suppress(KeyboardInterrupt), progress_bar("listening", seconds, "s") as progress:
        while (elapsed := time.monotonic() - begun) < seconds:
            progress(elapsed)
            time.sleep(min(PERIOD, seconds - elapsed))
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


PEOPLE: dict[str, tuple[str, float, int]] = {
    "speed": ("km/h", 3.6, 1),
    "voltage": ("V", 1.0, 1),
    "current": ("A", 1.0, 1),
    "state_of_charge": ("%", 100.0, 1),
    "motor_torque": ("N m", 1.0, 0),
    "motor_speed": ("rpm", 60 / (2 * math.pi), 0),
}
"""Shown unit, factor from SI to it, and decimals, by quantity."""


def show_report(name: str, report: BusReport, bitrate: int) -> None:
    """Print ids with rates, the profiles that fit, and what the best one decodes."""
    best = report.best
    show(_id_table(report.ids, best))
    show(_profile_table(report.profiles))
    if best is not None:
        show(_value_table(best))
    for line in (*_summary(name, report, bitrate), *_verdict(best)):
        say(line)


def as_json(report: BusReport) -> dict[str, Any]:
    """The report in SI units, ready for `json_text`; NaN where unknown."""
    best = report.best
    low, high = report.load
    return {
        "duration_s": report.duration,
        "frames": report.frames,
        "frames_of_uncounted_ids": report.uncounted,
        "bus_load": {"least": low, "most": high},
        "ids": [_id_json(traffic) for traffic in report.ids],
        "best": best.fit.profile if best is not None else None,
        "profiles": [_profile_json(profile) for profile in report.profiles],
    }


def verdict(profile: ProfileReport) -> str:
    """One of `fits`, `contradicted`, `does not fit`, `not seen`, `must ask`."""
    if profile.contradicted is not None:
        return "contradicted"
    if not profile.fit.frames:
        return "must ask" if profile.asks else "not seen"
    return "fits" if profile.fit.holds else "does not fit"


def _id_table(ids: tuple[IdStatus, ...], best: ProfileReport | None) -> PlainTable:
    numbers = ("frames", "Hz", "period ms", "jitter ms", "age s", "bytes")
    table = PlainTable("Ids", ("id", *numbers, "read as"), words=("read as",))
    read = {} if best is None else best.quantities
    for traffic in ids:
        table.add_row(
            f"{traffic.can_id:08X}" if traffic.extended else f"{traffic.can_id:03X}",
            str(traffic.count),
            _text(traffic.rate, 1),
            _text(1e3 * traffic.period, 1),
            _text(1e3 * traffic.jitter, 1),
            _text(traffic.age, 1),
            ", ".join(map(str, sorted(traffic.lengths))),
            ", ".join(map(_words, read.get(traffic.can_id, ()))),
        )
    return table


def _words(quantity: str) -> str:
    return quantity.replace("_", " ") + (" torque" if quantity.endswith("motor") else "")


def _profile_table(profiles: tuple[ProfileReport, ...]) -> PlainTable:
    columns = ("profile", "score", "verdict", "why")
    table = PlainTable("Profiles, best first", columns, words=("verdict", "why"))
    for profile in profiles:
        why = "; ".join(map(str, profile.fit.messages)) if profile.fit.frames else ""
        score = f"{100 * profile.fit.score:.0f} %"
        table.add_row(profile.fit.profile, score, verdict(profile), why)
    return table


def _value_table(best: ProfileReport) -> PlainTable:
    columns = ("signal", "readings", "newest", "lowest", "highest", "")
    table = PlainTable(f"Values as {best.fit.profile} reads them", columns, words=("",))
    for name, signal in best.values.items():
        unit, factor, decimals = PEOPLE[name]
        numbers = (signal.newest, signal.lowest, signal.highest)
        texts = [_text(factor * number, decimals) for number in numbers]
        table.add_row(name.replace("_", " "), str(signal.count), *texts, unit)
    return table


def _summary(name: str, report: BusReport, bitrate: int) -> list[str]:
    low, high = (_text(100 * share, 1) for share in report.load)
    lines = [
        f"{name}: {report.frames} frames of {len(report.ids)} ids in {report.duration:.1f} s",
        f"Bus load: {low} to {high} % of {bitrate / 1000:g} kbit/s, depending on bit stuffing",
    ]
    if report.uncounted:
        lines.append(f"{report.uncounted} frames of further ids were not analysed")
    return lines


def _verdict(best: ProfileReport | None) -> list[str]:
    if best is None:
        return [
            "No profile fits this traffic. Listening cannot identify a car that only answers "
            "requests; see docs/explanation/can.md, asking the car"
        ]
    lines = [f"Fits: {best.fit.profile}"]
    dropped = ", ".join(f"{count} {reason}" for reason, count in sorted(best.dropped.items()))
    if dropped:
        lines.append(f"Dropped: {dropped}")
    if "current" not in best.values:
        return lines
    sign = best.sign or (
        "agrees with acceleration and charging"
        if best.sign_decided
        else "too little driving to judge"
    )
    return [*lines, f"Sign of the current: {sign}"]


def _id_json(traffic: IdStatus) -> dict[str, Any]:
    return {
        "id": f"0x{traffic.can_id:X}",
        "extended": traffic.extended,
        "frames": traffic.count,
        "rate_hz": traffic.rate,
        "period_s": traffic.period,
        "jitter_s": traffic.jitter,
        "age_s": traffic.age,
        "lengths": {str(length): count for length, count in sorted(traffic.lengths.items())},
    }


def _profile_json(profile: ProfileReport) -> dict[str, Any]:
    return {
        "profile": profile.fit.profile,
        "name": profile.fit.name,
        "score": profile.fit.score,
        "proven": profile.fit.proven,
        "verdict": verdict(profile),
        "contradicted": profile.contradicted,
        "messages": [_message_json(message) for message in profile.fit.messages],
        "values": {name: asdict(signal) for name, signal in profile.values.items()},
        "dropped": dict(profile.dropped),
        "current_sign": {"told": profile.sign_decided, "suspicion": profile.sign},
    }


def _message_json(message: MessageFit) -> dict[str, Any]:
    return {
        "quantity": message.quantity,
        "id": f"0x{message.can_id:X}",
        "frames": message.frames,
        "good": message.good,
        "bad": dict(message.bad),
        "has_checksum": message.has_checksum,
    }


def _text(number: float, decimals: int) -> str:
    return f"{number:.{decimals}f}" if math.isfinite(number) else "-"
