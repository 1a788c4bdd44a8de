"""Speed of decoding a log of a full bus."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
import tempfile
import time

from benchmarks.can_traffic import PROFILE, traffic
from evpinn_ros.can.decoder import Decoder
from evpinn_ros.can.frame import CanFrame
from evpinn_ros.can.logs import LogFile, write_log
from evpinn_ros.can.profile import load_profile

SPEED_SECONDS = 50.0  # of a full bus, 200 000 frames


@dataclass(frozen=True, slots=True)
class Throughput:
    """Frames a second of the processor's time."""

    frames: int  # decoded, of a full bus
    decoding: float  # frames in memory to readings
    decoding_known: float  # frames with an id of the profile alone
    whole_file: float  # a candump file to readings


def measure_throughput(clock: Callable[[], float] = time.process_time) -> Throughput:
    """Decode a candump log of a full bus, in memory and from the file."""
    profile = load_profile(PROFILE)
    frames = [frame for batch in traffic(SPEED_SECONDS) for frame in batch]
    ids = {rule.message.frame_id for rule in profile.messages.values()}
    known = [frame for frame in frames if frame.can_id in ids]

    def rate(count: int, source: Iterable[CanFrame]) -> float:
        decoder, begin = Decoder(profile), clock()
        for frame in source:
            for _ in decoder.decode(frame):
                pass
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
