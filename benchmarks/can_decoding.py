"""Speed and truth of decoding logs: against tables of captures made by other means."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import csv
from dataclasses import dataclass
from pathlib import Path
import tempfile
import threading
import time

import numpy as np

from benchmarks.can_traffic import (
    GROUP,
    INTERFACE,
    PROFILE,
    OwnProcess,
    bus_options,
    own_port,
    send_log,
    traffic,
)
from evpinn_ros.can.bus import BusReader
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.logs import LogFile, write_log
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, Reading, SpeedReading

SPEED_SECONDS = 50.0  # of a full bus, 200 000 frames
LAST_FRAME = 5.0  # s after which a frame that was sent is lost
MOVING = 5.0  # m/s; below it the ratio of two speeds says little
TABLE_VOLTS, TABLE_AMPERES = 0.01, 0.1  # a digit of the tables

Formula = Callable[[bytes], tuple[float, float]]
"""Voltage and current (negative discharges) of a payload, written out by hand."""


def _tesla_with_offset(data: bytes) -> tuple[float, float]:
    raw = int.from_bytes(data[2:4], "little") & 0x7FFF
    return int.from_bytes(data[:2], "little") / 100, raw / 10 - 1000


def _leaf(data: bytes) -> tuple[float, float]:
    amperes = (data[0] << 3 | data[1] >> 5) / 2
    return (data[2] << 2 | data[3] >> 6) / 2, amperes - 1024 * (data[0] >> 7)


@dataclass(frozen=True, slots=True)
class Capture:
    """A recorded bus, the table of what is in it, and the frame that holds the battery."""

    profile: str  # of the car
    log: str  # below the folder of the captures
    table: str  # likewise; its columns are linear interpolations between the frames
    battery_id: int  # of the frame with voltage and current
    formula: Formula  # of that frame
    motor_speed: bool = False  # the table's speed is the motor's, so that of the wheels may differ


CAPTURES = (
    Capture(
        "tesla_model_s",
        "tesla_model_s_2017/models_2017-02-19.candump.log",
        "tesla_model_s_2017/decoded_2017-02-19.csv",
        0x102,
        _tesla_with_offset,
    ),
    Capture(
        "tesla_model_3_2019",
        "tesla_model3_2019/drive_first_300s.candump.log",
        "tesla_model3_2019/decoded_first_300s.csv",
        0x132,
        _tesla_with_offset,
    ),
    *(
        Capture(
            "nissan_leaf",
            f"nissan_leaf_62kwh/{name}.candump.log",
            f"nissan_leaf_62kwh/decoded_{name}.csv",
            0x1DB,
            _leaf,
            motor_speed=True,
        )
        for name in ("EV-CANeplus2", "EV-CANeplus3", "EV-CANepluseco")
    ),
)


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of a decoded capture with its table."""

    log: str  # of the capture
    frames: int  # in the log
    battery_frames: int  # with voltage and current
    battery_equal: int  # of those, the ones that give both exactly, by the formula
    rows: int  # of the table that lie between two battery frames
    rows_equal: int  # of those, the ones whose voltage and current are ours to the last digit
    # median ratio to the motor's speed, None where the table has another
    wheel_speed: float | None
    wheel_speed_within_2_percent: float | None  # share of the moments in motion


@dataclass(frozen=True, slots=True)
class Throughput:
    """Frames a second of the processor's time."""

    frames: int  # decoded, of a full bus
    decoding: float  # frames in memory to readings
    decoding_known: float  # likewise, of the frames with an id of the profile alone
    whole_file: float  # a candump file to readings


def measure_throughput(clock: Callable[[], float] = time.process_time) -> Throughput:
    """Decode a candump log of a full bus, in memory and from the file."""
    profile = load_profile(PROFILE)
    frames = [frame for batch in traffic(SPEED_SECONDS) for frame in batch]
    ids = {rule.message.frame_id for rule in profile.messages.values()}
    known = [frame for frame in frames if frame.can_id in ids]

    def rate(count: int, source: Iterable[CanFrame]) -> float:
        begin = clock()
        _decode(Decoder(profile), source)
        return count / (clock() - begin)

    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "bus.log"
        write_log(log, frames)
        return Throughput(
            frames=len(frames),
            decoding=rate(len(frames), frames),
            decoding_known=rate(len(known), known),
            whole_file=rate(len(frames), LogFile(log).frames()),
        )


def compare(capture: Capture, folder: Path) -> Agreement:
    """Decode a capture and compare with formula and table.

    Raises:
        InputError: log or table are not there.
    """
    frames = list(LogFile(folder / capture.log).frames())
    readings = _decode(Decoder(load_profile(capture.profile)), frames)
    battery = [each for each in readings if isinstance(each, BatteryReading)]
    by_hand = [
        capture.formula(frame.data)
        for frame in frames
        if frame.can_id == capture.battery_id and not frame.extended
    ]
    table = _read_table(folder / capture.table)
    same_rows = _same_rows(battery, frames[0].stamp_ns, table)
    wheels = _wheel_speed(readings, frames[0].stamp_ns, table) if capture.motor_speed else None
    return Agreement(
        log=capture.log,
        frames=len(frames),
        battery_frames=len(by_hand),
        battery_equal=_equal(battery, by_hand),
        rows=len(same_rows),
        rows_equal=int(same_rows.sum()),
        wheel_speed=wheels[0] if wheels else None,
        wheel_speed_within_2_percent=wheels[1] if wheels else None,
    )


def equal_live(capture: Capture, folder: Path) -> bool:
    """True if a log that another process sends over a live bus gives the readings of the log.

    Raises:
        InputError: the log is not there, or this machine has no multicast.
    """
    logged = list(LogFile(folder / capture.log).frames())
    stamped = [
        CanFrame(there.stamp_ns, frame.can_id, frame.data, frame.extended)
        for frame, there in zip(_over_the_bus(folder / capture.log), logged, strict=False)
    ]
    profile = load_profile(capture.profile)
    live, offline = (_decode(Decoder(profile), frames) for frames in (stamped, logged))
    # As text: NaN, which stands for an unknown charge, equals itself there.
    return list(map(repr, live)) == list(map(repr, offline))


def _decode(decoder: Decoder, frames: Iterable[CanFrame]) -> list[Reading]:
    return [reading for frame in frames for reading in decoder.decode(frame)]


def _equal(battery: list[BatteryReading], by_hand: list[tuple[float, float]]) -> int:
    """Count of frames that agree; a frame that gave no reading is none of them."""
    if len(battery) != len(by_hand):
        return 0
    # The same number by another order of operations: far below any digit of the signal.
    mine = np.array([(each.voltage, each.current) for each in battery])
    return int(np.sum(np.all(np.abs(mine - by_hand) < 1e-9, axis=1)))


def _same_rows(
    battery: list[BatteryReading], start_ns: int, table: dict[str, np.ndarray]
) -> np.ndarray:
    """True if our values round to those of the table, of each row between two of our readings.

    The log's stamps are whole microseconds, which allows a thousandth of a digit more.
    """
    at = np.array([(each.stamp_ns - start_ns) / NANOSECONDS for each in battery])
    between = (table["t_s"] >= at[0]) & (table["t_s"] <= at[-1])
    volts = np.interp(table["t_s"], at, [each.voltage for each in battery])
    amperes = np.interp(table["t_s"], at, [-each.current for each in battery])
    same = np.abs(volts - table["voltage_v"]) <= 0.501 * TABLE_VOLTS
    same &= np.abs(amperes - table["current_a"]) <= 0.501 * TABLE_AMPERES
    return np.asarray(same[between])


def _wheel_speed(
    readings: Iterable[Reading], start_ns: int, table: dict[str, np.ndarray]
) -> tuple[float, float]:
    speeds = [each for each in readings if isinstance(each, SpeedReading)]
    at = [(each.stamp_ns - start_ns) / NANOSECONDS for each in speeds]
    moving = table["speed_mps"] > MOVING
    wheels = np.interp(table["t_s"], at, [each.speed for each in speeds])
    ratio = wheels[moving] / table["speed_mps"][moving]
    return float(np.median(ratio)), float(np.mean(np.abs(ratio - 1) <= 0.02))


def _over_the_bus(path: Path) -> list[CanFrame]:
    """The frames of a log as they come over a bus from another process."""
    received: list[CanFrame] = []
    reader = BusReader(INTERFACE, GROUP, received.append, time.time_ns, **bus_options(own_port()))
    reader.open()
    thread = threading.Thread(target=reader.run)
    thread.start()
    try:
        with OwnProcess(send_log, own_port(), path) as sender:
            sent = sender.result()
            deadline = time.monotonic() + LAST_FRAME
            while len(received) < sent and time.monotonic() < deadline:
                time.sleep(0.01)
    finally:
        reader.stop()
        thread.join()
    return received


def _read_table(path: Path) -> dict[str, np.ndarray]:
    try:
        with path.open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error
    names = ("t_s", "speed_mps", "voltage_v", "current_a")
    return {name: np.array([float(row[name]) for row in rows]) for name in names}
