"""Buses of simulated cars: what each profile that comes with the package would have on its bus."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
import threading
import time
from typing import Any

import pytest

from evpinn_ros.can.bridge import CanBridge
from evpinn_ros.can.bus import BusReader
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.profile import CanProfile, bundled_profiles, load_profile
from evpinn_ros.common.errors import InputError
from evpinn_ros.common.package_data import share_directory
from evpinn_ros.core.signals.readings import BatteryReading, Reading, SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind
from evpinn_ros.replays.simulation.simulate import simulate
from test.waiting import HANG_S

CONFIG = share_directory() / "config" / "can"
ALL = bundled_profiles()
PROFILES = {profile.key: profile for profile in ALL if profile.messages}
ASKING = {profile.key: profile for profile in ALL if profile.requests}
SECONDS = 60.0
# The published answer of a Kona to 22 01 01, as quoted in issue 44 of
# JejuSoul/OBD-PIDs-for-HKMC-EVs.
KONA = """
103E620101FFF7E7 21FFBC16AE430800 2200000FCF090808 2308080900000ACE 2430CE4A00007800
250015B2000012F4 2600000840000006 27D10005F7060900 28030000000003E8
"""


@cache
def readings() -> tuple[Reading, ...]:
    """A drive in town; 10 Hz."""
    car = load_vehicle("tesla_model_3_lr")
    return simulate(DriveKind.URBAN, car, SECONDS, 3).readings


def encoded(profile: CanProfile, readings: tuple[Reading, ...]) -> Iterator[CanFrame]:
    """The frames of readings, as far as the profile has them, limited to what it can show."""
    encoder = Encoder(profile)
    for index, reading in enumerate(readings):
        if isinstance(reading, SpeedReading) and "speed" in profile.messages:
            (speed,) = profile.messages["speed"].signals
            yield encoder.speed(SpeedReading(reading.stamp_ns, speed.clipped(reading.speed)))
        elif isinstance(reading, BatteryReading):
            if "battery" in profile.messages:
                volts, amperes = profile.messages["battery"].signals
                shown = volts.clipped(reading.voltage), amperes.clipped(reading.current)
                yield encoder.battery(BatteryReading(reading.stamp_ns, *shown))
            if "state_of_charge" in profile.messages and index % 20 == 0:
                yield encoder.state_of_charge(BatteryReading(reading.stamp_ns, 0.0, 0.0, 0.7))


@pytest.fixture(scope="session")
def bus() -> Callable[[str], list[CanFrame]]:
    """The frames of the same drive in the car of a profile."""
    return cache(lambda name: list(encoded(PROFILES[name], readings())))


def refusal(path: Path) -> str:
    """The error of loading a profile: one line, which begins with the file."""
    with pytest.raises(InputError) as error:
        load_profile(path)
    text = str(error.value)
    assert text.startswith(f"{path}:") and "\n" not in text
    return text


@pytest.fixture
def broken(tmp_path: Path) -> Callable[[str, str, str], str]:
    """Writes a profile with one change; gives the error of loading it, which is one line."""

    def load(old: str, new: str, name: str) -> str:
        text = (CONFIG / f"{name}.yaml").read_text()
        assert old in text
        (tmp_path / "mine.yaml").write_text(text.replace(old, new, 1))
        for dbc in CONFIG.glob(f"{name}.dbc"):
            (tmp_path / dbc.name).write_bytes(dbc.read_bytes())
        text = refusal(tmp_path / "mine.yaml")
        assert int(text.split(":")[1]) > 0
        return text

    return load


@contextmanager
def running(*workers: Any) -> Iterator[None]:
    """Runs readers and pollers in threads; `stop` must end them."""
    threads = [threading.Thread(target=worker.run) for worker in workers]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        for worker in workers:
            worker.stop()
        for thread in threads:
            thread.join(HANG_S)
    assert not any(thread.is_alive() for thread in threads)


class LiveBridge:
    """A bridge on a live bus: its readings, and the threads that read and ask."""

    def __init__(
        self,
        interface: str,
        channel: str,
        profile: CanProfile,
        *,
        poll: bool = True,
        clock: Callable[[], float] = time.monotonic,
        **options: Any,
    ) -> None:
        self.readings: list[Reading] = []
        self.reader = BusReader(interface, channel, self._on_frame, time.time_ns, **options)
        self.bridge = CanBridge(profile, self.reader.send if poll else None, clock=clock)
        self._running = running(*([self.bridge.poller] if poll else []), self.reader)

    def _on_frame(self, frame: CanFrame) -> None:
        self.readings += self.bridge.decode(frame)

    def of(self, kind: type) -> list[Any]:
        return [reading for reading in self.readings if isinstance(reading, kind)]

    @property
    def counters(self) -> Any:
        return self.bridge.poller.status().counters

    def __enter__(self) -> "LiveBridge":
        self._running.__enter__()
        return self

    def __exit__(self, *raised: Any) -> None:
        self._running.__exit__(*raised)
