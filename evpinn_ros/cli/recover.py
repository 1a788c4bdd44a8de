"""`evpinn recover`: saves the readable messages of a broken MCAP file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from evpinn_ros.bags.mcap_records import Loss
from evpinn_ros.bags.recover import RecoveredFile, broken_files
from evpinn_ros.bags.recover import recover as recover_bag
from evpinn_ros.cli.console import moment, note, progress_bar, say, write_json, writing
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.common.units import MEGABYTE
from evpinn_ros.core.signals.readings import NANOSECONDS

MOST_LINES = 20  # of losses on the terminal; --json has them all
_time = partial(moment, timespec="milliseconds")


def recover(
    broken: Annotated[Path, typer.Argument(help="Broken MCAP file, or folder of a rosbag2 bag.")],
    out: Annotated[Path, typer.Argument(help="Folder of the new bag.")],
    json_file: JsonOption = None,
) -> None:
    """Save what is left in a broken bag, and report what was lost.

    A damaged chunk is skipped. After other damage, reading continues where the file's index
    points, or ends if the file has no index. The broken bag is not changed. If one of its files
    cannot be read, the others are saved, and the command exits with 1.

    Example: evpinn recover out/today/today_0.mcap out/saved
    """
    total = sum(path.stat().st_size for path in broken_files(broken))
    with writing(out), progress_bar(broken.name, total / MEGABYTE, "MB") as progress:
        files = recover_bag(broken, out, lambda done: progress(done / MEGABYTE))
    for file in files:
        for line in _lines(file):
            say(line)
    say(str(out))
    if json_file is not None:
        write_json(json_file, {"bag": str(out), "files": [_as_json(file) for file in files]})
    if unread := [file.problem for file in files if file.problem is not None]:
        for problem in unread:
            note(f"evpinn: {problem}")
        note(f"evpinn: {len(unread)} of {len(files)} files could not be read completely")
        raise typer.Exit(1)


def _lines(file: RecoveredFile) -> Iterator[str]:
    span = f", {_time(file.start_ns)} to {_time(file.end_ns)}" if file.messages else ""
    yield f"{file.path}: {file.messages} messages saved{span}"
    if file.unproven:
        yield f"  {file.unproven} of them have no checksum, so their content was not verified"
    for loss in file.losses[:MOST_LINES]:
        yield f"  lost: {_loss(loss)}"
    if more := file.more_losses + len(file.losses[MOST_LINES:]):
        yield f"  lost: {more} more stretches; {file.lost_bytes} bytes in all"
    if file.unknown_topic:
        yield f"  lost: {file.unknown_topic} messages, because their topic's definition is lost"
    if file.whole:
        yield "  nothing is lost" + ("" if file.ended else "; its end and index were missing")
    elif file.lost_messages is not None:
        yield f"  {file.lost_messages} messages lost in all"
    else:
        yield "  unknown how many messages are lost: the file's own count is missing"


def _loss(loss: Loss) -> str:
    what = "a chunk" if loss.chunk else "records"
    count = "" if loss.messages is None else f", {loss.messages} messages"
    text = f"{what}, bytes {loss.begin} to {loss.end}{count}, {loss.reason}"
    if loss.after_ns is not None and loss.before_ns is not None:
        seconds = (loss.before_ns - loss.after_ns) / NANOSECONDS
        return f"{text}; between {_time(loss.after_ns)} and {seconds:.3f} s later"
    if loss.after_ns is not None:
        return f"{text}; after {_time(loss.after_ns)}"
    return text


def _as_json(file: RecoveredFile) -> dict[str, Any]:
    sums = {"lost_messages": file.lost_messages, "lost_chunks": file.lost_chunks}
    return asdict(file) | {"path": str(file.path)} | sums
