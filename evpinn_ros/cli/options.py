"""Options that several commands have: defined once, so that they mean and complete the same."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from evpinn_ros.cli.console import STDOUT, tables_beside


def complete_vehicle(incomplete: str) -> list[str]:
    """Known vehicles that begin so; the shell offers paths where there is none."""
    # Here, for every command has this option, and few are asked for a completion.
    from evpinn_ros.vehicle.files import known_vehicles

    return [name for name in known_vehicles() if name.startswith(incomplete)]


def complete_profile(incomplete: str) -> list[str]:
    """Bundled CAN profiles that begin so; the shell offers paths where there is none."""
    from evpinn_ros.can.profile import profile_names

    return [name for name in profile_names() if name.startswith(incomplete)]


def _tables_beside_json(path: Path | None) -> Path | None:
    tables_beside(path)
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
    typer.Option(help="Another CAN profile.", autocompletion=complete_profile),
]
TrustProfileOption = Annotated[
    bool,
    typer.Option(
        "--trust-profile", help="Use the CAN profile even if the traffic contradicts it."
    ),
]
KeptStateOption = Annotated[
    Path | None, typer.Option(help="Keeps what was learned between drives.")
]
ParamsOption = Annotated[Path | None, typer.Option(help="Parameter file (YAML).")]
ColumnOption = Annotated[
    list[str] | None,
    typer.Option(help="Correct a column: speed=NAME:km/h (see evpinn convert --help)."),
]
CarOption = Annotated[
    str | None,
    typer.Option(
        "--car",
        metavar="NAME",
        help="One of several cars: its name in a table, its namespace in a bag.",
    ),
]
ElevationOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Folder of SRTM or GeoTIFF tiles: gives heights to a log that has positions.",
    ),
]
StartOption = Annotated[float, typer.Option(min=0.0, help="Skip the first N seconds.")]
Elm327Option = Annotated[
    str | None,
    typer.Option(
        "--elm327",
        metavar="PORT",
        help="Use an ELM327 or OBDLink, at this serial port or tcp:HOST:PORT.",
    ),
]
_JSON_HELP = f"As JSON; {STDOUT} for stdout."
JsonOption = Annotated[
    Path | None, typer.Option("--json", help=_JSON_HELP, callback=_tables_beside_json)
]
JsonTextOption = Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")]
MetricsOption = Annotated[
    Path | None,
    typer.Option("--metrics", "--json", help=_JSON_HELP, callback=_tables_beside_json),
]
OriginOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="ORIGIN",
        help="http://localhost:8080, or another web page that may connect too.",
    ),
]


def elm327_bus(port: str, interface: str | None, channel: str | None) -> tuple[str, str]:
    """Interface and channel of an ELM327.

    Raises:
        typer.BadParameter: another adapter is named too.
    """
    from evpinn_ros.can.elm327 import NAME  # here, for python-can takes long to import

    if interface is not None or channel is not None:
        raise typer.BadParameter("--elm327 names the adapter: leave out interface and channel")
    return NAME, port
