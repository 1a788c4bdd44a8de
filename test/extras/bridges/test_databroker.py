"""VSS: the overlay by vss-tools, and a databroker's interface by its public protocol.

No databroker was found in PyPI, Debian or npm, so the server here answers by the services that
kuksa-client has generated from the databroker's .proto files; the client is the real one.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import json
from pathlib import Path
import queue
import signal
import subprocess
import sys
import time
from typing import Any

import pytest

from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.bridges.car import BridgedCar
from evpinn_ros.extras.bridges.vss import INPUTS, METRES, OUTPUTS, DatabrokerFeed, signals
from test.extras.bridges.published_topics import VEHICLE, drive, energy
from test.waiting import wait_until

pytestmark = pytest.mark.slow

OVERLAY = Path(__file__).resolve().parents[3] / "config" / "vss" / "evpinn.vspec"
BATTERY = "Vehicle.Powertrain.TractionBattery"

# The part of VSS that the bridge uses: names, types and units as in its repository.
VSS = {
    "Vehicle": None,
    "Vehicle.Speed": ("float", "km/h"),
    "Vehicle.Exterior": None,
    "Vehicle.Exterior.AirTemperature": ("float", "Celsius"),
    "Vehicle.CurrentLocation": None,
    "Vehicle.CurrentLocation.Altitude": ("double", "m"),
    "Vehicle.Powertrain": None,
    BATTERY: None,
    f"{BATTERY}.CurrentVoltage": ("float", "V"),
    f"{BATTERY}.CurrentCurrent": ("float", "A"),
    f"{BATTERY}.StateOfCharge": None,
    f"{BATTERY}.StateOfCharge.Current": ("float", "percent"),
    f"{BATTERY}.Range": ("uint32", "m"),
}
UNITS = {
    **{"km/h": "velocity", "Celsius": "temperature", "m": "length", "V": "voltage"},
    **{"A": "electric-current", "percent": "relation", "W": "power", "kWh": "work"},
    **{"kWh/100km": "energy-consumption-per-distance", "kg": "mass"},
}


def write_vss(folder):
    lines = []
    for name, of in VSS.items():
        lines += [f"{name}:", f"  type: {'branch' if of is None else 'sensor'}"]
        lines += [] if of is None else [f"  datatype: {of[0]}", f"  unit: {of[1]}"]
        lines += ["  description: As in VSS.", ""]
    path = folder / "base.vspec"
    path.write_text("\n".join(lines))
    (folder / "units.yaml").write_text(
        "".join(
            f"{unit}:\n  definition: d\n  unit: one {unit}\n  quantity: {of}\n"
            "  allowed-datatypes: ['numeric']\n"
            for unit, of in UNITS.items()
        )
    )
    (folder / "quantities.yaml").write_text(
        "".join(f"{of}:\n  definition: d\n" for of in sorted(set(UNITS.values())))
    )
    return path


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """All signals with the overlay, as vss-tools has them, strictly."""
    pytest.importorskip("vss_tools")
    folder = tmp_path_factory.mktemp("vss")
    out = folder / "vss.json"
    command = ("export", "json", "-s", write_vss(folder), "-l", OVERLAY, "-o", out, "--strict")
    run = "import sys; from vss_tools.cli import cli; sys.exit(cli())"
    ended = subprocess.run(
        [sys.executable, "-c", run, *map(str, command)], capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    entries: dict[str, dict[str, str]] = {}

    def walk(name, node):
        entries[name] = node
        for child, below in node.get("children", {}).items():
            walk(f"{name}.{child}", below)

    walk("Vehicle", json.loads(out.read_text())["Vehicle"])
    return entries


def test_vss_tools_accepts_the_overlay_and_has_each_signal_of_ours(tree):
    assert INPUTS.keys() | OUTPUTS.keys() <= tree.keys()
    ours = {name for name, node in tree.items() if "EvPinn" in name and node["type"] != "branch"}
    assert ours == {name for name in OUTPUTS if "EvPinn" in name}, "each is written"
    for name in OUTPUTS:
        assert tree[name]["datatype"] == ("uint32" if name in METRES else "float"), name


kuksa = pytest.importorskip("kuksa_client.grpc")
grpc = pytest.importorskip("grpc")
v1 = pytest.importorskip("kuksa.val.v1.val_pb2")
v1_grpc = pytest.importorskip("kuksa.val.v1.val_pb2_grpc")
types_pb2 = pytest.importorskip("kuksa.val.v2.types_pb2")
v2 = pytest.importorskip("kuksa.val.v2.val_pb2")
v2_grpc = pytest.importorskip("kuksa.val.v2.val_pb2_grpc")


class Databroker(v2_grpc.VALServicer, v1_grpc.VALServicer):
    """Signals that are known: values come in by `feed`, and by clients into `written`."""

    def __init__(self, known):
        self.known, self.written = known, {}
        self.values: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self.asked: set[str] = set()

    def feed(self, stamp_ns, **values):
        entries = {}
        for name, value in values.items():
            point = types_pb2.Datapoint(value=types_pb2.Value(float=value))
            point.timestamp.FromNanoseconds(stamp_ns)
            entries[name] = point
        self.values.put(entries)

    def GetServerInfo(self, request, context):
        return v1.GetServerInfoResponse(name="test", version="0")

    def Subscribe(self, request, context):
        self.asked = set(request.signal_paths)
        if not self.asked <= self.known:
            context.abort(grpc.StatusCode.NOT_FOUND, "no such signal")
        while (entries := self.values.get()) is not None:
            yield v2.SubscribeResponse(entries=entries)

    def PublishValue(self, request, context):
        name = request.signal_id.path
        if name not in self.known:
            context.abort(grpc.StatusCode.NOT_FOUND, name)
        value = request.data_point.value
        self.written[name] = getattr(value, value.WhichOneof("typed_value"))
        return v2.PublishValueResponse()


@pytest.fixture
def served(request):
    databroker = Databroker(set(getattr(request, "param", INPUTS.keys() | OUTPUTS.keys())))
    server = grpc.server(ThreadPoolExecutor(4))
    v2_grpc.add_VALServicer_to_server(databroker, server)
    v1_grpc.add_VALServicer_to_server(databroker, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield databroker, port
    databroker.values.put(None)
    server.stop(None)


SECONDS = 60  # of the drive


def feed_drive(broker, seconds=SECONDS):
    for s in drive()[:seconds]:
        broker.feed(
            s.stamp_ns,
            **{
                "Vehicle.Speed": s.speed,
                f"{BATTERY}.CurrentVoltage": s.voltage,
                f"{BATTERY}.CurrentCurrent": -s.current,
                f"{BATTERY}.StateOfCharge.Current": 80.0,
            },
        )
    broker.values.put(None)


def follow(broker, port, clock):
    car = BridgedCar("vehicle", load_vehicle(VEHICLE), EstimatorSettings())
    with kuksa.VSSClient("127.0.0.1", port) as client:
        feed = DatabrokerFeed(client, car, clock)
        for _ in feed.run():
            pass
        feed.send()
    return car, feed


def test_a_drive_from_a_databroker_has_its_energy_and_goes_back_by_names(served):
    broker, port = served
    feed_drive(broker)
    car, feed = follow(broker, port, lambda: drive()[0].stamp_ns)
    assert broker.asked == set(INPUTS)
    trip = car.documents()["energy"]["trip_kwh"]
    expected = energy(drive()[:SECONDS])
    assert trip == pytest.approx(expected, rel=1e-4), "current into the battery is positive"
    assert broker.written["Vehicle.EvPinn.TripEnergy"] == pytest.approx(trip, rel=1e-6)
    mass = broker.written["Vehicle.EvPinn.Combination.MassOverEfficiency"]
    assert 1800 < mass < 2700
    assert feed.missing == set()
    assert broker.written.keys() == dict(signals(car)).keys()


@pytest.mark.parametrize("served", [INPUTS.keys() | {f"{BATTERY}.Range"}], indirect=True)
def test_a_databroker_without_the_overlay_is_served_what_it_knows(served):
    broker, port = served
    feed_drive(broker, seconds=20)
    _, feed = follow(broker, port, lambda: drive()[0].stamp_ns)
    assert feed.missing and all("EvPinn" in name for name in feed.missing)


def test_the_command_follows_a_databroker_and_saves(served, tmp_path):
    broker, port = served
    state = tmp_path / "car.json"
    words = ("--vehicle", VEHICLE, "--databroker", f"127.0.0.1:{port}", "--state", str(state))
    process = subprocess.Popen(
        [sys.executable, "-m", "evpinn_ros", "vss", *words], stderr=subprocess.PIPE, text=True
    )
    assert process.stderr.readline().endswith(": connected\n")
    begin = time.time_ns()
    for i in range(20):
        broker.feed(begin + i * 200_000_000, **{"Vehicle.Speed": 36.0 + i})
    wait_until(lambda: "Vehicle.EvPinn.PredictedPower" in broker.written)
    process.send_signal(signal.SIGHUP)  # its terminal was closed
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 0 and state.exists() and "Traceback" not in said, said
