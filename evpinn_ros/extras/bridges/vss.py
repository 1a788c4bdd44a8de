"""`evpinn vss`: a car behind a KUKSA databroker, live."""

from __future__ import annotations

from pathlib import Path
import time
from typing import TYPE_CHECKING, Annotated

import typer

from evpinn_ros.cli.console import note
from evpinn_ros.cli.options import KeptStateOption, VehicleOption
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.stopping import at_stop
from evpinn_ros.extras.bridges.mqtt import secret_of, split_address

if TYPE_CHECKING:
    from collections.abc import Callable

    from evpinn_ros.extras.bridges.databroker import DatabrokerFeed

PORT = 55555
AGAIN_S = 5.0  # before the next try
SAVE_S = 60.0


def vss(
    vehicle: VehicleOption,
    databroker: Annotated[str, typer.Option(help="HOST or HOST:PORT.")] = f"localhost:{PORT}",
    ca: Annotated[
        Path | None, typer.Option(help="Use TLS with this certificate authority.")
    ] = None,
    token_file: Annotated[
        Path | None, typer.Option(help="File with the token (JWT) of the databroker.")
    ] = None,
    state: KeptStateOption = None,
) -> None:
    """Learn a car from the signals of a KUKSA databroker, and write results to it.

    Example: evpinn vss --vehicle tesla_model_3_lr --databroker localhost:55555
    """
    # Imported here: other commands need neither the chain nor kuksa-client.
    from evpinn_ros.common.blas_threads import limit_blas_threads
    from evpinn_ros.core.estimation.estimator import EstimatorSettings
    from evpinn_ros.core.vehicle.files import load_vehicle
    from evpinn_ros.extras.bridges.car import BridgedCar
    from evpinn_ros.extras.bridges.databroker import DatabrokerFeed

    with optional_imports():
        from kuksa_client.grpc import VSSClient, VSSClientError
    limit_blas_threads()
    token = None if token_file is None else secret_of(token_file).strip()
    host, port = split_address(databroker, "--databroker", PORT)
    car = BridgedCar("vehicle", load_vehicle(vehicle), EstimatorSettings(), state)
    if car.problem is not None:
        note(f"evpinn: {car.problem}")
    at_stop(_end)
    try:
        while True:
            try:
                with VSSClient(host, port, token, ca) as client:
                    note(f"evpinn: {host}:{port}: connected")
                    _follow(DatabrokerFeed(client, car), car.save)
            except VSSClientError as error:
                note(f"evpinn: {host}:{port}: {error.error['message'] or error.error['reason']}")
            time.sleep(AGAIN_S)
    except KeyboardInterrupt:
        pass
    finally:
        car.save()


def _end(*_: object) -> None:
    """End at the first signal; a later one shall not interrupt the saving."""
    at_stop(lambda *_: None)
    raise KeyboardInterrupt


def _follow(feed: DatabrokerFeed, save: Callable[[], None]) -> None:
    """Follow the signals until the databroker goes; save now and then."""
    saved, noted = time.monotonic(), False
    for _ in feed.run():
        if feed.missing and not noted:
            note(f"evpinn: without the overlay of evpinn: {', '.join(sorted(feed.missing))}")
            noted = True
        if time.monotonic() - saved > SAVE_S:
            save()
            saved = time.monotonic()
