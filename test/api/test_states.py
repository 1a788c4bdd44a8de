"""Saved cars of every version: each is read with what it taught, or refused with what to do next.

`states/` holds one of each version of the format, saved by the commit or release in its name
after 240 s of bags/urban. Arrays of refused versions are cut to three items, and the one that is
read lacks the weights of the network. A changed meaning needs a new version, and a file here.
"""

from pathlib import Path
import shutil

import pytest

import evpinn_ros as ev
from evpinn_ros.core.energy.account import EnergyAccount
from evpinn_ros.core.energy.meter import EnergyMeter
from evpinn_ros.core.energy.rknn import load_rknn
from evpinn_ros.core.estimation.estimator import EstimatorSettings, OnlineEstimator
from evpinn_ros.core.estimation.learner import STATE_VERSION
from evpinn_ros.core.estimation.state_file import REMEDY, Half, account_path, refused_names
from evpinn_ros.core.estimation.worker import InlineWorker
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.saved_state import StateFile

STATES = Path(__file__).parent / "states"
CARS = sorted(path for path in STATES.glob("*.json") if ".energy" not in path.suffixes)
READ = [path for path in CARS if f"version_{STATE_VERSION}_" in path.name]
REFUSED = [path for path in CARS if path not in READ]
PLAN = {"t_s": [0, 15, 400, 420], "speed_mps": [0, 20, 20, 0], "elevation_m": [0, 0, 60, 60]}
FORECASTS = {"version_11_6c885a15.json": (5.826e6, 0.628e6)}
"""Energy of `PLAN` and its 1-sigma, J, by the code that saved the state."""
VEHICLE, DRIVEN = "tesla_model_3_lr", 0.810e6  # J that the drive took, net


@pytest.fixture(params=CARS, ids=lambda path: path.stem)
def saved(request, tmp_path):
    """A copy of a saved car, with the account that earlier versions kept beside it."""
    path = tmp_path / request.param.name
    copies = {request.param: path, account_path(request.param): account_path(path)}
    for source, target in copies.items():
        if source.exists():
            shutil.copyfile(source, target)
    return path


def test_every_version_has_a_state_and_one_is_read():
    versions = {int(path.name.split("_")[1]) for path in CARS}
    assert versions == {*range(1, STATE_VERSION + 1)}
    assert FORECASTS.keys() == {path.name for path in READ}


def test_a_saved_car_forecasts_as_before_or_is_refused_with_what_to_do(saved):
    if saved.name not in FORECASTS:
        with pytest.raises(ev.InputError, match="saved for version ") as refused:
            ev.Estimator(VEHICLE, state=saved)
        assert str(refused.value).endswith(REMEDY) and str(refused.value).startswith(str(saved))
        return
    estimator = ev.Estimator(VEHICLE, state=saved)
    end = ev.forecast(PLAN, estimator).iloc[-1]
    energy, sigma = FORECASTS[saved.name]
    assert end.energy_j == pytest.approx(energy, rel=0.03)
    assert end.sigma_j == pytest.approx(sigma, rel=0.1)
    parameters = estimator.parameters
    assert parameters["value"].between(parameters["lower"], parameters["upper"]).all()
    priors = load_vehicle(VEHICLE).priors
    for name, row in parameters.iterrows():
        assert abs(row["value"] - priors[name].value) < 4.0 * priors[name].std, name


def test_a_node_goes_on_with_what_it_can_read_and_keeps_the_file(saved):
    """The energy of a car whose learned half is refused counts on."""
    car = load_vehicle(VEHICLE)
    account = EnergyAccount(EnergyMeter(load_rknn()), car.key, car.battery_capacity)
    energy = StateFile(saved, account, Half.ENERGY)
    learned = StateFile(
        saved, OnlineEstimator(car, EstimatorSettings(), InlineWorker(lambda: 0.0)), Half.LEARNED
    )
    for half in (energy, learned):
        half.restore()
        half.release()
    if saved.name in FORECASTS:
        assert learned.problem is None and learned.start is not None
    else:
        assert "saved for version " in learned.problem
        assert learned.problem.endswith(f"the file is kept as {refused_names(saved)[0].name}")
        assert learned.save() is None and refused_names(saved)[0].is_file()
    if energy.start is not None:
        assert account.summary().lifetime.net.value == pytest.approx(DRIVEN, rel=0.01)
    assert (energy.start is None) == (saved.name < "version_10"), energy.problem


@pytest.mark.parametrize(
    "content",
    ["", "{", '{"learned": 1}', '{"learned": {}}', "[]", '{"learned": {"version": 1e999}}'],
)
def test_damage_is_refused_with_what_to_do(tmp_path, content):
    path = tmp_path / "car.json"
    path.write_text(content)
    with pytest.raises(ev.InputError) as refused:
        ev.Estimator(VEHICLE, state=path)
    assert str(refused.value).endswith(REMEDY)


def test_a_file_that_is_not_there_is_refused_with_what_writes_it(tmp_path):
    with pytest.raises(ev.InputError, match=r"no such file; a replay .* writes it$"):
        ev.Estimator(VEHICLE, state=tmp_path / "car.json")
