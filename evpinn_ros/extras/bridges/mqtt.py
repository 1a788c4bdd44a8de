"""`evpinn mqtt`: learns cars from MQTT topics."""

from __future__ import annotations

import os
from pathlib import Path
import threading
from typing import TYPE_CHECKING, Annotated

import typer

from evpinn_ros.cli.console import note
from evpinn_ros.cli.options import ParamsOption, complete_vehicle
from evpinn_ros.common.errors import InputError, as_input_error
from evpinn_ros.common.opener import read_whole
from evpinn_ros.common.stopping import at_stop

if TYPE_CHECKING:
    from evpinn_ros.core.estimation.estimator import EstimatorSettings
    from evpinn_ros.extras.bridges.bridge import MqttBridge
    from evpinn_ros.extras.bridges.broker import Connection


MOST_SECRET = 65_536  # bytes
USER_VARIABLE, PASSWORD_VARIABLE = "EVPINN_MQTT_USER", "EVPINN_MQTT_PASSWORD"


def mqtt(
    vehicle: Annotated[
        str | None,
        typer.Option(help="Vehicle of all cars without a --car.", autocompletion=complete_vehicle),
    ] = None,
    car: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VEHICLE", help="Vehicle of one car; may be repeated."),
    ] = None,
    source: Annotated[
        str, typer.Option(help="Topics to read: teslamate, ovms, or a file that maps topics.")
    ] = "teslamate",
    namespace: Annotated[
        str, typer.Option(help="MQTT_NAMESPACE of TeslaMate, or topic.prefix of OVMS.")
    ] = "",
    broker: Annotated[
        str, typer.Option(help="Address of the broker, HOST or HOST:PORT.")
    ] = "localhost",
    user: Annotated[str | None, typer.Option(help="User name; else EVPINN_MQTT_USER.")] = None,
    password_file: Annotated[
        Path | None,
        typer.Option(help="File with the password; EVPINN_MQTT_PASSWORD if not given."),
    ] = None,
    tls: Annotated[
        bool, typer.Option("--tls", help="Encrypt the connection; the port is then 8883.")
    ] = False,
    ca: Annotated[
        str | None, typer.Option(help="File of trusted certificate authorities.")
    ] = None,
    cert: Annotated[str | None, typer.Option(help="File of the client certificate.")] = None,
    key: Annotated[str | None, typer.Option(help="Key file of the client certificate.")] = None,
    base: Annotated[str, typer.Option(help="Publish below this topic.")] = "evpinn",
    discovery: Annotated[
        str, typer.Option(help="Home Assistant's discovery prefix; '' for none.")
    ] = "homeassistant",
    state: Annotated[
        Path | None, typer.Option(help="Folder of what was learned, with one file per car.")
    ] = None,
    params: ParamsOption = None,
) -> None:
    """Learn cars from MQTT topics, and publish range, energy and more, until Ctrl-C.

    Example: evpinn mqtt --vehicle tesla_model_3_lr --state cars

    Example: evpinn mqtt --source ovms --car LEAF=nissan_leaf --broker 192.168.0.2 --user ev
    """
    # Imported here: other commands do not need the chain or paho-mqtt.
    from evpinn_ros.common.blas_threads import limit_blas_threads
    from evpinn_ros.core.vehicle.files import load_vehicle
    from evpinn_ros.extras.bridges.bridge import BridgeSettings, MqttBridge
    from evpinn_ros.extras.bridges.broker import PORT, TLS_PORT, BrokerSettings, Connection
    from evpinn_ros.extras.bridges.layouts import read_layout

    if vehicle is None and not car:
        raise typer.BadParameter("give --vehicle, or --car NAME=VEHICLE")
    if (ca or cert or key) and not tls:
        raise typer.BadParameter("--ca, --cert and --key need --tls")
    limit_blas_threads()
    given = BridgeSettings(
        read_layout(source, namespace),
        {name: load_vehicle(of) for name, of in map(_pair, car or ())},
        load_vehicle(vehicle) if vehicle is not None else None,
        _estimator(params),
        _topic("--base", base),
        _topic("--discovery", discovery) if discovery else "",
        state,
    )
    host, port = split_address(broker, "--broker", TLS_PORT if tls else PORT)
    proof = credentials(user, password_file)
    # One id per base topic: a second process with the same base would overwrite the first.
    settings = BrokerSettings(host, port, *proof, tls, ca, cert, key, given.base.replace("/", "-"))
    connection = Connection(settings, given.subscriptions, given.status_topic)
    _serve(MqttBridge(given, connection, note=lambda text: note(f"evpinn: {text}")), connection)


def _serve(bridge: MqttBridge, connection: Connection) -> None:
    stop = threading.Event()
    at_stop(lambda *_: stop.set())
    address, shown = connection.settings.address, ""
    connection.start()
    try:
        while not stop.is_set():
            bridge.step()
            if connection.hopeless:
                raise InputError(f"{address}: refused: {connection.problem}")
            why = f": {connection.problem}" if connection.problem else ""
            now = "connected" if connection.connected else f"not connected{why}"
            if now != shown:
                note(f"evpinn: {address}: {now}")
                shown = now
    finally:
        bridge.close()
        connection.close()


def _estimator(params: Path | None) -> EstimatorSettings:
    from evpinn_ros.topics.node_parameters import TABLES
    from evpinn_ros.topics.parameter_file import read_parameter_file
    from evpinn_ros.topics.settings import estimator_settings

    values = {parameter.name: parameter.default for parameter in TABLES["estimator"]}
    given = {} if params is None else read_parameter_file(params, "estimator")
    return estimator_settings({**values, **given})


def _pair(text: str) -> tuple[str, str]:
    name, separator, vehicle = text.partition("=")
    if not separator or not name or not vehicle:
        raise typer.BadParameter(f"--car: '{text}' is not NAME=VEHICLE")
    return name, vehicle


def _topic(option: str, text: str) -> str:
    if not text.strip("/") or {"+", "#", "\0"} & set(text) or text.startswith("$"):
        raise typer.BadParameter(f"{option}: '{text}' is not a topic to publish to")
    return text.strip("/")


def credentials(user: str | None, password_file: Path | None) -> tuple[str | None, str | None]:
    """User and password from options and environment; InputError for a password alone."""
    user = user or os.environ.get(USER_VARIABLE) or None
    password = os.environ.get(PASSWORD_VARIABLE) or None
    if password_file is not None:
        password = secret_of(password_file)
    if password and not user:
        raise InputError(f"a password without a user; add --user, or set {USER_VARIABLE}")
    return user, password


def secret_of(path: Path) -> str:
    """The password or token in a file; InputError if unreadable or too large."""
    with as_input_error(path, ValueError):
        return read_whole(path, MOST_SECRET, "a password or token").decode().strip("\r\n")


def split_address(text: str, option: str, default: int) -> tuple[str, int]:
    """Host and port of `HOST[:PORT]`, IPv6 in brackets; InputError if wrong or with a password."""
    if "@" in text or "/" in text:
        raise InputError(f"{option} is HOST or HOST:PORT; no scheme, no user and no password")
    host, separator, port = text.rpartition(":")
    if not separator or text.endswith("]"):
        host, port = text, str(default)
    if not port.isdecimal() or not 0 < int(port) < 65536 or not host.strip("[]"):
        raise InputError(f"{option}: '{text}' is not HOST or HOST:PORT")
    return host.strip("[]"), int(port)
