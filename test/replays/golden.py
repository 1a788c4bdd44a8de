"""The outputs of the bundled bags, as they were when somebody last looked at them.

`make golden` shows what has changed and writes it down; without `--renew` it is only shown, and
the exit code is 1. A record holds every number of every output topic, the latest at each half
minute of the drive.
"""

from collections import defaultdict
from collections.abc import Iterator
import csv
from pathlib import Path
import sys
import time
from typing import NamedTuple

import numpy as np

from evpinn_ros.bags.types import new_message
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.core.estimation.estimator import EstimatorSettings, Mode
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.logs.sources import open_source
from evpinn_ros.replays.chain import Chain
from evpinn_ros.topics.energies import output_messages

BAGS = Path(__file__).resolve().parents[2] / "bags"
RECORDS = Path(__file__).with_name("golden")
VEHICLE = "tesla_model_3_lr"
EVERY = 30  # s

Record = dict[tuple[str, int, str], float]  # by topic, place in the message, seconds


class Drive(NamedTuple):
    """What is recorded: a bag, a mode, how much of it, and how near numbers have to be.

    Nearness is relative to the largest number of a column. Another processor rounds the last
    digits otherwise, and the gradient descent of the paper amplifies that: without AVX2 and FMA
    3e-8 became 1e-4 in half a minute.
    """

    bag: str
    mode: Mode
    seconds: float
    near: float

    @property
    def path(self) -> Path:
        """File of the record."""
        return RECORDS / f"{self.bag}_{self.mode.value}.csv"


DRIVES = (
    Drive("urban", Mode.HYBRID, np.inf, 1e-6),
    Drive("highway", Mode.HYBRID, 150.0, 1e-6),
    Drive("urban", Mode.PAPER, 60.0, 1e-3),
)


def numbers(message) -> Iterator[float]:
    """Every number of a message but the stamp, in order."""
    for name in getattr(message, "__dataclass_fields__", ()):
        if name not in ("stamp", "header"):
            yield from numbers(getattr(message, name))
    if isinstance(message, (int, float, np.number)):
        yield float(message)
    elif isinstance(message, (list, np.ndarray)):
        for item in message:
            yield from numbers(item)


def outputs(drive: Drive) -> Record:
    """What the chain says of a drive now."""
    limit_blas_threads()
    vehicle = load_vehicle(VEHICLE)
    chain = Chain(vehicle, EstimatorSettings(mode=drive.mode), InlineWorker(time.perf_counter))
    latest, record = {}, {}
    start_ns, due, block = None, EVERY, []
    for reading in open_source(BAGS / drive.bag, vehicle).readings():
        start_ns = start_ns or reading.stamp_ns
        now = (reading.stamp_ns - start_ns) / NANOSECONDS
        if now > drive.seconds:
            break
        if now >= due:
            for output in chain.add_readings(block):
                messages = output_messages(new_message, output)
                latest |= {topic.name: message for topic, message in messages}
            for topic, message in latest.items():
                for place, number in enumerate(numbers(message)):
                    record[topic, place, str(due)] = number
            due += EVERY
            block.clear()
        block.append(reading)
    return record


def differences(old: Record, new: Record, near: float) -> Iterator[str]:
    """A line for each topic with numbers that are not what they were, and the largest change."""
    scales: dict[tuple[str, int], float] = defaultdict(float)
    for (topic, place, _), number in old.items():
        if np.isfinite(number):
            scales[topic, place] = max(scales[topic, place], abs(number))
    changes: dict[str, list[tuple[float, str]]] = defaultdict(list)
    for key in sorted({*old, *new}):
        before, now, scale = old.get(key, np.inf), new.get(key, np.inf), scales[key[:2]]
        is_near = np.isclose(now, before, rtol=0, atol=near * scale, equal_nan=True)
        if not is_near or (key in old) != (key in new):
            share = abs(now - before) / scale if scale else np.inf
            what = f"number {key[1]} at {key[2]} s, {before:.9g} -> {now:.9g}"
            changes[key[0]].append((np.inf if np.isnan(share) else share, what))
    for topic, lines in changes.items():
        share, what = max(lines)
        yield f"{topic}: {len(lines)} changed, by at most {share:.1e} of the largest: {what}"


def load(path: Path) -> Record:
    """A record from its file, empty when there is none."""
    if not path.exists():
        return {}
    with path.open(newline="") as file:
        return {(t, int(place), s): float(number) for t, place, s, number in csv.reader(file)}


def save(path: Path, record: Record) -> None:
    path.parent.mkdir(exist_ok=True)
    with path.open("w", newline="") as file:
        rows = ((*key, f"{number:.9g}") for key, number in sorted(record.items()))
        csv.writer(file, lineterminator="\n").writerows(rows)


def main(renew: bool) -> int:
    """Compare all; gives the exit code."""
    changed = 0
    for drive in DRIVES:
        record = outputs(drive)
        lines = list(differences(load(drive.path), record, drive.near))
        print(f"{drive.path.name}: {len(record)} numbers, {len(lines)} topics changed")
        print(*(f"  {line}\n" for line in lines), sep="", end="")
        changed += len(lines)
        if renew and lines:
            save(drive.path, record)
    return 0 if renew else min(changed, 1)


if __name__ == "__main__":
    raise SystemExit(main(renew="--renew" in sys.argv[1:]))
