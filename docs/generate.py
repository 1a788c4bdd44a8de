"""Write the reference pages that code is the source of; a test fails when they are stale.

Run: python docs/generate.py
"""

# ruff: noqa: E402
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from enum import Enum
import inspect
import math
from pathlib import Path
import sys
from types import NoneType, UnionType
from typing import Any, get_args, get_origin

import typer

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # this folder and the benchmarks lie beside the package

from docs import one_interval
from docs.metric_table import METRICS
from evpinn_ros.can.profile import CanProfile, load_profile, profile_names
from evpinn_ros.cli.main import app
from evpinn_ros.estimation.posterior import DRIVE_KEPT, NETWORK_STDS
from evpinn_ros.estimation.states import NETWORK, State
from evpinn_ros.topics import TOPICS, Topic
from evpinn_ros.topics.node_parameters import TABLES, Parameter
from evpinn_ros.vehicle.certified import certified_cars
from evpinn_ros.vehicle.files import Vehicle, load_vehicle, vehicle_names
from evpinn_ros.vehicle.parameters import PARAMETER_NAMES

MADE = "<!-- Made by docs/generate.py; change the source, not this page. -->\n"
WORDS = {  # what an option takes
    bool: "flag",
    datetime: "time",
    float: "number",
    int: "whole number",
    Path: "path",
    str: "text",
}

SHELL = """\
What `--help` of each says. `evpinn --install-completion` makes Tab complete commands, options,
vehicles, CAN profiles and modes. Progress is shown on a terminal alone; `NO_COLOR=1` takes the
colours. Results are on stdout, all else on stderr; exit codes: 0 done, 1 failed, 2 wrong usage,
130 Ctrl-C. Ctrl-C leaves what there is so far: metrics, state and a whole bag of `replay`, the
bag of `convert`, the rows of a benchmark, the trainings of `reproduce`, which goes on there;
`recover` leaves nothing, `simulate` a whole drive or nothing, also on a full disk.
For scripts:

| | |
|---|---|
| `--json` of `info`, `recover`, `can inspect`, `vehicles search`, `watch` | JSON in place \
of tables, on stdout |
| `--json FILE` of every `bench`, of `demo`, `fleet`, `replay` (also `--metrics`) | JSON beside \
the tables; `-`: on stdout, tables on stderr |
| `reproduce` | `results.json` in its folder |
| `simulate` | `truth.yaml` in the bag |
"""
READING = """\
`evpinn replay ... --metrics FILE` writes these scores as JSON: an object for one input that is
one drive, else a list. A part in <> stands for any name. What cannot be known is `null`: nothing
measured, or too short. Every score of power and energy is predict-then-update; `power` is of
`power/smoothed` and `power_now` of `power/predicted`, both after `--warm-up`. `withheld` is
there with `--withhold-battery-after` alone, and then `power`, `power_now` and `energy` outside
of it are of the part before. How to read them: [read the uncertainty](../guides/uncertainty.md).
"""


CERTIFIED = """\
## Certified cars

From the US EPA test car list 2022 (`config/certified/epa_2022.csv`): test mass, and the C_rr and
C_d A that come nearest to the certified road load. Around it 6 % of mass (people and luggage),
15 % of C_rr (tyres, roads) and 6 % of C_d A, more where a model has several road loads; eta
0.90 +- 0.06, mu 0.80 +- 0.12 and 400 +- 400 W of every one. `--vehicle` takes the key, or words
of the name that no other car has: `--vehicle "ioniq 5 rwd"`.

| key | mass kg | C_rr | C_d A m^2 | CAN profile |
|---|---|---|---|---|"""


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
        "Inputs are subscribed best effort, outputs published reliable with depth 100, *latched*",
        "ones transient local with depth 1. Every endpoint takes QoS overrides from parameters:",
        "`qos_overrides./ev/energy/state.publisher.depth`, `.history`, `.reliability`,",
        "`.durability`; another policy is refused.",
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
    lines += ["Priors of each car before driving. Copy the nearest file from"]
    lines += ["`config/vehicles/`, change what you know, check it with `evpinn check-params`, and"]
    lines += ["give its path to `--vehicle`. [Certified cars](#certified-cars) need no file:"]
    lines += ["`evpinn vehicles` lists all, `evpinn vehicles show NAME` prints one as a file.", ""]
    for name in vehicle_names():
        lines += _vehicle_section(load_vehicle(name))
    lines += [CERTIFIED, *map(_certified_row, certified_cars()), ""]
    lines += ["## CAN profiles", ""]
    lines += [
        "How the quantities come: *broadcast*, or *asked* for with read requests, which needs"
    ]
    lines += ["`poll` ([why, and what it costs](../explanation/can.md#asking-the-car)).", ""]
    lines += ["| profile | cars | broadcast | asked | verified by |", "|---|---|---|---|---|"]
    lines += [_profile_row(load_profile(name)) for name in profile_names()]
    return "\n".join([*lines, ""])


def _certified_row(key: str) -> str:
    car = load_vehicle(key)
    start = car.initial
    area = start.c_d * car.frontal_area
    profile = f"`{car.can_profile}`" if car.can_profile else ""
    return f"| `{key}` | {start.mass:.0f} | {start.c_rr:.4f} | {area:.3f} | {profile} |"


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
    if vehicle.paper_start:
        start = (f"{name} {prior.value:g}" for name, prior in vehicle.paper_start.items())
        yield from ("", f"`mode: paper` and `evpinn reproduce` start from {', '.join(start)}.")
    yield ""


def metrics_page() -> str:
    """Every key of `evpinn replay --metrics`."""
    lines = [MADE, "# Metrics", "", READING]
    lines += ["| key | unit | meaning |", "|---|---|---|"]
    lines += [f"| `{each.key}` | {each.unit} | {each.meaning} |" for each in METRICS]
    return "\n".join([*lines, ""])


def states_page() -> str:
    """Every state of a car, from the one table of them."""
    lines = [
        MADE,
        "# States",
        "",
        "What is learned of a car, of a drive and of the last minutes: one Gaussian, in which",
        "physics and network stand side by side",
        "([how it learns](../explanation/architecture.md#learning)). Each state multiplies a term",
        "of the one equation (`evpinn_ros/estimation/terms.py`). A state of level *car* is saved",
        f"and drifts a little; one of *drive* keeps {DRIVE_KEPT:.0%} of itself",
        "for the next; one of *fast* forgets itself within minutes.",
        "",
        "| state | unit | level | prior | 1-sigma | source |",
        "|---|---|---|---|---|---|",
    ]
    for state in State:
        mean, std = (
            "vehicle" if value is None else f"{value:g}" for value in (state.mean, state.std)
        )
        row = f"`{state.name.lower()}`", state.unit, state.level.value, mean, std, state.source
        lines.append(f"| {' | '.join(row)} |")
    stds = " or ".join(f"{std:g}" for std in NETWORK_STDS)
    source = "output weights of the network; which prior holds is weighed by evidence"
    lines.append(f"| `network_0` to `network_{NETWORK - 1}` | N | car | 0 | {stds} | {source} |")
    return "\n".join(lines) + "\n"


def commands_page() -> str:
    """Every command: help, examples, arguments and options."""
    found = list(_commands(typer.main.get_command(app), "evpinn"))
    lines = [MADE, "# Commands", "", SHELL, "| command | |", "|---|---|"]
    for path, command in found:
        anchor = path.replace(" ", "-")
        lines.append(f"| [`{path}`](#{anchor}) | {_paragraphs(command)[0]} |")
    for path, command in found:
        lines += ["", *_command_section(path, command)]
    return "\n".join([*lines, ""])


def _commands(command: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Every command by the words that call it, groups before their members."""
    yield path, command
    if hasattr(command, "list_commands"):
        context = command.make_context(path, [], resilient_parsing=True)
        for name in command.list_commands(context):
            yield from _commands(command.get_command(context, name), f"{path} {name}")


def _function(command: Any) -> Callable[..., Any]:
    """The function of ours behind a command: what libraries make of it changes with them."""
    return inspect.unwrap(command.callback)


def _paragraphs(command: Any) -> list[str]:
    text = inspect.getdoc(_function(command)) or ""
    return [" ".join(each.split()) for each in text.split("\n\n")]


def _command_section(path: str, command: Any) -> Iterator[str]:
    yield f"## {path}"
    for text in _paragraphs(command):
        example = text.removeprefix("Example: ")
        yield from ("", text) if example == text else ("", "```bash", example, "```")
    declared = inspect.signature(_function(command), eval_str=True).parameters
    rows = [
        _option_row(option.opts, declared[option.name])
        for option in command.params
        if option.name in declared and get_args(declared[option.name].annotation)
    ]
    if rows:
        yield from ("", "| name | value | default | meaning |", "|---|---|---|---|", *rows)


def _option_row(names: list[str], declared: inspect.Parameter) -> str:
    kind, info = get_args(declared.annotation)
    is_argument = isinstance(info, typer.models.ArgumentInfo)
    name = (info.metavar or names[0].upper()) if is_argument else ", ".join(names)
    cells = (f"`{name}`", _value(kind, info), _default(declared.default), info.help or "")
    return f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


def _value(kind: Any, info: Any) -> str:
    """Values that an option takes, in words."""
    (kind,) = set(get_args(kind)) - {NoneType} if isinstance(kind, UnionType) else (kind,)
    several = ", repeated" if get_origin(kind) is list else ""
    (kind,) = get_args(kind) if several else (kind,)
    if issubclass(kind, Enum):
        return ", ".join(f"`{each.value}`" for each in kind) + several
    ends = (("from", info.min), ("to", info.max))
    bounds = [f"{word} {end:g}" for word, end in ends if end is not None]
    return " ".join([WORDS[kind], *bounds]) + several


def _default(value: Any) -> str:
    if value is inspect.Parameter.empty:
        return "required"
    if value is None or value is False or value == "":
        return ""
    if isinstance(value, list | tuple):
        return ", ".join(map(_default, value))
    value = value.value if isinstance(value, Enum) else value
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


PAGES = {
    "explanation/one_interval.md": lambda: f"{MADE}\n{one_interval.page()}",
    "reference/topics.md": topics_page,
    "reference/parameters.md": parameters_page,
    "reference/vehicles.md": vehicles_page,
    "reference/commands.md": commands_page,
    "reference/metrics.md": metrics_page,
    "reference/states.md": states_page,
}


def main() -> None:
    """Write every page beside this file."""
    for name, page in PAGES.items():
        (Path(__file__).parent / name).write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
