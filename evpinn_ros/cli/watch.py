"""`evpinn watch`: the live view of a running system."""

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
    """Show what a running system knows: parameters, power, energy, what is missing.

    Receives the topics of nodes started by `evpinn run` or a launch file, on this machine or, with
    the same ROS_DOMAIN_ID, another; publishes nothing, and ends with Ctrl-C. Without a terminal it
    prints a line a second. --json writes an object a second, one per line, to a new file, or to
    stdout without the view.

    Example: evpinn watch --namespace /ev
    """
    # Imported here: all other commands work where no ROS is.
    from evpinn_ros.nodes.live.view import watch as watch_nodes

    watch_nodes(namespace, units.units, plain=plain, json_file=json_file)
