"""Write the reference pages that code is the source of; a test fails when they are stale.

Run: python docs/generate.py
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
import math
from pathlib import Path

from evpinn_ros.can.profile import CanProfile, load_profile, profile_names
from evpinn_ros.nodes.parameter_table import TABLES, Parameter
from evpinn_ros.nodes.topics import TOPICS, Topic
from evpinn_ros.vehicle.files import Vehicle, load_vehicle, vehicle_names
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES

MADE = "<!-- Made by docs/generate.py; change the source, not this page. -->\n"


def topics_page() -> str:
    """Every topic with type, source and content."""
    return "\n".join((
        MADE,
        "# Topics",
        "",
        "Names are relative; launch files and `evpinn run` put them under `/ev`. Units are SI,",
        "time is `header.stamp`, the moment the car measured. Power and energy are positive when",
        "drawn from the battery; `battery/state` keeps ROS's sign, negative while discharging.",
        "A *named vector* is a `sensor_msgs/JointState` whose `name` names the quantities,",
        "`position` holds their values, `velocity` their rates and `effort` their 1-sigma: ROS 2",
        "has no standard stamped scalar, and PlotJuggler and Foxglove plot this one by name.",
        "",
        "Inputs are subscribed best effort, outputs published reliable with depth 10, *latched*",
        "ones transient local with depth 1. Every endpoint takes QoS overrides from parameters.",
        "",
        "| topic | type | from | unit | content |",
        "|---|---|---|---|---|",
        *(_topic_row(topic) for topic in TOPICS),
        "",
    ))  # fmt: skip


def _topic_row(topic: Topic) -> str:
    latched = " *Latched.*" if topic.latched else ""
    type_name = topic.type_name.replace("/msg/", "/")
    cells = (f"`{topic.name}`", type_name, topic.source, topic.unit, topic.description + latched)
    return f"| {' | '.join(cells)} |"


def parameters_page() -> str:
    """Every parameter of every node."""
    lines = [MADE, "# Parameters", ""]
    lines += ["A commented file with every default: `config/evpinn.param.yaml`. Check yours with"]
    lines += ["`evpinn check-params FILE`.", ""]
    for node, table in TABLES.items():
        lines += [f"## {node}", "", "| name | default | range | at run time | meaning |"]
        lines += ["|---|---|---|---|---|", *(_parameter_row(p) for p in table), ""]
    return "\n".join(lines)


def _parameter_row(parameter: Parameter) -> str:
    unit = f" {parameter.unit}" if parameter.unit else ""
    default = f"`{parameter.default}`{unit}" if parameter.default != "" else "empty"
    change = "fixed" if parameter.read_only else "changes"
    return (
        f"| `{parameter.name}` | {default} | {_range(parameter)} | {change} "
        f"| {parameter.description} |"
    )


def _range(parameter: Parameter) -> str:
    if parameter.choices:
        return ", ".join(parameter.choices)
    if math.isfinite(parameter.lower) or math.isfinite(parameter.upper):
        return f"{parameter.lower:g} to {parameter.upper:g}"
    return ""


def vehicles_page() -> str:
    """Every vehicle file: priors and their sources; every CAN profile."""
    lines = [MADE, "# Vehicles", ""]
    lines += ["What is believed of each car before driving. Copy the nearest file from"]
    lines += ["`config/vehicles/`, change what you know, check it with `evpinn check-params`, and"]
    lines += ["give its path to `--vehicle`.", ""]
    for name in vehicle_names():
        lines += _vehicle_section(load_vehicle(name))
    lines += ["## CAN profiles", ""]
    lines += [
        "How the quantities come: *broadcast*, or *asked* for with read requests, which needs"
    ]
    lines += ["`poll` ([why, and what it costs](can.md#asking-the-car)).", ""]
    lines += ["| profile | cars | broadcast | asked | verified by |", "|---|---|---|---|---|"]
    lines += [_profile_row(load_profile(name)) for name in profile_names()]
    return "\n".join([*lines, ""])


def _profile_row(profile: CanProfile) -> str:
    name = f"`{profile.key}`" + (" (experimental)" if profile.experimental else "")
    broadcast, asked = (", ".join(_words(part)) for part in (profile.messages, profile.asked))
    return f"| {name} | {profile.name} | {broadcast} | {asked} | {profile.verified_by} |"


def _words(quantities: Iterable[str]) -> Iterator[str]:
    return (quantity.replace("_", " ") for quantity in quantities)


def _vehicle_section(vehicle: Vehicle) -> Iterator[str]:
    profile = f"`{vehicle.can_profile}`" if vehicle.can_profile else "none yet"
    yield from (f"## {vehicle.name} (`{vehicle.key}`)", "")
    yield f"CAN profile: {profile}. Frontal area {vehicle.frontal_area:g} m^2."
    yield from ("", "| parameter | prior | 1-sigma | source |", "|---|---|---|---|")
    for name in PARAMETER_NAMES:
        prior = vehicle.priors[name]
        yield f"| `{name}` | {prior.value:g} | {prior.std:g} | {prior.source} |"
    yield ""


PAGES = {"topics.md": topics_page, "parameters.md": parameters_page, "vehicles.md": vehicles_page}


def main() -> None:
    """Write every page beside this file."""
    for name, page in PAGES.items():
        (Path(__file__).parent / name).write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
