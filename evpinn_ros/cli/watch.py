"""`evpinn watch`: shows a live view of running nodes."""

from __future__ import annotations

from typing import Annotated

import typer

from evpinn_ros.cli.options import JsonOption, UnitsOption
from evpinn_ros.common.units import UnitSystem
from evpinn_ros.topics import NAMESPACE


def watch(
    namespace: Annotated[str, typer.Option(help="Namespace of the topics.")] = NAMESPACE,
    plain: Annotated[
        bool, typer.Option("--plain", help="Print one line a second in place of the view.")
    ] = False,
    json_file: JsonOption = None,
    units: UnitsOption = UnitSystem.METRIC,
) -> None:
    """Show live what running nodes publish: parameters, power, energy, and what is missing.

    Subscribes to nodes that `evpinn run` or a launch file started, on this machine or on another
    with the same ROS_DOMAIN_ID, until Ctrl-C; publishes nothing. Without a terminal it prints a
    line a second. --json writes one object per line, each second, to a new file, or to stdout in
    place of the view.

    Example: evpinn watch --namespace /ev
    """
    # Imported here: all other commands work where no ROS is.
    from evpinn_ros.nodes.live.view import watch as watch_nodes

    watch_nodes(namespace, units.units, plain=plain, json_file=json_file)
