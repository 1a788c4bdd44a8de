"""Replay of recorded drives through the chain, as fast as it can or at a given rate."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
import math
from pathlib import Path
import time
from typing import Any, NamedTuple

import numpy as np

from evpinn_ros.bags.types import new_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.estimate import ParameterSet
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading, Reading
from evpinn_ros.core.signals.time_jump import Jump
from evpinn_ros.logs.source import STRAGGLING_NS, Source
from evpinn_ros.replays.chain import Chain, ChainOutput
from evpinn_ros.replays.history import Drive, History
from evpinn_ros.replays.scoring import metrics
from evpinn_ros.topics import NAMESPACE, Topic
from evpinn_ros.topics.estimates import breakdown_messages, output_messages
from evpinn_ros.topics.readings import reading_messages

WARM_UP = 120.0  # s at the start that are not scored
BLOCK = 1000  # readings that the chain takes at once
PROGRESS_STEP = 1.0  # s of the drive between two reports of progress

Progress = Callable[[float], None]  # takes s of the drive done


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """Options of a replay.

    Attributes:
        withhold_battery_after: s since the start, None to withhold nothing.
        warm_up: s at the start that are not scored.
        rate: of real time, None for as fast as possible.
        start: s since the first reading, before which the drive is not read.
        duration: s from there, after which it is not read; None for all of it.
    """

    withhold_battery_after: float | None = None
    warm_up: float = WARM_UP
    rate: float | None = None
    start: float = 0.0
    duration: float | None = None

    def __post_init__(self) -> None:
        times = (self.withhold_battery_after, self.warm_up, self.rate, self.start, self.duration)
        if not all(seconds is None or 0.0 <= seconds < math.inf for seconds in times):
            raise InputError("times of a replay are s from 0 on, and its rate is above 0")

    def seconds_of(self, whole: float | None) -> float | None:
        """Length of what is replayed of a drive, s; None if neither is known."""
        if whole is None:
            return self.duration
        rest = max(0.0, whole - self.start)
        return rest if self.duration is None else min(rest, self.duration)


@dataclass(frozen=True, slots=True)
class Replayed:
    """Result of one drive: its series, its metrics, and what could not be read, if anything."""

    drive: Drive
    metrics: dict[str, Any]
    problem: str | None


def replay(
    source: Source,
    chain: Chain,
    options: ReplayOptions,
    *,
    vehicle: str,
    mode: str,
    writer: BagWriter | None = None,
    progress: Progress | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Replayed:
    """Run one drive through the chain, which keeps what it learned.

    `stopped` is asked at each reading whether the drive shall end there.

    Raises:
        InputError: the source holds no speed at all, or too few to predict from.
    """
    history = History()
    # What earlier drives left is no event of this one.
    history.add_detections(chain.estimator.detections())
    not_recorded: Counter[str] = Counter()
    started = time.perf_counter()
    whole = takewhile(lambda _: not stopped(), source.readings())
    readings = span(whole, options.start, options.duration)
    items = (item for reading in readings for item in chain.follow(reading))
    size, recorded = BLOCK if options.rate is None else 1, writer is not None
    for block in _noted(_blocks(items, size), history, options, progress):
        outputs_of_all = _outputs(block, history, chain, counted=recorded)
        for noted, outputs in zip(block, outputs_of_all, strict=True):
            if writer is not None and not isinstance(noted.item, Jump):
                moment_ns = history.moment(noted.item.stamp_ns)
                not_recorded.update(_record(writer, noted.item, outputs, moment_ns, chain))
        history.add_states(chain.account.count())
    last = chain.estimator.finish()
    history.add_output(last)
    history.add_detections(chain.estimator.detections())
    if writer is not None:
        for topic, message in _estimates([last], chain):
            writer.write(topic.under(NAMESPACE), message, history.moment(last.stamp_ns))
    wall = time.perf_counter() - started
    drive = replace(
        history.drive(chain.estimator.model()),
        zoned=source.zoned,
        reading_notes=tuple(dict.fromkeys((*source.assumptions, *source.notes))),
    )
    where = "" if options.start == 0 and options.duration is None else " in that span"
    if len(drive.speed) == 0:
        why = next((text for text in source.notes if text.startswith("speed is")), "")
        raise InputError(
            f"{source.path}: no speed{where}, so nothing can be predicted{why and f': {why}'}"
        )
    if not len(drive.newest.power) and not len(drive.smoothed.power):
        raise InputError(f"{source.path}: nothing can be predicted{where}: {_too_seldom(drive)}")
    status = chain.estimator.status()
    scores = metrics(
        path=str(source.path),
        vehicle=vehicle,
        mode=mode,
        drive=drive,
        status=status,
        dropped=Counter(status.dropped) + chain.dropped + source.dropped + not_recorded,
        warm_up=options.warm_up,
        withheld_from=options.withhold_battery_after,
        wall=wall,
        breakdown=chain.estimator.breakdown(),
    )
    return Replayed(drive, scores, source.problem)


def _too_seldom(drive: Drive) -> str:
    """Text on how far apart the speeds are of a drive from which nothing could be predicted."""
    steps = np.diff(drive.speed[:, 0])
    if not steps.size:
        return "there is one speed"
    return f"{len(drive.speed)} speeds, {np.median(steps):.3g} s apart in the median"


def span(readings: Iterator[Reading], start: float, duration: float | None) -> Iterator[Reading]:
    """The readings of a part of a drive, by their stamps: from `start` on, for `duration`, s.

    Reading ends where stamps are `STRAGGLING_NS` beyond the part.
    """
    if start == 0 and duration is None:
        yield from readings
        return
    first_ns: int | None = None
    end = math.inf if duration is None else start + duration
    for reading in readings:
        first_ns = reading.stamp_ns if first_ns is None else first_ns
        seconds = (reading.stamp_ns - first_ns) / NANOSECONDS
        if start <= seconds < end:
            yield reading
        elif seconds >= end + STRAGGLING_NS / NANOSECONDS:
            return


class _Noted(NamedTuple):
    """A reading or jump of time in the series, the newest moment then, and if the chain has it."""

    item: Reading | Jump
    moment_ns: int
    given: bool


def _blocks(items: Iterable[Reading | Jump], size: int) -> Iterator[list[Reading | Jump]]:
    """Blocks of at most this size; a jump of time begins one."""
    block: list[Reading | Jump] = []
    for item in items:
        if block and (len(block) == size or isinstance(item, Jump)):
            yield block
            block = []
        block.append(item)
    if block:
        yield block


def _noted(
    blocks: Iterable[list[Reading | Jump]],
    history: History,
    options: ReplayOptions,
    progress: Progress | None,
) -> Iterator[list[_Noted]]:
    """Blocks in the series, held back to the rate, with reports of progress."""
    started, reported = time.perf_counter(), 0.0
    for block in blocks:
        noted = [_note(item, history, options.withhold_battery_after) for item in block]
        now = history.now
        if options.rate is not None:
            time.sleep(max(0.0, started + now / options.rate - time.perf_counter()))
        if progress is not None and now - reported >= PROGRESS_STEP:
            progress(now)
            reported = now
        yield noted


def _note(item: Reading | Jump, history: History, withhold_after: float | None) -> _Noted:
    """Take an item into the series; a battery reading may be withheld from the chain."""
    if isinstance(item, Jump):
        return _Noted(item, history.add_jump(item), given=True)
    moment_ns = history.add_reading(item)
    given = (
        withhold_after is None
        or not isinstance(item, BatteryReading)
        or history.seconds(item.stamp_ns) <= withhold_after
    )
    return _Noted(item, moment_ns, given)


def _outputs(
    block: Sequence[_Noted], history: History, chain: Chain, *, counted: bool
) -> Iterator[list[ChainOutput]]:
    """Outputs of the chain for each reading that it is given, noted too."""
    items = [noted.item for noted in block if noted.given]
    outputs = chain.take(items, counted=counted)
    for item, moment_ns, given in block:
        history.move_to(moment_ns)
        if given and not isinstance(item, Jump) and history.wants_model:
            history.add_model(chain.estimator.model())
        outputs_of_block = next(outputs) if given else []
        for output in outputs_of_block:
            history.add_output(output)
            if isinstance(output, ParameterSet):
                history.add_detections(chain.estimator.detections())
        yield outputs_of_block


def _record(
    writer: BagWriter,
    reading: Reading,
    outputs: list[ChainOutput],
    log_time_ns: int,
    chain: Chain,
) -> Iterator[str]:
    """Write a reading and its outputs; gives a reason for each that no message holds."""
    try:
        messages = list(reading_messages(new_message, reading))
    except ValueError:
        yield "not_recordable"
        messages = []
    for topic, message in (*messages, *_estimates(outputs, chain)):
        writer.write(topic.under(NAMESPACE), message, log_time_ns)


def _estimates(outputs: Iterable[ChainOutput], chain: Chain) -> Iterator[tuple[Topic, Any]]:
    """The messages of outputs; those of parameters have the breakdown beside them, as live."""
    for output in outputs:
        yield from output_messages(new_message, output)
        if isinstance(output, ParameterSet):
            breakdown = chain.estimator.breakdown()
            yield from breakdown_messages(new_message, output.stamp_ns, breakdown)


def has_battery(drive: Drive) -> bool:
    """True if a drive has any battery reading."""
    return len(drive.measured) > 0


def output_folders(out: Path | None, paths: Sequence[Path], *, several: bool) -> list[Path | None]:
    """Folder of each drive's bag: `out` itself, or a folder in it for each of several inputs."""
    if out is None:
        return [None] * len(paths)
    if not several:
        return [out]
    return [out / f"{index:03d}_{_stem(path)}" for index, path in enumerate(paths, start=1)]


def _stem(path: Path) -> str:
    return path.name.split(".")[0] or path.resolve().name
