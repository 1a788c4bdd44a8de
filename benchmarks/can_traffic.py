"""A full CAN bus for `evpinn bench can`: what is on it, and the process that sends it.

A classic frame of 8 bytes takes about 125 bits, so 500 kbit/s carry 4000 frames a second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import cycle, islice
import multiprocessing
from multiprocessing.connection import Connection
import os
import random
import threading
import time
from typing import Any, NamedTuple

import can

from evpinn_ros.can.bus import BusReader
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.signals.readings import NANOSECONDS, BatteryReading, SpeedReading

PROFILE = "tesla_model_3"
TICKS = 1000  # a second; the frames of one go out together
FRAMES_PER_TICK = 4
BATTERY_EVERY, SPEED_EVERY, CHARGE_EVERY = 10, 20, 100  # ticks, as a Model 3 sends them
OTHER_IDS = 90

IDLE_SECONDS = 20.0  # enough for the share of a reader without a load

LOWEST_VOLTAGE, VOLTAGES = 200.0, 30_000  # the voltage tells the number of its frame, in 0.01 V
INTERFACE, GROUP, FIRST_PORT = "udp_multicast", "239.74.163.5", 20_000
"""The one kind of bus of python-can that crosses processes on any machine."""


def own_port() -> int:
    """A port that no other process of ours sends to."""
    return FIRST_PORT + os.getpid() % FIRST_PORT


def bus_options(port: int) -> dict[str, int]:
    """The options of python-can for a bus that stays on this machine."""
    return {"port": port, "hop_limit": 0}


def voltage(number: int) -> float:
    """The voltage in the battery frame of a number."""
    return LOWEST_VOLTAGE + (number % VOLTAGES) / 100


def number_after(before: int, voltage: float) -> int:
    """The number of a frame from its voltage and the number of one not long before."""
    step = round((voltage - LOWEST_VOLTAGE) * 100) - before
    return before + step % VOLTAGES


def traffic(seconds: float) -> Iterator[list[CanFrame]]:
    """The frames of each tick; their stamps count from zero.

    Battery, speed and charge of a Model 3 among `OTHER_IDS` ids of no interest.
    """
    encoder = Encoder(load_profile(PROFILE))
    others = cycle(_other_frames())
    for tick in range(round(seconds * TICKS)):
        stamp_ns = tick * NANOSECONDS // TICKS
        frames = []
        if tick % BATTERY_EVERY == 0:
            volts = voltage(tick // BATTERY_EVERY)
            frames.append(encoder.battery(BatteryReading(stamp_ns, volts, -20.0)))
        if tick % SPEED_EVERY == 5:
            frames.append(encoder.speed(SpeedReading(stamp_ns, tick % 25_000 / 1000)))
        if tick % CHARGE_EVERY == 7:
            charge = BatteryReading(stamp_ns, LOWEST_VOLTAGE, 0.0, 0.5)
            frames.append(encoder.state_of_charge(charge))
        rest = islice(others, FRAMES_PER_TICK - len(frames))
        yield frames + [CanFrame(stamp_ns, each.can_id, each.data) for each in rest]


def _other_frames() -> Sequence[CanFrame]:
    chance = random.Random(0)
    known = {rule.message.frame_id for rule in load_profile(PROFILE).messages.values()}
    ids = chance.sample([each for each in range(0x80, 0x700) if each not in known], OTHER_IDS)
    return [CanFrame(0, each, chance.randbytes(8)) for each in ids]


def send_traffic(port: int, seconds: float) -> list[int]:
    """Send a full bus in real time.

    Returns:
        when each battery frame was handed to the bus, ns of the system's clock.
    """
    battery = load_profile(PROFILE).messages["battery"].message.frame_id
    times = []
    with open_bus(port) as bus:
        for frame in paced(traffic(seconds)):
            if frame.can_id == battery:
                times.append(time.time_ns())
            _send(bus, frame)
    return times


def paced(batches: Iterable[Iterable[CanFrame]]) -> Iterator[CanFrame]:
    """The frames, a batch each tick of real time; late ones follow at once."""
    begin = time.monotonic()
    for tick, batch in enumerate(batches):
        wait = begin + tick / TICKS - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        yield from batch


class Idle(NamedTuple):
    """A reader that does nothing with its frames: how many, and its share of one core."""

    frames: int
    core_share: float


def read_idle(port: int, seconds: float) -> Idle:
    """Read the bus as the bridge does, from the first frame on, and drop every frame."""
    begun = threading.Event()
    reader = BusReader(INTERFACE, GROUP, lambda _: begun.set(), time.time_ns, **bus_options(port))
    reader.open()
    thread = threading.Thread(target=reader.run)
    thread.start()
    begun.wait()
    cpu, wall = time.process_time(), time.monotonic()
    time.sleep(seconds)
    share = (time.process_time() - cpu) / (time.monotonic() - wall)
    reader.stop()
    thread.join()
    return Idle(reader.status().counters["frames"], share)


def measure_idle(seconds: float) -> Idle:
    """`read_idle` under a full bus, each in a process of its own; `IDLE_SECONDS` at most."""
    seconds = min(seconds, IDLE_SECONDS)
    port = own_port() + 1
    with (
        OwnProcess(read_idle, port, seconds) as reader,
        OwnProcess(send_traffic, port, 2 * seconds + 10),
    ):
        idle: Idle = reader.result()
    return idle


class OwnProcess:
    """A function in a process of its own; a context manager, which ends the process."""

    def __init__(self, task: Callable[..., Any], *arguments: object) -> None:
        context = multiprocessing.get_context("spawn")
        self._answer, theirs = context.Pipe(duplex=False)
        self._process = context.Process(target=_answer, args=(theirs, task, arguments))
        self._process.start()
        theirs.close()

    def __enter__(self) -> OwnProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.join()

    def done(self) -> bool:
        """True if `result` need not wait."""
        return self._answer.poll()

    def result(self) -> Any:
        """Result of the function.

        Raises:
            InputError: it failed; the process gave the reason.
        """
        try:
            return self._answer.recv()
        except EOFError as error:
            raise InputError("a process of the benchmark failed") from error


def _answer(theirs: Connection, task: Callable[..., Any], arguments: Sequence[object]) -> None:
    theirs.send(task(*arguments))


def open_bus(port: int) -> Any:
    """The bus, a `can.Bus`, for sending.

    Raises:
        InputError: this machine has no multicast.
    """
    try:
        return can.Bus(GROUP, interface=INTERFACE, **bus_options(port))
    except (can.CanError, OSError) as error:
        raise InputError(f"no multicast on this machine: {error}") from error


def _send(bus: Any, frame: CanFrame) -> None:
    bus.send(
        can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=frame.extended)
    )
