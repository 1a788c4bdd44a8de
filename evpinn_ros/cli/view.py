"""`evpinn view`: plays a bag on its ROS topics."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from evpinn_ros.bags.reader import BagReader
from evpinn_ros.cli.console import note


def view(
    bag: Annotated[Path, typer.Argument(help="Bag to play: a folder, .mcap or .db3.")],
    rate: Annotated[
        float, typer.Option(min=0.01, max=1000.0, help="Speed of the replay; 1 is real time.")
    ] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Restart at the end.")] = False,
) -> None:
    """Play a bag on its ROS topics, from the moment a viewer subscribes until Ctrl-C.

    Viewers are `evpinn watch`, PlotJuggler, and Foxglove through foxglove_bridge. Pauses without
    messages are cut to ten seconds. Fails if running nodes would learn from the bag: then set
    another ROS_DOMAIN_ID for this command and the viewer.

    Example: evpinn view bags/urban --rate 4 --loop
    """
    with BagReader(bag) as reader:
        # Imported here: `--help` works where no ROS is.
        from evpinn_ros.nodes.live.player import play

        play(reader, rate, loop, note)
        for line in filter(None, (*reader.notes, reader.problem)):
            note(line)
