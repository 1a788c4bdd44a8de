"""The bridge with a real mosquitto: drives in, energy out, and all that goes wrong between."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import count
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.bridges.bridge import MOST_CARS, BridgeSettings, MqttBridge
from evpinn_ros.extras.bridges.broker import IN_FLIGHT, BrokerSettings, Connection
from evpinn_ros.extras.bridges.layouts import read_layout
from evpinn_ros.extras.bridges.mqtt import credentials, split_address
from test.extras.bridges.published_topics import VEHICLE, as_ovms, as_teslamate, drive, energy
from test.waiting import wait_until

pytestmark = pytest.mark.slow

Make = Callable[..., tuple[MqttBridge, Connection]]
Sets = Iterable[tuple[int, dict[str, str]]]
EVERYTHING = ("evpinn/#", "homeassistant/#")
SECONDS = 120  # of the drive


class Clock:
    """A clock that goes as the drive that is published."""

    def __init__(self):
        self.now_ns = drive()[0].stamp_ns

    def __call__(self):
        return self.now_ns


def settings(layout, **of):
    given = {"vehicles": {}, "other": load_vehicle(VEHICLE), "estimator": EstimatorSettings()}
    return BridgeSettings(layout, **{**given, **of})


def play(sets, client, bridge, connection, clock):
    """Publish a drive as fast as the broker passes it on, each second at its moment."""
    for stamp_ns, messages in sets:
        clock.now_ns = stamp_ns
        for topic, payload in messages.items():
            client.client.publish(topic, payload, 1, True)
        for _ in messages:
            wait_until(lambda: bridge.step(0.05), meanwhile=lambda: None)
        clock.now_ns += 500_000_000
        bridge.step(0.0)
        step_until(bridge, lambda: nothing_is_held_back(connection))


def nothing_is_held_back(connection):
    """Of what a slow broker has not taken, the newest of each topic alone remains."""
    return connection.waiting < IN_FLIGHT


def step_until(bridge, condition):
    """Let a bridge work until something is so."""

    wait_until(condition, meanwhile=lambda: bridge.step(0.001))


def finish(bridge, connection):
    bridge.close()
    wait_until(lambda: connection.send() or not connection.waiting)


@pytest.mark.parametrize(
    ("layout", "sets", "car", "digits", "error"),
    [("teslamate", as_teslamate, "1", 0, 1e-6), ("ovms", as_ovms, "CAR", None, 1e-4)],
    ids=["teslamate", "ovms"],
)
def test_a_drive_over_the_broker_has_its_energy(broker, bridged, layout, sets, car, digits, error):
    clock = Clock()
    bridge, connection = bridged(settings(read_layout(layout)), clock)
    reader, writer = broker.client(topics=("evpinn/#",)), broker.client()
    play(sets(seconds=SECONDS), writer, bridge, connection, clock)
    finish(bridge, connection)
    broker.settle(reader, "evpinn/end")
    published = json.loads(reader.newest()[f"evpinn/{car}/energy"])
    assert published["trip_kwh"] == pytest.approx(
        energy(drive(seconds=SECONDS), digits), rel=error
    )
    scalar = float(reader.newest()[f"evpinn/{car}/energy/trip_kwh"])
    assert scalar == pytest.approx(published["trip_kwh"], abs=5e-4)
    assert reader.newest()["evpinn/status"] == "online"
    parameters = json.loads(reader.newest()[f"evpinn/{car}/parameters"])
    assert parameters["mass"]["state"] in ("estimating", "valid")
    assert {"kwh", "share"} <= json.loads(reader.newest()[f"evpinn/{car}/breakdown"])["air"].keys()
    powers = [json.loads(p) for t, p, _ in reader.came if t == f"evpinn/{car}/power"]
    assert len(powers) > 0.8 * SECONDS, "once a second"
    late = broker.client(topics=("evpinn/#",))
    broker.settle(late, "evpinn/end")
    assert f"evpinn/{car}/power" not in late.newest(), "an old power is of no use"
    assert f"evpinn/{car}/parameters" in late.newest()


def test_a_broker_that_was_killed_finds_us_back_with_all_that_is_retained(broker, bridged):
    clock = Clock()
    bridge, connection = bridged(settings(read_layout("teslamate")), clock)
    writer = broker.client()
    drive_sets = list(as_teslamate(seconds=90))
    play(drive_sets[:60], writer, bridge, connection, clock)
    before = bridge.cars["1"].documents()["energy"]["trip_kwh"]
    broker.kill()
    writer.close()
    step_until(bridge, lambda: not connection.connected)
    for _ in range(50):
        clock.now_ns += 1_000_000_000
        bridge.step(0.0)
    assert connection.waiting < 100, "of each topic one payload waits"
    broker.start()
    step_until(bridge, lambda: connection.connections == 2)
    step_until(bridge, lambda: not connection.waiting)
    reader, writer = broker.client(topics=EVERYTHING), broker.client()
    wait_until(lambda: "evpinn/1/parameters" in reader.newest())
    assert any(topic.startswith("homeassistant/sensor/") for topic in reader.newest())
    assert reader.newest()["evpinn/status"] == "online"
    play(drive_sets[60:], writer, bridge, connection, clock)
    assert bridge.cars["1"].documents()["energy"]["trip_kwh"] > before


def test_a_process_that_is_killed_leaves_its_last_will(broker, tmp_path):
    reader = broker.client(topics=("evpinn/status",))
    process = command(broker)
    wait_until(lambda: reader.newest().get("evpinn/status") == "online")
    process.kill()
    process.wait()
    wait_until(lambda: reader.newest()["evpinn/status"] == "offline")


def test_home_assistant_that_starts_is_told_anew(broker, bridged):
    bridge, connection = bridged(settings(read_layout("teslamate")))
    reader, writer = broker.client(topics=("homeassistant/sensor/#",)), broker.client()
    writer.publish("teslamate/cars/1/speed", "36")
    step_until(bridge, lambda: len(reader.came) >= 28)
    step_until(bridge, lambda: not connection.waiting)
    first = len(reader.newest())
    reader.came.clear()
    writer.publish("homeassistant/status", "online", retain=False)
    step_until(bridge, lambda: len(reader.newest()) >= first)


def test_a_slow_broker_gets_the_newest_and_no_more(broker, bridged):
    _, connection = bridged(settings(read_layout("teslamate")))
    reader = broker.client(topics=("slow/#",))
    wait_until(lambda: not connection.waiting)
    broker.process.send_signal(signal.SIGSTOP)
    for i in range(5000):
        connection.publish(f"slow/{i % 10}", str(i))
    assert connection.waiting <= 30
    broker.process.send_signal(signal.SIGCONT)
    wait_until(lambda: connection.send() or not connection.waiting)
    broker.settle(reader, "slow/end")
    assert reader.newest() == {f"slow/{i}": str(4990 + i) for i in range(10)}
    assert len(reader.came) <= 40


def command(broker, *options, **environment):
    words = ("--vehicle", VEHICLE, "--broker", f"127.0.0.1:{broker.port}", *map(str, options))
    return subprocess.Popen(
        [sys.executable, "-m", "evpinn_ros", "mqtt", *words],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )


PASSWORD = "kW-5ecret"


@pytest.fixture
def closed(broker):
    """A broker that lets in `ev` with its password alone."""
    users = broker.folder / "users"
    tool = shutil.which("mosquitto_passwd")
    if tool is None:
        pytest.skip("mosquitto_passwd")
    subprocess.run([tool, "-b", "-c", users, "ev", PASSWORD], check=True, capture_output=True)
    users.chmod(0o644)
    broker.kill()
    broker.lines = f"allow_anonymous false\npassword_file {users}\n"
    broker.start()
    return broker


def test_a_wrong_password_is_one_line_and_ends_the_command(closed):
    process = command(closed, "--user", "ev", EVPINN_MQTT_PASSWORD="wrong-one")
    _, said = process.communicate(timeout=60)
    assert process.returncode == 1
    assert said.splitlines()[-1].startswith(f"evpinn: mqtt://127.0.0.1:{closed.port}: refused: ")
    assert "wrong-one" not in said and "Traceback" not in said


def test_the_right_password_from_a_file_is_in_no_list_of_processes(closed, tmp_path):
    file = tmp_path / "password"
    file.write_text(PASSWORD + "\n")
    process = command(closed, "--user", "ev", "--password-file", file)
    assert process.stderr.readline().strip().endswith(": connected")
    words = Path(f"/proc/{process.pid}/cmdline").read_bytes()
    assert PASSWORD.encode() not in words
    process.terminate()
    _, said = process.communicate(timeout=60)
    assert process.returncode == 0 and PASSWORD not in said


def certificates(folder):
    """An authority, and certificates of a broker and of a client by it."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl")

    def run(*words):
        subprocess.run([openssl, *words], cwd=folder, check=True, capture_output=True)

    key = ("-newkey", "rsa:2048", "-nodes", "-keyout")
    run("req", "-x509", *key, "ca.key", "-out", "ca.pem", "-subj", "/CN=ca", "-days", "2")
    (folder / "names").write_text("subjectAltName=IP:127.0.0.1\n")
    for name, serial in zip(("broker", "client"), count(1), strict=False):
        run("req", *key, f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}")
        by = ("-CA", "ca.pem", "-CAkey", "ca.key", "-set_serial", str(serial), "-days", "2")
        run("x509", "-req", "-in", f"{name}.csr", *by, "-out", f"{name}.pem", "-extfile", "names")
    for path in folder.iterdir():
        path.chmod(0o644)


def test_tls_with_a_certificate_of_the_client(broker, tmp_path):
    certificates(tmp_path)
    broker.kill()
    broker.lines = (
        f"allow_anonymous true\ncafile {tmp_path}/ca.pem\ncertfile {tmp_path}/broker.pem\n"
        f"keyfile {tmp_path}/broker.key\nrequire_certificate true\n"
    )
    broker.start()

    def connections(until, **of):
        settings = BrokerSettings("127.0.0.1", broker.port, tls=True, **of)
        connection = Connection(settings, ("a",), "evpinn/status")
        connection.start()
        wait_until(lambda: until(connection), report=broker.log.read_text)
        connection.close()
        return connection.connections

    def refused(why):
        return lambda _: why in broker.log.read_text()

    own = {"certificate": f"{tmp_path}/client.pem", "key": f"{tmp_path}/client.key"}
    connected = connections(lambda c: c.connections, ca=f"{tmp_path}/ca.pem", **own)
    assert connected == 1
    without_one = refused("peer did not return a certificate")
    assert connections(without_one, ca=f"{tmp_path}/ca.pem") == 0
    assert connections(refused("alert unknown ca"), **own) == 0
    with pytest.raises(InputError, match=r"none\.pem: No such file"):
        connections(bool, ca=f"{tmp_path}/none.pem")


def test_the_command_learns_from_a_mapping_file_and_keeps_it(broker, tmp_path):
    """Payloads with stamps of their own: two minutes of a drive in seconds."""
    (tmp_path / "topics.yaml").write_text(
        "stamp: t\ntopics:\n  my/{car}:\n    fields:\n"
        "      kmh: {quantity: speed, scale: 0.2777777777777778}\n"
        "      kw: {quantity: power, scale: 1000}\n"
    )
    state = tmp_path / "cars"
    process = command(broker, "--source", tmp_path / "topics.yaml", "--state", state)
    reader, writer = broker.client(topics=("evpinn/#",)), broker.client()
    wait_until(lambda: reader.newest().get("evpinn/status") == "online")
    sent = drive(seconds=SECONDS)
    for s in sent:
        payload = json.dumps({"t": s.stamp_ns / 1e9, "kmh": s.speed, "kw": s.power})
        writer.client.publish("my/zoe", payload, 1)

    def newest_s():
        return json.loads(reader.newest().get("evpinn/zoe/power", "{}")).get("time") or 0.0

    wait_until(lambda: newest_s() > sent[-1].stamp_ns / 1e9 - 1.0)
    process.send_signal(signal.SIGHUP)  # its terminal was closed
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 0 and "Traceback" not in said, said
    wait_until(lambda: reader.newest()["evpinn/status"] == "offline")
    published = json.loads(reader.newest()["evpinn/zoe/energy"])
    assert published["trip_kwh"] == pytest.approx(energy(sent), rel=1e-4)
    assert {p.name for p in state.iterdir()} == {"zoe.json"}
    assert json.loads((state / "zoe.json").read_text()).keys() == {"learned", "energy"}
    layout = read_layout(str(tmp_path / "topics.yaml"))
    assert layout.subscriptions == ("my/+",)


def test_what_would_show_a_password_is_no_address():
    for text in ("ev:secret@host", "mqtt://host", "host:x", "host:0", ":1883"):
        with pytest.raises(InputError) as refused:
            split_address(text, "--broker", 1883)
        assert "secret" not in str(refused.value)
    assert split_address("host", "--broker", 8883) == ("host", 8883)
    assert split_address("[::1]:1884", "--broker", 1883) == ("::1", 1884)
    assert "secret" not in repr(BrokerSettings("host", password="secret"))


def test_a_password_comes_from_the_environment_and_wants_a_user(monkeypatch):
    monkeypatch.setenv("EVPINN_MQTT_PASSWORD", "p")
    monkeypatch.setenv("EVPINN_MQTT_USER", "u")
    assert credentials(None, None) == ("u", "p")
    monkeypatch.delenv("EVPINN_MQTT_USER")
    with pytest.raises(InputError, match="a password without a user"):
        credentials(None, None)


def test_cars_that_somebody_invents_keep_no_named_one_out(broker, bridged):
    """Retained topics of cars that do not send are no cars; a named one has its place."""
    writer = broker.client()
    for name in map(str, range(100, 140)):
        writer.publish(f"teslamate/cars/{name}/battery_level", "50")
    named = {"7": load_vehicle(VEHICLE)}
    given = settings(read_layout("teslamate"), vehicles=named)
    bridge, _ = bridged(given)
    writer.publish("teslamate/cars/7/battery_level", "60", retain=False)
    step_until(bridge, lambda: "7" in bridge.cars)
    assert [*bridge.cars] == ["7"]
    for name in map(str, range(100, 140)):
        writer.publish(f"teslamate/cars/{name}/speed", "0", retain=False)
    step_until(bridge, lambda: len(bridge.ignored) == MOST_CARS)
    assert len(bridge.cars) == MOST_CARS


def test_a_second_user_with_the_same_vehicle_id_is_another_car(broker, bridged):
    bridge, _ = bridged(settings(read_layout("ovms")))
    writer = broker.client()
    writer.publish("ovms/ann/CAR/metric/v/b/soc", "80", retain=False)
    step_until(bridge, lambda: bridge.cars)
    writer.publish("ovms/bob/CAR/metric/v/b/soc", "20", retain=False)
    step_until(bridge, lambda: bridge.ignored)
    assert [*bridge.cars] == ["CAR"] and bridge.ignored == {"CAR"}
