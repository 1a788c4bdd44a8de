"""A car behind a bridge: the same energy as was sent, its drives, its files."""

import math

import pytest

from evpinn_ros.core.estimation.estimator import EstimatorSettings
from evpinn_ros.core.estimation.state_file import StateClaim
from evpinn_ros.core.estimation.states import State
from evpinn_ros.core.signals.readings import SpeedReading
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.extras.bridges.car import BridgedCar
from evpinn_ros.extras.bridges.layouts import read_layout
from evpinn_ros.extras.bridges.sensors import SENSORS
from evpinn_ros.extras.bridges.snapshot import Snapshots
from test.extras.bridges.published_topics import VEHICLE, as_ovms, as_teslamate, drive, energy

SECOND = 1_000_000_000


def car(state=None):
    return BridgedCar("1", load_vehicle(VEHICLE), EstimatorSettings(), state)


def send(to, layout, sets, shift_ns=0):
    """Messages become readings one by one, and these go on as a block, which takes a tenth."""
    snapshots, readings = Snapshots(to.vehicle.nominal_voltage, on_change=True), []
    for stamp_ns, messages in sets:
        for topic, payload in messages.items():
            parsed = layout.parse(topic, payload.encode())
            readings += snapshots.add(parsed, stamp_ns + shift_ns, retained=False)
    to.add_readings([*readings, *snapshots.flush(stamp_ns + shift_ns + SECOND)])


@pytest.fixture(scope="module")
def state(tmp_path_factory):
    return tmp_path_factory.mktemp("car") / "1.json"


@pytest.fixture(scope="module")
def tesla(state):
    """A car behind TeslaMate, after a drive; nothing is saved yet."""
    bridged = car(state)
    send(bridged, read_layout("teslamate"), as_teslamate())
    return bridged


@pytest.fixture(scope="module")
def ovms():
    """A car behind OVMS, whose numbers are not rounded, after that drive."""
    bridged = car()
    send(bridged, read_layout("ovms"), as_ovms())
    return bridged


def test_a_state_into_which_another_process_learns_is_not_written(tmp_path):
    path = tmp_path / "1.json"
    with StateClaim(path):
        bridged = car(path)
        send(bridged, read_layout("teslamate"), as_teslamate())
        bridged.save()
        assert "another evpinn learns into this file" in (bridged.problem or "")
    assert not path.exists()


def test_the_energy_of_whole_kilowatts_is_as_unsure_as_they_are(tesla, ovms):
    """By more than roundings of each second alone, and by less than one of all seconds."""
    coarse, fine = (of.documents()["energy"] for of in (tesla, ovms))
    error = abs(coarse["trip_kwh"] - energy(drive()))
    added = math.sqrt(coarse["trip_sigma_kwh"] ** 2 - fine["trip_sigma_kwh"] ** 2)
    seconds, rounding = len(drive()), 12**-0.5 / 3600  # kWh in a second
    assert seconds**0.5 * rounding < added < seconds * rounding
    assert error < 2 * coarse["trip_sigma_kwh"]


def test_whole_kilowatts_teach_what_exact_ones_do(tesla, ovms):
    """Within the sigma that either claims; a town tells little of drag and tyres.

    The load of a standing car is one number that is rounded, so it is less sure.
    """
    for name, coarse in tesla.documents()["parameters"]["combinations"].items():
        fine = ovms.documents()["parameters"]["combinations"][name]
        before = car().documents()["parameters"]["combinations"][name]
        assert abs(coarse["value"] - fine["value"]) < 2 * fine["std"], name
        most = 1.8 if name == "p_aux" else 1.2
        assert coarse["std"] < most * fine["std"], name
        if name in ("mass_over_eta", "regeneration", "p_aux"):
            assert coarse["std"] < 0.6 * before["std"], name


def test_each_sensor_finds_its_number(tesla):
    documents = {**tesla.documents(), "power": tesla.power()}
    texts = {s.topic: s.text(documents[s.document]) for s in SENSORS}
    unknown = {topic for topic, text in texts.items() if text == "None"}
    far = {"consumption/10", "consumption/100"}  # the drive has 2.6 km
    assert unknown == far | {"range/range_km", "range/lower_km", "range/upper_km"}
    assert float(texts["breakdown/measured/kwh"]) > 0.3


def test_a_long_stop_begins_another_drive_and_the_lifetime_goes_on(tmp_path):
    bridged = car(tmp_path / "1.json")
    send(bridged, read_layout("teslamate"), as_teslamate(seconds=120))
    first = bridged.documents()["energy"]
    send(bridged, read_layout("teslamate"), as_teslamate(seconds=120), shift_ns=3600 * SECOND)
    second = bridged.documents()["energy"]
    assert second["trip_kwh"] == pytest.approx(first["trip_kwh"], rel=0.05)
    assert second["drawn_kwh"] == pytest.approx(2 * first["drawn_kwh"], rel=0.05)
    assert (tmp_path / "1.json").exists(), "saved where a drive ends"


def test_one_wild_stamp_ends_no_drive():
    bridged, sets = car(), [*as_teslamate(seconds=60)]
    send(bridged, read_layout("teslamate"), sets[:30])
    before = bridged.documents()["energy"]["trip_km"]
    send(bridged, read_layout("teslamate"), sets[30:31], shift_ns=24 * 3600 * SECOND)
    send(bridged, read_layout("teslamate"), sets[31:])
    assert bridged.documents()["energy"]["trip_km"] > before > 0.0
    assert bridged.newest_ns == sets[-1][0]


def test_what_was_learned_outlives_the_process(tesla, state):
    tesla.save()
    before, after = tesla.documents(), car(state).documents()
    assert after["energy"]["drawn_kwh"] == pytest.approx(before["energy"]["drawn_kwh"])
    assert after["energy"]["trip_kwh"] == 0.0
    learned, restored, new = (
        document["parameters"]["combinations"]["mass_over_eta"]["std"]
        for document in (before, after, car().documents())
    )
    # What the next drive carries is not known: without it the car is as well known as before.
    load = State.MASS_DRIVE.std
    assert learned < 0.5 * new and restored**2 - load**2 < (0.6 * new) ** 2


def test_a_stamp_that_leapt_ahead_is_not_the_newest_for_ever():
    """A bridge that waits for it would publish no power until then."""
    bridged = car()
    stamps = [(1_700_000_000 + second) * SECOND for second in (0, 1, 50_000, 2, 3)]
    bridged.add_readings(SpeedReading(stamp_ns, 10.0) for stamp_ns in stamps)
    assert bridged.newest_ns == stamps[-1]
