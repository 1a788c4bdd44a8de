"""`evpinn vss`: learns a car from the signals of a KUKSA databroker."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import math
from pathlib import Path
import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evpinn_ros.cli.console import note
from evpinn_ros.cli.options import KeptStateOption, VehicleOption
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.common.optional import optional_imports
from evpinn_ros.common.stopping import at_stop
from evpinn_ros.common.units import KMH
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.bridges.car import BridgedCar
from evpinn_ros.extras.bridges.layouts import PERCENT, Measurand, Parsed, Rule, Value
from evpinn_ros.extras.bridges.mqtt import secret_of, split_address
from evpinn_ros.extras.bridges.sensors import number_at
from evpinn_ros.extras.bridges.snapshot import Snapshots, is_due
from evpinn_ros.replays.energy_metrics import MEANINGS

if TYPE_CHECKING:
    from kuksa_client.grpc import VSSClient

BATTERY = "Vehicle.Powertrain.TractionBattery"
OURS = "Vehicle.EvPinn"
INPUTS: Mapping[str, Rule] = {
    "Vehicle.Speed": Rule(Measurand.SPEED, KMH),
    f"{BATTERY}.CurrentVoltage": Rule(Measurand.VOLTAGE),
    f"{BATTERY}.CurrentCurrent": Rule(Measurand.CURRENT),
    f"{BATTERY}.StateOfCharge.Current": Rule(Measurand.CHARGE, PERCENT),
    "Vehicle.Exterior.AirTemperature": Rule(Measurand.TEMPERATURE),
    "Vehicle.CurrentLocation.Altitude": Rule(Measurand.ALTITUDE),
}
OUTPUTS: Mapping[str, tuple[str, ...]] = {
    f"{BATTERY}.Range": ("range", "range_km"),
    f"{OURS}.RangeLower": ("range", "lower_km"),
    f"{OURS}.RangeUpper": ("range", "upper_km"),
    f"{OURS}.PredictedPower": ("power", "predicted_w"),
    f"{OURS}.PredictedPowerSigma": ("power", "predicted_sigma_w"),
    f"{OURS}.TripEnergy": ("energy", "trip_kwh"),
    f"{OURS}.Consumption": ("consumption", "10"),
    **{
        f"{OURS}.Breakdown.{part.capitalize()}": ("breakdown", part, "kwh")
        for part in MEANINGS
        if part != "measured"
    },
    **{
        f"{OURS}.Combination.{name}": ("parameters", "combinations", key, "value")
        for name, key in {
            "MassOverEfficiency": "mass_over_eta",
            "DragAreaOverEfficiency": "drag_area_over_eta",
            "RollingResistance": "c_rr",
            "Regeneration": "regeneration",
            "StandingLoad": "p_aux",
        }.items()
    },
}
"""Keys in the documents of a car for each written signal."""
METRES = {f"{BATTERY}.Range", f"{OURS}.RangeLower", f"{OURS}.RangeUpper"}  # integers, from km
OLD_NS = 10 * NANOSECONDS  # age of initial values from a databroker
SEND_NS = NANOSECONDS  # between sets of written signals
NOT_FOUND = 5  # of gRPC: the databroker has no such signal


def signals(car: BridgedCar) -> Iterator[tuple[str, float]]:
    """Known signals of a car: name in VSS and value."""
    documents = {**car.documents(), "power": car.power()}
    for name, path in OUTPUTS.items():
        number = number_at(documents, path)
        if number is not None:
            yield name, round(1e3 * number) if name in METRES else float(number)


class DatabrokerFeed:
    """Feeds a car from a KUKSA databroker, and writes results back."""

    def __init__(
        self, client: VSSClient, car: BridgedCar, clock: Callable[[], int] = time.time_ns
    ) -> None:
        self._client, self._car, self._clock = client, car, clock
        self._snapshots = Snapshots(car.vehicle.nominal_voltage, on_change=False)
        self._sent_ns = 0
        self.missing: set[str] = set()  # signals that the databroker does not know

    def run(self) -> Iterator[None]:
        """Receives updates and sends due signals; yields after each update; or VSSClientError."""
        for number, updates in enumerate(self._client.subscribe_current_values(INPUTS)):
            # The first update may have old values; later, an age only shows an error of clocks.
            self._take(updates, OLD_NS if number == 0 else None)
            newest_ns = self._car.newest_ns
            if newest_ns is not None and is_due(self._sent_ns, newest_ns, SEND_NS):
                self._sent_ns = newest_ns
                self.send()
            yield

    def _take(self, updates: Mapping[str, Any], oldest_ns: int | None) -> None:
        """Add values of one moment together: voltage and current give one power."""
        now_ns = self._clock()
        moments: dict[int, dict[Measurand, Value]] = {}
        for name, point in updates.items():
            value = Value() if point is None else INPUTS[name].value(point.value)
            if math.isnan(value.value):
                continue
            moment = point.timestamp
            stamp_ns = now_ns if moment is None else round(moment.timestamp() * NANOSECONDS)
            if oldest_ns is None or now_ns - stamp_ns <= oldest_ns:
                moments.setdefault(stamp_ns, {})[INPUTS[name].quantity] = value
        for stamp_ns, values in sorted(moments.items()):
            parsed = Parsed(self._car.name, values, stamp_ns)
            self._car.add_readings(self._snapshots.add(parsed, now_ns, retained=False))

    def send(self) -> None:
        """Write all known signals."""
        with optional_imports():
            from kuksa_client import grpc as kuksa

        for name, value in signals(self._car):
            if name in self.missing:
                continue
            kind = kuksa.DataType.UINT32 if name in METRES else kuksa.DataType.FLOAT
            # With a given type, the client does not ask the databroker for it each time.
            entry = kuksa.DataEntry(name, kuksa.Datapoint(value), metadata=kuksa.Metadata(kind))
            update = kuksa.EntryUpdate(entry, (kuksa.Field.VALUE,))
            try:
                self._client.set(updates=[update], try_v2=True)
            except kuksa.VSSClientError as error:
                if error.error["code"] != NOT_FOUND:
                    raise
                self.missing.add(name)


PORT = 55555
AGAIN_S = 5.0  # s before the next try
SAVE_S = 60.0


def vss(
    vehicle: VehicleOption,
    databroker: Annotated[
        str, typer.Option(help="Address of the databroker, HOST or HOST:PORT.")
    ] = f"localhost:{PORT}",
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
    """End at the first signal; a later one does not interrupt saving."""
    at_stop(lambda *_: None)
    raise KeyboardInterrupt


def _follow(feed: DatabrokerFeed, save: Callable[[], None]) -> None:
    """Follow the signals until the databroker disconnects; save regularly."""
    saved, noted = time.monotonic(), False
    for _ in feed.run():
        if feed.missing and not noted:
            note(f"evpinn: not in the databroker's VSS: {', '.join(sorted(feed.missing))}")
            noted = True
        if time.monotonic() - saved > SAVE_S:
            save()
            saved = time.monotonic()
