"""`evpinn view`: a bag in Foxglove."""

from __future__ import annotations

from pathlib import Path
import time
from typing import Annotated

import typer

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.bags.types import typestore
from evpinn_ros.cli.console import note
from evpinn_ros.cli.options import OriginOption
from evpinn_ros.common.errors import InputError
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.nodes.live.foxglove import LOOPBACK, PORT, FoxgloveServer, is_loopback

LONGEST_PAUSE = 10.0  # s of the bag: a stretch without messages takes no longer
POLL = 0.1  # s


def view(
    bag: Annotated[Path, typer.Argument(help="Bag to play: a folder, .mcap or .db3.")],
    rate: Annotated[
        float, typer.Option(min=0.01, max=1000.0, help="Speed of the replay; 1 is real time.")
    ] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = LOOPBACK,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port to listen on; 0 for any free one.")
    ] = PORT,
    foxglove_origin: OriginOption = None,
) -> None:
    """Play a bag to Foxglove, from the moment a viewer connects until Ctrl-C.

    In Foxglove open the connection `ws://localhost:8765` and import config/views/foxglove.json.
    Pauses without messages are cut to ten seconds. This needs the extra `foxglove`.

    Example: evpinn view bags/urban --rate 4 --loop
    """
    if not is_loopback(host):
        note(f"Warning: {host} is not loopback; whoever reaches it can read along.")
    with BagReader(bag) as reader:
        definitions = typestore().fielddefs
        offered = {
            topic: info.type_name
            for topic, info in reader.topics.items()
            if info.count and info.type_name in definitions
        }
        if not offered:
            raise InputError(f"{bag}: holds no messages that can be shown")
        with FoxgloveServer(
            host, port, offered, replay=True, origins=foxglove_origin or ()
        ) as server:
            _serve(reader, server, rate, loop)
        if reader.problem is not None:
            note(reader.problem)


def _serve(reader: BagReader, server: FoxgloveServer, rate: float, loop: bool) -> None:
    """Play once a viewer is connected, and keep serving until Ctrl-C."""
    note(f"{reader.path}: waiting for Foxglove at {server.address}; Ctrl-C ends")
    try:
        while not server.watched:
            time.sleep(POLL)
        _play(reader, server, rate)
        while loop:
            server.start_over()
            _play(reader, server, rate)
        note(f"{reader.path}: at its end")
        while True:
            time.sleep(POLL)
    except KeyboardInterrupt:
        pass


def _play(reader: BagReader, server: FoxgloveServer, rate: float) -> None:
    due, before_ns = time.monotonic(), None
    for record in reader.raw_records():
        passed = 0.0 if before_ns is None else (record.log_time_ns - before_ns) / NANOSECONDS
        due += min(max(passed, 0.0), LONGEST_PAUSE) / rate
        before_ns = record.log_time_ns
        time.sleep(max(due - time.monotonic(), 0.0))
        server.send_time(record.log_time_ns)
        server.send(record.topic, record.type_name, record.message, record.log_time_ns)
    if before_ns is None:
        raise InputError(f"{reader.path}: no message that can be shown")
