"""Faults of files: what a restart finds, and a disk that takes nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import json
from pathlib import Path
import resource
import shutil
import signal
import time

from benchmarks.faults.bus import PROFILE, bus_arguments
from benchmarks.faults.chain import Process, running, start_all, start_node
from benchmarks.faults.drive import OTHER_VEHICLE, RATE, learned_state, readings
from benchmarks.faults.fault import RECOVERY, Fault, FaultEffect
from benchmarks.faults.rig import OUTPUTS, Rig
from evpinn_ros import topics
from evpinn_ros.bags.can_frames import FRAMES_TOPIC, encode_frame
from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import FRAME_TYPE
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.can.encoder import Encoder
from evpinn_ros.can.profile import load_profile
from evpinn_ros.core.estimation.state_file import Half, read_state
from evpinn_ros.core.signals.readings import NANOSECONDS


def file_faults() -> Iterator[Fault]:
    """The faults of this module."""
    aside = "what was learned; the file is set aside, not overwritten"
    yield Fault("state_corrupt", "noise in the state file", aside, _BadState(_noise, "not a"))
    yield Fault("state_truncated", "half a state file", aside, _BadState(_half, "not a saved"))
    yield Fault("state_empty", "a state file of no bytes", aside, _BadState(_empty, "not a saved"))
    yield Fault(
        "state_of_another_car", "state of another vehicle", aside, _BadState(_other, "saved for")
    )
    yield Fault(
        "state_not_finite", "NaN where a number was", aside, _BadState(_not_finite, "not a saved")
    )
    yield Fault("state_folder", "the state's folder cannot be written", "saving", _no_folder)
    yield Fault("state_disk_full", "no room for the state", "saving meanwhile", _state_disk_full)
    yield Fault("bag_disk_full", "no room for the recording", "recording from there", _bag_full)
    yield Fault("bag_corrupt", "bytes flipped in a bag", "the chunk concerned", _bag_corrupt)


class _BadState:
    """An estimator that finds a file it cannot use."""

    def __init__(self, spoil: Callable[[Path], None], word: str) -> None:
        self._spoil, self._word = spoil, word

    def __call__(self, rig: Rig) -> FaultEffect:
        path = rig.folder / "bad.json"
        shutil.copy(learned_state(rig.folder), path)
        self._spoil(path)
        found = path.read_bytes()
        begin = time.monotonic()
        estimator = start_node(rig, "estimator", state_file=str(path))
        with running(estimator):
            ready = begin + estimator.await_ready()
            first = begin + rig.drive_until_recovered(begin, OUTPUTS, RECOVERY)
            rig.drive_until_named("estimator", self._word, begin, 1.5)
            took = max(first - ready, 0.0)
            named = rig.status("estimator", self._word, begin)
            code = estimator.stop().code
        refused = path.with_name(path.name + ".refused")
        kept = code == 0 and refused.is_file() and refused.read_bytes() == found
        kept = kept and read_state(path) is not None
        refused.unlink(missing_ok=True)
        lost = "what was learned; set aside" if kept else "the file"
        return FaultEffect(lost, kept, took, named)


def _noise(path: Path) -> None:
    path.write_bytes(bytes(byte ^ 0x5A for byte in path.read_bytes()))


def _half(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _empty(path: Path) -> None:
    path.write_bytes(b"")


def _other(path: Path) -> None:
    halves = json.loads(path.read_text())
    assert halves[Half.LEARNED]["vehicle"] != OTHER_VEHICLE
    halves[Half.LEARNED]["vehicle"] = OTHER_VEHICLE
    path.write_text(json.dumps(halves))


def _not_finite(path: Path) -> None:
    path.write_text(path.read_text().replace("0.", "NaN, 0.", 1))


def _no_folder(rig: Rig) -> FaultEffect:
    """Root may write anywhere, so the folder is one that no system lets be made."""
    estimator = start_node(rig, "estimator", state_file="/proc/evpinn/car.json")
    with running(estimator):
        estimator.await_ready()
        begin = time.monotonic()
        answer = rig.call("estimator/save")
        rig.drive(1.5)
        named = rig.status("estimator", "not written", begin)
        took = rig.recovered(begin, OUTPUTS)
        code = estimator.stop().code
    refused = answer is not None and not answer.success
    kept = refused and code == 0 and rig.faulty(begin) is None
    return FaultEffect("saving", kept, took, named)


def _state_disk_full(rig: Rig) -> FaultEffect:
    path = rig.folder / "full.json"
    shutil.copy(learned_state(rig.folder), path)
    before = path.read_bytes()
    estimator = start_node(rig, "estimator", state_file=str(path))
    with running(estimator):
        estimator.await_ready()
        begin = time.monotonic()
        limit_files(estimator, 1000)
        answer = rig.call("estimator/save")
        rig.drive(1.5)
        whole = path.read_bytes() == before
        named = rig.status("estimator", "not written", begin)
        limit_files(estimator, None)
        end = time.monotonic()
        again = rig.call("estimator/save")
        took = time.monotonic() - end
    kept = whole and answer is not None and not answer.success
    kept = kept and again is not None and again.success and rig.faulty(begin) is None
    lost = "saving meanwhile; the old file stayed whole" if kept else "the old file"
    return FaultEffect(lost, kept, took, named)


def limit_files(process: Process, size: int | None) -> None:
    """Let a process write files of this size at most, in bytes: as a disk fails that is full."""
    soft = resource.RLIM_INFINITY if size is None else size
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (soft, resource.RLIM_INFINITY))


def _bag_full(rig: Rig) -> FaultEffect:
    folder = rig.folder / "full_bag"
    run = start_all(rig, *bus_arguments(), "--record", str(folder))
    with running(run):
        run.await_ready("recorder")
        rig.drive(3.0)
        begin = time.monotonic()
        limit_files(run, file_of(folder).stat().st_size + 1000)
        rig.drive_until_named("recorder", "recording ended", begin, 2 * RECOVERY)
        took = rig.drive_until_recovered(time.monotonic(), most=RECOVERY)
        named = rig.status("recorder", "recording ended", begin)
        limit_files(run, None)
        code = run.stop(signal.SIGINT).code
    with BagReader(file_of(folder)) as bag:
        messages = sum(1 for _ in bag.records())
    # What could not be kept is an exit code of 1.
    kept = code == 1 and messages > 2 * RATE and rig.faulty(begin) is None
    lost = f"recording from there; {messages} messages stayed readable"
    return FaultEffect(lost, kept, took, named)


def file_of(folder: Path) -> Path:
    """The one MCAP file of a bag."""
    return next(folder.glob("*.mcap"))


def _bag_corrupt(rig: Rig) -> FaultEffect:
    """A recording of raw frames with a damaged second, played by the bridge."""
    folder, seconds = rig.folder / "corrupt_bag", 8
    encoder = Encoder(load_profile(PROFILE))
    with BagWriter(folder) as bag:
        for step in range(20 * seconds):
            stamp_ns = NANOSECONDS + step * NANOSECONDS // 20
            speed, battery = readings(stamp_ns)
            for frame in (encoder.speed(speed), encoder.battery(battery)):
                bag.write_raw(f"/ev/{FRAMES_TOPIC}", FRAME_TYPE, encode_frame(frame), stamp_ns)
    data = bytearray(file_of(folder).read_bytes())
    middle, some = len(data) // 2, len(data) // (2 * seconds)
    data[middle : middle + some] = bytes(byte ^ 0xFF for byte in data[middle : middle + some])
    file_of(folder).write_bytes(data)
    received: list[object] = []
    rig.subscribe(topics.SPEED, received.append)
    begin = time.monotonic()
    bridge = start_node(
        rig, "can_bridge", can_profile=PROFILE, log_file=str(folder), log_rate=10.0
    )
    with running(bridge):
        rig.wait(lambda: rig.status("can_bridge", "damaged", begin) is not None, "the bag's end")
        named = rig.status("can_bridge", "damaged", begin)
    lost = 20 * seconds - len(received)
    kept = lost <= 20 * 2 and rig.faulty(begin) is None
    return FaultEffect(f"{lost} of {20 * seconds} readings", kept, 0.0, named)
