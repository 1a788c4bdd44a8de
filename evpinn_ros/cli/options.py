"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, wraps
import inspect
from pathlib import Path
from typing import Annotated, Any

import typer

from evpinn_ros.cli.console import STDOUT, tables_beside
from evpinn_ros.common.opener import LONGEST_LINE, note_own, open_file
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.units import UnitSystem
from evpinn_ros.logs.read_options import ReadOptions


def complete_vehicle(incomplete: str) -> list[str]:
    """Names of vehicles that begin with `incomplete`; if none does, the shell completes paths."""
    # Imported here: most commands have this option, and few calls complete it.
    from evpinn_ros.core.vehicle.files import known_vehicles

    return [name for name in known_vehicles() if name.startswith(incomplete)]


def complete_profile(incomplete: str) -> list[str]:
    """CAN profiles that begin with `incomplete`; if none does, the shell completes paths."""
    from evpinn_ros.can.profile import profile_names

    return [name for name in profile_names() if name.startswith(incomplete)]


def _check_json_file(context: typer.Context, path: Path | None) -> Path | None:
    """Send tables to stderr if JSON goes to stdout; BadParameter if it would overwrite a log."""
    if path is not None and path.is_file() and path.suffix not in ("", *JSON_SUFFIXES):
        raise typer.BadParameter(
            f"{path} exists, and only .json files are overwritten; - writes to stdout"
        )
    tables_beside(path)
    context.call_on_close(partial(tables_beside, None))  # one process may run several commands
    return path


def _check_table_file(context: typer.Context, path: Path | None) -> Path | None:
    """`_check_json_file`, but a .csv with the metrics of an earlier run is overwritten."""
    if path is None or path.suffix != TABLE_SUFFIX:
        return _check_json_file(context, path)
    for table, columns in ((path, METRICS_COLUMN), (trends_beside(path), TRENDS_COLUMNS)):
        if table.is_file():
            with open_file(table) as file:
                is_ours = columns in file.readline(LONGEST_LINE)
            if not is_ours:
                raise typer.BadParameter(
                    f"{table} exists, and only .json files and tables of metrics are overwritten"
                )
            note_own(table)
    return path


def trends_beside(table: Path) -> Path:
    """The file of the trends beside a table of metrics."""
    return table.with_name(f"{table.stem}_trends{table.suffix}")


def check_report(path: Path | None) -> Path | None:
    """Return `path`; InputError, before any work, if the extra `report` is not installed."""
    if path is not None:
        with optional_imports():
            import jinja2  # noqa: F401
    return path


VehicleOption = Annotated[
    str,
    typer.Option(
        help="Name of the vehicle (evpinn vehicles lists them), or path of a vehicle file.",
        autocompletion=complete_vehicle,
    ),
]
CanProfileOption = Annotated[
    str | None,
    typer.Option(help="CAN profile in place of the vehicle's.", autocompletion=complete_profile),
]
TrustProfileOption = Annotated[
    bool,
    typer.Option(
        "--trust-profile",
        help="Use the CAN profile even if the traffic on the bus contradicts it.",
    ),
]
KeptStateOption = Annotated[
    Path | None,
    typer.Option(
        help="File of what was learned: read at the start if it exists, written at the end."
    ),
]
ParamsOption = Annotated[Path | None, typer.Option(help="Parameter file (YAML).")]
ColumnOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Choose the column of a quantity: speed=NAME:km/h sets its unit, current=NAME:-A "
        "inverts its sign, time=NAME:%H:%M:%S sets its format."
    ),
]
CarOption = Annotated[
    str | None,
    typer.Option(
        "--car",
        metavar="NAME",
        help="Which of several cars to read: its name in a table, its namespace in a bag.",
    ),
]
StartOption = Annotated[float, typer.Option(min=0.0, help="Skip the first N seconds.")]
Elm327Option = Annotated[
    str | None,
    typer.Option(
        "--elm327",
        metavar="PORT",
        help="Use an ELM327 or OBDLink adapter at this serial port or tcp:HOST:PORT.",
    ),
]
_JSON_HELP = f"Write the results to this JSON file; {STDOUT} for stdout."
JSON_SUFFIXES = (".json", ".jsonl")
JsonOption = Annotated[
    Path | None, typer.Option("--json", help=_JSON_HELP, callback=_check_json_file)
]
TABLE_SUFFIX, METRICS_COLUMN, TRENDS_COLUMNS = ".csv", b"input.path", b"trend,group"
_METRICS_HELP = (
    f"{_JSON_HELP} A {TABLE_SUFFIX} file gets a table with one row per drive, and FILE_trends.csv "
    "the trends."
)
MetricsOption = Annotated[
    Path | None,
    typer.Option("--metrics", "--json", help=_METRICS_HELP, callback=_check_table_file),
]
ReportOption = Annotated[
    Path | None, typer.Option(help="Write this HTML report.", callback=check_report)
]
UnitsOption = Annotated[UnitSystem, typer.Option(help="Units in text and reports, not in JSON.")]
ElevationOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Folder of SRTM or GeoTIFF tiles with the heights for a log of positions.",
    ),
]


def _read_options(
    column: ColumnOption = None,
    car: CarOption = None,
    elevation: ElevationOption = None,
    can_profile: CanProfileOption = None,
    trust_profile: TrustProfileOption = False,
) -> ReadOptions:
    terrain = None
    if elevation is not None:
        from evpinn_ros.logs.terrain import Terrain  # here: few users have such tiles

        terrain = Terrain(elevation)
    return ReadOptions(can_profile, trust_profile, tuple(column or ()), car, terrain)


def with_read_options(command: Callable[..., None]) -> Callable[..., None]:
    """Decorator: replaces a command's parameter `read_options` by the options that build it."""
    signature = inspect.signature(command, eval_str=True)
    given = inspect.signature(_read_options, eval_str=True).parameters

    @wraps(command)
    def read_by_options(**values: Any) -> None:
        options = _read_options(**{name: values.pop(name) for name in given})
        command(**values, read_options=options)

    parameters: list[inspect.Parameter] = []
    for name, parameter in signature.parameters.items():
        parameters += given.values() if name == "read_options" else [parameter]
    vars(read_by_options)["__signature__"] = signature.replace(parameters=parameters)
    return read_by_options


def elm327_bus(port: str, interface: str | None, channel: str | None) -> tuple[str, str]:
    """(interface, channel) of an ELM327 at `port`; BadParameter if another adapter is given."""
    from evpinn_ros.can.elm327 import NAME  # here: python-can takes long to import

    if interface is not None or channel is not None:
        raise typer.BadParameter("--elm327 cannot be combined with an interface or a channel")
    return NAME, port
