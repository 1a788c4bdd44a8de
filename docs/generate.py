"""Write the reference pages that code is the source of; a test fails when they are stale.

Run: python docs/generate.py
"""

# ruff: noqa: E402
from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from enum import Enum
import inspect
from itertools import chain, groupby
import math
from pathlib import Path
import re
import sys
from textwrap import wrap
from types import NoneType, UnionType
from typing import Any, get_args, get_origin

import typer
import yaml

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # this folder and the benchmarks lie beside the package

from docs import one_interval
from docs.metric_table import METRICS
from evpinn_ros import api
from evpinn_ros.cli import options
from evpinn_ros.cli.main import app
from evpinn_ros.core.estimation.posterior import DRIVE_KEPT, NETWORK_STDS
from evpinn_ros.core.estimation.states import NETWORK, State
from evpinn_ros.core.signals.detector import TABLE
from evpinn_ros.core.signals.readings import RANGES
from evpinn_ros.core.vehicle.certified import certified_cars
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle, vehicle_names
from evpinn_ros.core.vehicle.parameters import PARAMETER_NAMES
from evpinn_ros.core.vehicle.rated import rated_cars
from evpinn_ros.topics import TOPICS
from evpinn_ros.topics.node_parameters import TABLES, Parameter

BENCH = "evpinn bench"
MADE = "<!-- Made by docs/generate.py; change the source, not this page. -->\n"
SHARED = [value for name, value in vars(options).items() if name.endswith("Option")]
WORDS = {  # what an option takes
    bool: "flag",
    datetime: "time",
    float: "number",
    int: "whole number",
    Path: "path",
    str: "text",
}

SHELL = """\
This page has what `--help` shows for each command (of `evpinn bench`, in short), defaults
in brackets. `evpinn --install-completion` lets Tab complete them. Results are written to stdout,
everything else to stderr. Progress bars appear only on a terminal; `NO_COLOR=1` turns colours off.
Exit codes: 0 done, 1 failed, 2 wrong usage, 130 Ctrl-C.

Ctrl-C keeps what is finished: metrics, state and a whole bag of `replay`, the bag of `convert`,
the rows of a benchmark, the trainings of `reproduce` (the same command continues there).
`recover` then leaves nothing, and `simulate` leaves a whole drive or nothing; so it is on a full
disk too. For scripts:

| | |
|---|---|
| `--json FILE` of every command that has results (of `replay` also `--metrics`, a table where \
FILE ends in `.csv`) | JSON beside the tables; with `-` JSON on stdout, and tables on stderr |
| `reproduce` | `results.json` in its folder |
| `simulate` | `truth.yaml` in the bag |
"""
DETECTORS = """\
# Detectors

Each detector follows one number, its evidence (`core/signals/detector.py`). Above the limit
*on* the fault is there, at the limit *off* and below it is gone, and in between the verdict stays
as it was; where there is no such limit, another value of the signal begins anew. There is no
verdict before the evidence rests on what the column *not before* says.
"""
SINGLE_VALUES = """\
`speed_repeats` is not a fault yet: a speed that leaps when it moves again did hang too,
after 0.35 s already.

## Checks of single values

These need no memory, so they have no hysteresis. A reading out of its range (SI units) is dropped
and counted as `..._out_of_range`. Between two readings, speed cannot change by more than 1 m/s and
15 m/s^2 (an interval with such a leap is not learned), and altitude by more than 30 m and 30 % of
the way (the leap is no rise). Two kinds of checks are explained elsewhere: stamps that jump, which
hold readings back ([determinism](../explanation/architecture.md#determinism)), and frames that do
not fit a CAN profile, which are counted ([CAN](../explanation/can.md#which-car-is-this)).
"""
READING = """\
`evpinn replay ... --metrics FILE` writes these scores as JSON: one object for one drive, a
list of them for several, whose last has the `totals`, `breakdown` and `trends` of all under
`together`. To a file that ends in `.csv` it writes a table: a column for each key, a row for each
drive, and one of all; trends go to `FILE_trends.csv` beside it.
`trends` has a row for each week or temperature with consumption, rolling resistance and capacity,
of three drives of a kilometre or more: `trend` (quantity and unit), `group`, `drives`,
`distance_m`, `mean` (weighted by distance) and `spread` of single drives (1-sigma). A part in <>
stands for any name. Values that cannot be known are `null`, because
nothing was measured or the drive is too short. All scores of power and energy are
predict-then-update: each sample is predicted before it is learned from. `power` scores
`power/smoothed`, and `power_now` scores `power/predicted`, both after `--warm-up`. `withheld`
exists only with `--withhold-battery-after`; then the other `power`, `power_now` and `energy` are
for the part before. [Read the uncertainty](../guides/uncertainty.md) explains what they are worth.
"""


VEHICLES = """\
# Vehicles

What is known about each car before it drives (its *priors*): value and 1-sigma. `evpinn vehicles`
lists all cars with a battery and consumption, and `evpinn vehicles show NAME` prints one as a
file, with the source of every prior. For another car, copy the most similar file from
`config/vehicles/`, change what you know better, check it with `evpinn check-params`, and give its
path to `--vehicle`. [Certified](#certified-cars) and [rated](#rated-cars) cars need no file.
`mode: paper` and `evpinn reproduce` begin elsewhere where a file has `paper_start`.

| vehicle | eta | mu | mass kg | C_rr | C_d | p_aux W | frontal area m^2 | CAN profile |
|---|---|---|---|---|---|---|---|---|"""


CALLED = ("Estimator",)  # classes that callers make
API = """\
# Python API

`import evpinn_ros as ev` ([in use](../guides/python.md)). `help(ev.replay)` and
`make site` show all of a docstring: arguments, columns, errors.
"""


CERTIFIED = """\
## Certified cars

The US EPA test car list 2022 (`config/certified/epa_2022.csv`) gives the test mass and the
certified road load; C_rr and C_d A are those that come nearest to this road load. Their 1-sigma
is 6 % of the mass (people and luggage), 15 % of C_rr (tyres, roads) and 6 % of C_d A, and more if
a model has several road loads. Every car has eta 0.90 +- 0.06, mu 0.80 +- 0.12 and a standing
load of 400 +- 400 W. Give `--vehicle` the key, or words of the name that no other car has:
`--vehicle "ioniq 5 rwd"`.
"""


RATED = """\
## Rated cars

Of these cars sold in Europe, `config/rated/wltp.csv` has the curb mass, the usable battery and the
WLTP range, with their sources. Their priors are those of `generic`, given these facts: the mass is
known to 6 %, and the energy of the WLTP's cycle to 10 %, after 10 % are added, because ratings are
mostly those of the lightest trim. C_rr is known no better than that of any car, C_d A little
better. Some masses include a driver of 75 kg, others do not. If a car is in both lists, use the
certified one.
"""


def topics_page() -> str:
    """Every topic with type and content, by its source."""
    sources = dict.fromkeys(topic.source for topic in TOPICS)
    return "\n".join((
        MADE,
        "# Topics",
        "",
        "Names are relative; launch files and `evpinn run` put them under `/ev`. Units are SI,",
        "and the time is `header.stamp`, the moment of the measurement in the car. Power and",
        "energy are positive when drawn from the battery; only the current of `battery/state` has",
        "ROS's sign, negative while discharging. ROS 2 has no standard message for a number with",
        "a time stamp. So a *named vector* is used: a `sensor_msgs/JointState` whose `name` lists",
        "the quantities, `position` their values, `velocity` their rates and `effort` their",
        "1-sigma. PlotJuggler and Foxglove plot it by name.",
        "",
        "Inputs are subscribed best effort. Outputs are published reliable with depth 100, and",
        "*latched* ones transient local with depth 1. Every endpoint accepts QoS overrides as",
        "parameters, for example `qos_overrides./ev/energy/state.publisher.depth`, and likewise",
        "`.history`, `.reliability` and `.durability`; other policies are refused.",
        "",
        *chain.from_iterable(_topics_from(source) for source in sources),
    ))  # fmt: skip


def _topics_from(source: str) -> Iterator[str]:
    yield from (f"## From {source}", "")
    for topic in TOPICS:
        if topic.source == source:
            latched = " *Latched.*" if topic.latched else ""
            facts = "; ".join(filter(None, (topic.type_name.replace("/msg/", "/"), topic.unit)))
            yield f"- `{topic.name}` ({facts}): {topic.description}{latched}"
    yield ""


def parameters_page() -> str:
    """Every parameter of every node."""
    lines = [MADE, "# Parameters", ""]
    lines += ["`config/evpinn.param.yaml` is a commented file with every default. Check your own"]
    lines += ["file with `evpinn check-params FILE`. *Dynamic* ones change at run time.", ""]
    nodes: dict[str, list[str]] = {}
    for node, table in TABLES.items():
        for parameter in table:
            nodes.setdefault(_parameter_line(parameter), []).append(node)
    sections: dict[str, list[str]] = {}
    for line, names in nodes.items():
        sections.setdefault(" and ".join(names) if len(names) < 3 else "Every node", []).append(
            line
        )
    for title, entries in sections.items():
        lines += [f"## {title}", "", *entries, ""]
    return "\n".join(lines)


def _parameter_line(parameter: Parameter) -> str:
    unit = f" {parameter.unit}" if parameter.unit else ""
    default = f"`{parameter.default}`{unit}" if parameter.default != "" else ""
    dynamic = "" if parameter.read_only else "*dynamic*"
    facts = ", ".join(filter(None, (default, _range(parameter), dynamic)))
    return f"- `{parameter.name}`{f' ({facts})' if facts else ''}: {parameter.description}"


def _range(parameter: Parameter) -> str:
    if parameter.choices:
        return " or ".join(parameter.choices)
    if math.isfinite(parameter.lower) or math.isfinite(parameter.upper):
        return f"{parameter.lower:g} to {parameter.upper:g}"
    return ""


PARAMETER_FILE = """\
# Parameters of the three nodes, each with its default. Copy this file, change what differs:
#   ros2 launch evpinn_ros evpinn.launch.py params_file:=my_car.yaml
# `evpinn check-params my_car.yaml` checks a copy without starting anything. `/**/` is any
# namespace. Parameters marked (live) can be changed while the node runs; others are read once.
"""


def parameter_file() -> str:
    """The commented parameter file with every default."""
    lines = [PARAMETER_FILE]
    for node, table in TABLES.items():
        lines += [f"/**/{node}:", "  ros__parameters:"]
        for parameter in table:
            unit = f" [{parameter.unit}]" if parameter.unit else ""
            text = f"{parameter.description}{unit}{'' if parameter.read_only else ' (live)'}"
            lines += wrap(text, 99, initial_indent="    # ", subsequent_indent="    # ")
            value = yaml.safe_dump(parameter.default).splitlines()[0].replace("''", '""')
            lines.append(f"    {parameter.name}: {value}")
        lines.append("")
    return "\n".join(lines)


def vehicles_page() -> str:
    """Every vehicle file: priors and their sources; every CAN profile."""
    lines = [MADE, VEHICLES, *(_vehicle_row(load_vehicle(name)) for name in vehicle_names()), ""]
    lines += [CERTIFIED, *_by_make(certified_cars()), ""]
    lines += [RATED, *_by_make(rated_cars()), ""]
    return "\n".join(lines)


def _by_make(keys: Iterable[str]) -> Iterator[str]:
    """A line of keys for each make."""
    for _, models in groupby(sorted(keys), lambda key: key.partition("_")[0]):
        yield f"- {', '.join(f'`{key}`' for key in models)}"


def _vehicle_row(vehicle: Vehicle) -> str:
    priors = (vehicle.priors[name] for name in PARAMETER_NAMES)
    values = (f"{prior.value:g}±{prior.std:g}" for prior in priors)
    profile = f"`{vehicle.can_profile}`" if vehicle.can_profile else ""
    cells = (f"`{vehicle.key}`", *values, f"{vehicle.frontal_area:g}", profile)
    return f"| {' | '.join(cells)} |"


def metrics_page() -> str:
    """Every key of `evpinn replay --metrics`."""
    lines = [MADE, "# Metrics", "", READING]
    sections: dict[tuple[str, str, str], list[str]] = {}
    for metric in METRICS:
        section, _, key = metric.key.rpartition(".")
        sections.setdefault((key, metric.unit, metric.meaning), []).append(section)
    lines += ["| key | unit | meaning |", "|---|---|---|"]
    for (key, unit, meaning), names in sections.items():
        path = f"`{f'{names[0]}.' if names[0] else ''}{key}`"
        if len(names) > 1:
            path = f"`{key}` of {', '.join(f'`{name}`' for name in names)}"
        lines.append(f"| {path} | {unit} | {meaning} |")
    return "\n".join([*lines, ""])


def states_page() -> str:
    """Every state of a car, from the one table of them."""
    kept = ", ".join(f"{share:.0%} of `{state.name}`" for state, share in DRIVE_KEPT.items())
    lines = [
        MADE,
        "# States",
        "",
        "Everything that is learned about a car, a drive and the last minutes. The states of the",
        "physics and the weights of the network have one joint Gaussian distribution",
        "([how it learns](../explanation/architecture.md#learning)). Each state multiplies one",
        "term of the equation (`evpinn_ros/core/estimation/terms.py`). Levels: *car* states",
        "are saved and drift a little from drive to drive; the next",
        f"drive keeps of a *drive* state {kept}; *fast* states decay within minutes.",
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


def detectors_page() -> str:
    """Every detector with its limits, and the ranges of readings."""
    header = "| detects | evidence | unit | on above | off at | not before | while it is on |"
    lines = [MADE, DETECTORS, header, "|---|---|---|---|---|---|---|"]
    for row in TABLE:
        off = f"{row.off:g}" if math.isfinite(row.off) else "-"
        least = f"{row.least:g} {row.rests_on}" if row.least else ""
        cells = f"`{row.fault}`", row.evidence, row.unit, f"{row.on:g}", off, least, row.effect
        lines.append(f"| {' | '.join(cells)} |")
    lines += [
        "",
        SINGLE_VALUES,
        "| reading | quantity | from | to | unknown |",
        "|---|---|---|---|---|",
    ]
    for what, field, low, high, unknown in chain.from_iterable(RANGES.values()):
        most = f"{high:g}" if math.isfinite(high) else ""
        lines.append(f"| {what} | {field} | {low:g} | {most} | {'yes' if unknown else ''} |")
    return "\n".join([*lines, ""])


def commands_page() -> str:
    """Every command: help, examples, arguments and options."""
    lines = [MADE, "# Commands", "", SHELL, "## Options of several commands", ""]
    lines += ["Each command names those it takes after *And*.", ""]
    shared = {option.opts[-1]: line for option, line in _shared_options()}
    lines += [line for _, line in sorted(shared.items())]
    for path, command in _commands(typer.main.get_command(app), "evpinn"):
        if path == BENCH or not path.startswith(BENCH):
            lines += ["", *_command_section(path, command), *([""] if path == BENCH else [])]
        else:  # for who works on this package, in a checkout
            first, *_, example = _paragraphs(command)
            lines.append(f"- `{example.removeprefix('Example: ')}`: {first}")
    return "\n".join([*lines, ""])


def api_page() -> str:
    """Signature and first sentence of each public name, and of what public classes have."""
    return "\n".join([MADE, API, *chain.from_iterable(map(_api_section, api.__all__))])


def _api_section(name: str) -> Iterator[str]:
    value = getattr(api, name)
    calls = inspect.isfunction(value) or name in CALLED
    code = ["```python", _call(f"ev.{name}", value, wide=True), "```", ""] if calls else []
    yield from (f"## ev.{name}", "", *code, _first_sentence(value), "")
    if inspect.isclass(value):
        sentences = {
            _call(key, member) if inspect.isfunction(member) else key: _first_sentence(member)
            for key, member in vars(value).items()
            if key[0] != "_" and key not in getattr(value, "_fields", ())
        }
        told = {call: sentence for call, sentence in sentences.items() if sentence}
        lines = [f"- `{call}`: {text}" for call, text in (_attributes(value) | told).items()]
        yield from [*lines, ""] if lines else []


def _attributes(value: Any) -> dict[str, str]:
    """What the docstring of a class says of its attributes."""
    section = (inspect.getdoc(value) or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    entries = re.findall(r"^    (\w+): ((?:.*\n?)(?: {8}.*\n?)*)", section, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


class _Annotation(str):
    """An annotation as the source has it."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def _call(name: str, value: Any, *, wide: bool = False) -> str:
    """How something is called; wide: each argument on its own line."""
    signature = inspect.signature(value)
    given = [p for p in signature.parameters.values() if p.name != "self"]
    arguments = [str(p.replace(annotation=_Annotation(p.annotation))) for p in given]
    named = [p.kind is p.KEYWORD_ONLY for p in given]
    if True in named:
        arguments.insert(named.index(True), "*")
    listed = (
        "".join(f"\n    {argument}," for argument in arguments) if wide else ", ".join(arguments)
    )
    result = "" if inspect.isclass(value) else f" -> {signature.return_annotation}"
    return f"{name}({listed}\n){result}" if wide else f"{name}({listed}){result}"


def _first_sentence(value: Any) -> str:
    paragraphs = (inspect.getdoc(value) or "").split("\n\n")
    return " ".join(paragraphs[0].split())


def _shared_options() -> Iterator[tuple[Any, str]]:
    for _, command in _commands(typer.main.get_command(app), "evpinn"):
        for option, declared in _declared(command):
            if declared.annotation in SHARED:
                yield option, _option_line(option.opts, declared.replace(default=None))


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


def _declared(command: Any) -> Iterator[tuple[Any, inspect.Parameter]]:
    """Options of a command, with what `evpinn_ros` declares of each."""
    declared = inspect.signature(command.callback, eval_str=True).parameters
    for option in command.params:
        if option.name in declared and get_args(declared[option.name].annotation):
            yield option, declared[option.name]


def _paragraphs(command: Any) -> list[str]:
    text = inspect.getdoc(_function(command)) or ""
    return [" ".join(paragraph.split()) for paragraph in text.split("\n\n")]


def _command_section(path: str, command: Any) -> Iterator[str]:
    yield f"## {path}"
    for text in _paragraphs(command):
        example = text.removeprefix("Example: ")
        yield from ("", text) if example == text else ("", "```bash", example, "```")
    every = list(_declared(command))
    lines = [
        _option_line([*option.opts, *option.secondary_opts], declared)
        for option, declared in every
        if declared.annotation not in SHARED
    ]
    shared = [
        f"`{option.opts[-1]}`{_default(declared.default)}"
        for option, declared in every
        if declared.annotation in SHARED
    ]
    if lines:
        yield from ("", *lines)
    if shared:
        yield from ("", f"And {', '.join(shared)}.")


def _option_line(names: list[str], declared: inspect.Parameter) -> str:
    kind, info = get_args(declared.annotation)
    is_argument = isinstance(info, typer.models.ArgumentInfo)
    name = (info.metavar or names[0].upper()) if is_argument else ", ".join(names)
    value = _value(kind, info)
    takes = "" if value == "flag" else f" {value}{_default(declared.default)}"
    return f"- `{name}`{takes}: {info.help}"


def _value(kind: Any, info: Any) -> str:
    """Values that an option takes, in words."""
    (kind,) = set(get_args(kind)) - {NoneType} if isinstance(kind, UnionType) else (kind,)
    several = ", repeated" if get_origin(kind) is list else ""
    (kind,) = get_args(kind) if several else (kind,)
    if issubclass(kind, Enum):
        return ", ".join(f"`{member.value}`" for member in kind) + several
    ends = (("from", info.min), ("to", info.max))
    bounds = [f"{word} {end:g}" for word, end in ends if end is not None]
    return " ".join([WORDS[kind], *bounds]) + several


def _default(value: Any) -> str:
    if value is inspect.Parameter.empty or value is None or value is False or value == "":
        return ""
    value = value.value if isinstance(value, Enum) else value
    return f" (`{value:g}`)" if isinstance(value, float) else f" (`{value}`)"


PAGES = {
    "explanation/one_interval.md": lambda: f"{MADE}\n{one_interval.page()}",
    "reference/topics.md": topics_page,
    "reference/parameters.md": parameters_page,
    "../config/evpinn.param.yaml": parameter_file,
    "reference/vehicles.md": vehicles_page,
    "reference/commands.md": commands_page,
    "reference/metrics.md": metrics_page,
    "reference/states.md": states_page,
    "reference/detectors.md": detectors_page,
    "reference/api.md": api_page,
}


def main() -> None:
    """Write every page beside this file."""
    for name, page in PAGES.items():
        (Path(__file__).parent / name).write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
