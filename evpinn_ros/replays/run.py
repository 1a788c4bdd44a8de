"""Replays a recorded drive through the chain, as fast as possible or at a given rate."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
import math
from operator import attrgetter
from pathlib import Path
import time
from typing import Any

import numpy as np

from evpinn_ros.bags.types import new_message
from evpinn_ros.bags.writer import BagWriter
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.breakdown import Breakdown
from evpinn_ros.core.estimation.estimator import Mode
from evpinn_ros.core.signals.block import Block
from evpinn_ros.core.signals.readings import NANOSECONDS, BatteryReading
from evpinn_ros.core.signals.time_jump import Jump
from evpinn_ros.logs.source import STRAGGLING_NS, Source
from evpinn_ros.replays.chain import Chain, ChainOutput
from evpinn_ros.replays.history import Drive, History
from evpinn_ros.replays.scoring import metrics
from evpinn_ros.replays.totals import health, totals, with_left_out
from evpinn_ros.topics import NAMESPACE
from evpinn_ros.topics.energies import output_messages
from evpinn_ros.topics.estimates import breakdown_messages
from evpinn_ros.topics.readings import reading_messages

WARM_UP = 120.0  # s at the start without scores
BLOCK = 20_000  # readings in a block of the chain
PAPER_BLOCK = 200  # in `mode: paper`, which takes 1 s for 10 s of driving
PROGRESS_STEP = 1.0  # s of the drive between reports of progress

Progress = Callable[[float], None]  # takes the replayed s of the drive


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """Options of a replay.

    Attributes:
        withhold_battery_after: s since the start, None to withhold nothing.
        warm_up: s at the start without scores.
        rate: times real time, None for as fast as possible.
        start: s since the first reading; earlier readings are skipped.
        duration: s from `start` on; later readings are skipped; None for all.
    """

    withhold_battery_after: float | None = None
    warm_up: float = WARM_UP
    rate: float | None = None
    start: float = 0.0
    duration: float | None = None

    def __post_init__(self) -> None:
        times = (self.withhold_battery_after, self.warm_up, self.rate, self.start, self.duration)
        if self.rate == 0.0 or not all(time is None or 0.0 <= time < math.inf for time in times):
            raise InputError("times of a replay must be finite and >= 0 s, and its rate above 0")

    def seconds_of(self, whole: float | None) -> float | None:
        """Length of the replayed part of a drive of `whole` s; None if unknown."""
        if whole is None:
            return self.duration
        rest = max(0.0, whole - self.start)
        return rest if self.duration is None else min(rest, self.duration)


@dataclass(frozen=True, slots=True)
class Replayed:
    """Result of a replayed drive."""

    drive: Drive
    metrics: dict[str, Any]
    problem: str | None  # why part of the input could not be read


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
    """Run one drive through the chain, which keeps its learned state.

    `stopped` is called at each block; True ends the drive there.

    Raises:
        InputError: the source has no speed, or too few to predict from.
    """
    history = History()
    # Ignores detections of earlier drives.
    history.add_detections(0, chain.estimator.detections())
    not_recorded: Counter[str] = Counter()
    started = time.perf_counter()
    size = PAPER_BLOCK if mode == Mode.PAPER.value else BLOCK
    size = size if options.rate is None else 1
    parts = (part for block in source.blocks() for part in block.parts(size))
    blocks = takewhile(lambda _: not stopped(), span(parts, options.start, options.duration))
    pace = _Pace(options.rate, progress)
    for item in (item for block in blocks for item in chain.follow(block)):
        if isinstance(item, Jump):
            _take_rest(chain, history, writer)
            chain.jump()
            history.add_jump(item)
            continue
        history.add_block(item)
        pace.keep(history.now)
        given = _without_withheld(item, history, options.withhold_battery_after)
        if writer is None:
            history.add_outputs(chain.read(given))
            history.add_states(chain.account.count())
        else:
            not_recorded.update(_recorded(writer, item, given, chain, history))
    _take_rest(chain, history, writer)
    _finish(chain, history, writer)
    wall = time.perf_counter() - started
    drive = replace(
        history.drive(chain.estimator.model()),
        zoned=source.zoned,
        reading_notes=tuple(dict.fromkeys((*source.assumptions, *source.notes))),
        doubts=source.doubts,
        stops_s=source.stops_s,
    )
    _refuse_unpredicted(drive, source, options)
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
    scores["totals"] = totals([drive])
    scores["health"] = health(chain.account.gauge)
    scores["breakdown"] = with_left_out(scores["breakdown"], scores["totals"])
    return Replayed(drive, scores, source.problem)


def _finish(chain: Chain, history: History, writer: BagWriter | None) -> None:
    """Take, and write, what the estimator knows at the end of the drive."""
    last = chain.estimator.finish()
    history.add_output(last.stamp_ns, last)
    history.add_detections(last.stamp_ns, chain.estimator.detections())
    history.add_model(last.stamp_ns, chain.estimator.model())
    if writer is not None:
        _write(writer, last, history.moment(last.stamp_ns))
        if (breakdown := chain.estimator.breakdown()) is not None:
            _write(writer, breakdown, history.moment(last.stamp_ns), last.stamp_ns)


def _refuse_unpredicted(drive: Drive, source: Source, options: ReplayOptions) -> None:
    """Raise InputError for a drive without any prediction."""
    where = "" if options.start == 0 and options.duration is None else " in that span"
    if len(drive.speed) == 0:
        why = next((text for text in source.notes if text.startswith("speed is")), "")
        raise InputError(
            f"{source.path}: no speed{where}, so nothing can be predicted{why and f': {why}'}"
        )
    if not len(drive.newest.power) and not len(drive.smoothed.power):
        raise InputError(f"{source.path}: nothing can be predicted{where}: {_too_seldom(drive)}")


def _too_seldom(drive: Drive) -> str:
    """Why a drive has no prediction: number and interval of its speeds."""
    steps = np.diff(drive.speed[:, 0])
    if not steps.size:
        return "there is one speed"
    return f"{len(drive.speed)} speeds, {np.median(steps):.3g} s apart in the median"


def span(blocks: Iterable[Block], start: float, duration: float | None) -> Iterator[Block]:
    """The readings with stamps from `start` on, for `duration`, s, since the first reading.

    Reading ends at stamps `STRAGGLING_NS` after the part.
    """
    if start == 0 and duration is None:
        yield from blocks
        return
    first_ns: int | None = None
    end = math.inf if duration is None else start + duration
    for block in blocks:
        first_ns = int(block.stamps()[0]) if first_ns is None else first_ns
        after = {kind: (rows.stamps - first_ns) / NANOSECONDS for kind, rows in block.rows.items()}
        inside = {kind: (start <= seconds) & (seconds < end) for kind, seconds in after.items()}
        if len(part := block.only(inside)):
            yield part
        if max(seconds.max() for seconds in after.values()) >= end + STRAGGLING_NS / NANOSECONDS:
            return


class _Pace:
    """Limits a replay to its rate, and reports its progress."""

    def __init__(self, rate: float | None, progress: Progress | None) -> None:
        self._rate, self._progress = rate, progress
        self._started, self._reported = time.perf_counter(), 0.0

    def keep(self, now: float) -> None:
        """Wait until `now`, s of the drive, is due, and report it as progress."""
        if self._rate is not None:
            time.sleep(max(0.0, self._started + now / self._rate - time.perf_counter()))
        if self._progress is not None and now - self._reported >= PROGRESS_STEP:
            self._progress(now)
            self._reported = now


def _without_withheld(block: Block, history: History, withhold_after: float | None) -> Block:
    """The block without the withheld battery readings; places stay the same."""
    rows = block.of_kind(BatteryReading)
    if withhold_after is None or not len(rows.order):
        return block
    return block.with_rows(
        BatteryReading, rows.where(history.seconds(rows.stamps) <= withhold_after)
    )


def _recorded(
    writer: BagWriter, block: Block, given: Block, chain: Chain, history: History
) -> Iterator[str]:
    """Write readings and their outputs; yields a reason for each reading that is not written."""
    outputs = [*chain.take_block(given, breakdowns=True)]
    place = 0
    for reading in sorted(block.readings(), key=attrgetter("stamp_ns")):
        first = place
        while place < len(outputs) and outputs[place][0] < reading.stamp_ns:
            place += 1
        _record(writer, outputs[first:place], history)
        try:
            messages = list(reading_messages(new_message, reading))
        except ValueError:
            yield "not_recordable"
            continue
        for topic, message in messages:
            log_time_ns = history.moment(reading.stamp_ns)
            writer.write(topic.under(NAMESPACE), message, log_time_ns)
    _record(writer, outputs[place:], history)


def _take_rest(chain: Chain, history: History, writer: BagWriter | None) -> None:
    """Take the waiting readings at the end of a drive, or at a jump of time."""
    if writer is None:
        history.add_outputs(chain.read_rest())
        history.add_states(chain.account.flush())
    else:
        _record(writer, chain.take_rest(), history)


def _record(
    writer: BagWriter, outputs: Iterable[tuple[int, ChainOutput]], history: History
) -> None:
    """Write outputs at the stamps of the readings that completed them."""
    for known_ns, output in outputs:
        _write(writer, output, history.moment(known_ns), known_ns)
        history.add_output(known_ns, output)


def _write(writer: BagWriter, output: ChainOutput, log_time_ns: int, stamp_ns: int = 0) -> None:
    """Write the messages of an output; a breakdown has no stamp of its own."""
    if isinstance(output, Breakdown):
        messages = breakdown_messages(new_message, stamp_ns, output)
    else:
        messages = output_messages(new_message, output)
    for topic, message in messages:
        writer.write(topic.under(NAMESPACE), message, log_time_ns)


def has_battery(drive: Drive) -> bool:
    """Whether a drive has a battery reading."""
    return len(drive.measured) > 0


def output_folders(out: Path | None, paths: Sequence[Path], *, several: bool) -> list[Path | None]:
    """Folder of each drive's bag: `out` itself, or a folder in it for each of several inputs."""
    if out is None:
        return [None] * len(paths)
    if not several:
        return [out]
    stems = (path.name.split(".")[0] or path.resolve().name for path in paths)
    return [out / f"{index:03d}_{stem}" for index, stem in enumerate(stems, start=1)]
