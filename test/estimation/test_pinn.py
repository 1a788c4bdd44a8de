"""The online learner: what it predicts, what it owes, and what it takes of an update."""

from dataclasses import replace
import json
import math

import numpy as np
import pytest

from evpinn_ros.estimation.car_filter import CarFilter
from evpinn_ros.estimation.car_state import State
from evpinn_ros.estimation.energy_debt import CATCH_UP, EnergyDebt
from evpinn_ros.estimation.estimate import Trust
from evpinn_ros.estimation.gaussian import Gaussian
from evpinn_ros.estimation.pinn import PARKED, LearnedCar, PinnLearner
from evpinn_ros.estimation.weak_form import Warmth, spent
from evpinn_ros.signals.kinematics import PROFILE
from evpinn_ros.signals.readings import NANOSECONDS
from evpinn_ros.signals.sample import Sample
from evpinn_ros.simulation.drive import DriveKind

STEP = NANOSECONDS // 10


def sample(tick: int, speed=15.0, **others) -> Sample:
    values = {"profile": (0.0,) * PROFILE, **others}
    return Sample(tick * STEP, speed, 0.0, 0.0, 1.17, 0.0, **values)


@pytest.fixture(scope="module")
def town(vehicle, intervals):
    """Two minutes of a car like the prior, measured."""
    truth = CarFilter(vehicle)
    found = []
    for one in intervals((DriveKind.URBAN, 120.0, 0), begin_ns=0):
        drawn = spent(
            truth.state.mean[:1], one.steps, one.conditions, Warmth(1.0, 1.0), truth.constants
        )
        found.append(replace(one, energy=float(drawn.energy[0]), sampling_variance=0.0))
    return found


@pytest.fixture
def learner(vehicle, town) -> PinnLearner:
    found = PinnLearner(vehicle)
    for one in town:
        found.add_interval(one)
    assert found.consider(found.prepare_update()()) is None
    return found


def test_before_anything_no_parameter_is_estimated(vehicle):
    learner = PinnLearner(vehicle)
    states = {found.state for found in learner.parameters().parameters.values()}
    assert states == {Trust.UNESTIMATED} and not learner.parameters().reliable
    assert learner.prepare_update() is None
    assert learner.report() == (None, 0, 0, None)
    prediction = learner.predict(sample(0))
    assert prediction.sigma > 0.0 and math.isnan(prediction.energy)


def test_an_update_works_on_a_copy_and_a_snapshot(learner, town, vehicle):
    before = json.dumps(learner.export())
    learner.add_interval(town[0])
    work = learner.prepare_update()
    learner.add_interval(town[1])
    first, again = work(), work()
    assert json.dumps(learner.export()) == before
    assert np.array_equal(first.filter.state.mean, again.filter.state.mean)
    assert learner.consider(first) is None and json.dumps(learner.export()) != before
    assert learner.prepare_update() is not None, "the second interval still waits"
    assert learner.prepare_update() is None


def test_one_by_one_and_all_at_once_are_the_same(vehicle, town, learner):
    other = PinnLearner(vehicle)
    for one in town:
        other.add_interval(one)
        other.consider(other.prepare_update()())
    assert other.export() == learner.export()


def test_what_is_not_finite_or_of_a_drive_that_ended_is_not_taken(learner, town):
    learner.add_interval(town[0])
    candidate = learner.prepare_update()()
    mean, covariance = candidate.filter.state
    broken = candidate.after([])
    broken.filter.state = Gaussian(mean * math.nan, covariance)
    before = json.dumps(learner.export())
    assert learner.consider(broken) == "not_finite"
    assert json.dumps(learner.export()) == before
    # The car parks while the update is under way: it may not bring the last drive back.
    learner.advance(sample(0))
    learner.advance(sample(10 * round(PARKED) + 10))
    assert learner._car.filter.intervals == 0
    assert learner.consider(candidate) == "outdated"
    assert learner._car.filter.intervals == 0


@pytest.mark.parametrize(
    ("seconds", "same"),
    [(3.0, True), (-3.0, True), (-300.0, True), (900.0, False), (-900.0, False)],
)
@pytest.mark.parametrize("jumped", [True, False])
def test_a_clock_that_is_set_right_ends_no_drive(learner, seconds, same, jumped):
    """`jumped`: the stream saw the jump and had the window forgotten."""
    learner.advance(sample(20_000))
    before = learner.parameters().identifiable
    if jumped:
        learner.forget_window()
    learner.advance(sample(20_000 + round(10 * seconds)))
    assert (learner._car.filter.intervals > 0) == same
    after = learner.parameters().identifiable
    assert after.mass_over_eta == pytest.approx(before.mass_over_eta, rel=1e-9)


def test_the_breakdown_goes_on_over_a_long_stop_and_begins_with_another_drive(learner):
    """A log of some trips, with hours between them: its breakdown is of all of them."""
    learner.advance(sample(0))
    before = learner.breakdowns().of(-1)
    learner.advance(sample(10 * round(PARKED) + 10))
    assert learner._car.filter.intervals == 0
    assert learner.breakdowns().of(-1).energy == pytest.approx(before.energy)
    learner.end_drive()
    assert learner.breakdowns().of(-1) is None


def test_reverse_and_charging_teach_nothing(learner, town):
    before = json.dumps(learner.export()["filter"])
    steps = town[5].steps
    back = replace(town[5], steps=steps._replace(distance=-np.abs(steps.distance) - 1.0))
    still = replace(town[5], steps=steps._replace(distance=0 * steps.distance), energy=-6 * 7000.0)
    for one in (back, still):
        learner.add_interval(one)
    assert learner.consider(learner.prepare_update()()) is None
    assert learner.gated == {"reverse": 1, "charging": 1}
    assert json.dumps(learner.export()["filter"]) == before
    learner.observe(sample(1, speed=-2.0), 5000.0)
    learner.observe(sample(2, speed=0.0), -7000.0)
    assert learner.gated == {"reverse": 2, "charging": 2}


def test_the_debt_brings_the_integral_of_power_to_the_energy_of_the_intervals():
    """Published is 5 kW, the intervals say 6 kW; they come 10 s late, each of 6 s."""
    debt, published = EnergyDebt(), 0.0
    for tick in range(3000):
        published += (5000.0 + debt.repay(tick * STEP, 5000.0, 100.0)) / 10
        end = tick - 100
        if end > 0 and end % 60 == 0:
            debt.owe(0, end * STEP, 6000.0 * end / 10)
    # A thousand watts of ten seconds' lag and some of `CATCH_UP` stay owed.
    assert 0.0 < 6000.0 * 300 - published < 1000.0 * (10 + 6 + 2 * CATCH_UP)
    debt.owe(2999 * STEP, 2999 * STEP, 0.0)
    assert debt.repay(3000 * STEP, 5000.0, 100.0) == 0.0


def test_power_before_the_first_interval_of_a_dropout_is_not_owed():
    """Intervals in doubt are left out while the battery is measured; 40 kW went through them."""
    debt = EnergyDebt()
    for tick in range(200):
        debt.repay(tick * STEP, 40_000.0, 100.0)
    debt.owe(50 * STEP, 50 * STEP, 0.0)
    debt.owe(150 * STEP, 180 * STEP, 120_000.0)
    assert abs(debt.repay(200 * STEP, 40_000.0, 100.0)) < 1.0


def test_a_car_that_stands_is_as_unsure_of_what_it_drove_as_before():
    """What was published since the last interval counts with the sigma it had then."""
    debt = EnergyDebt()
    for tick in range(200):
        debt.repay(tick * STEP, 20_000.0, 1000.0 if tick < 100 else 50.0)
    assert debt.sigma_since(50 * STEP) == pytest.approx(49 * 100.0 + 100 * 5.0)
    assert debt.sigma_since(150 * STEP) == pytest.approx(49 * 5.0)


def test_a_silent_battery_gives_energy_with_a_sigma_and_its_return_ends_that(learner, town):
    silent = [
        replace(
            one,
            energy=math.nan,
            start_ns=one.start_ns + 200 * NANOSECONDS,
            end_ns=one.end_ns + 200 * NANOSECONDS,
        )
        for one in town
    ]
    learner.predict(sample(0))
    sigmas = []
    for one in silent:
        learner.add_interval(one)
        learner.consider(learner.prepare_update()())
        sigmas.append(learner.predict(sample(one.end_ns // STEP)).energy_sigma)
    total = learner.predict(sample(silent[-1].end_ns // STEP + 1)).energy
    truth = sum(one.energy for one in town)
    assert sigmas[-1] > sigmas[0] > 0.0 and abs(total - truth) < 2 * sigmas[-1]
    learner.add_interval(replace(silent[-1], energy=town[-1].energy))
    learner.consider(learner.prepare_update()())
    assert math.isnan(learner.predict(sample(9000)).energy)


def test_power_holds_nothing_of_the_road_of_the_last_interval(learner):
    """The network has what this place has beside the physics; it must not count twice."""
    before = learner.predict(sample(0)).power
    for state in (State.FORCE, State.SLOPE):
        learner._car.filter.state.mean[:, state] += 0.01
    learner._use(learner._car)
    assert learner.predict(sample(0)).power == before
    learner._car.filter.state.mean[:, State.C_RR] += 0.1
    learner._use(learner._car)
    assert learner.predict(sample(0)).power > before + 50.0


def test_the_newest_sample_has_no_debt_of_its_own(learner):
    """Only smoothed samples, which have a profile, follow the intervals."""
    newest = replace(sample(5), profile=())
    first = learner.predict(newest)
    assert learner.predict(newest) == first and math.isnan(first.energy)


def test_a_state_is_kept_and_what_does_not_fit_is_refused(learner, vehicle):
    saved = json.loads(json.dumps(learner.export()))
    other = PinnLearner(vehicle)
    other.restore(saved)
    assert other.export() == learner.export()
    assert other.parameters().identifiable == learner.parameters().identifiable
    energies = saved["energies"]
    fresh = PinnLearner(vehicle)
    before = json.dumps(fresh.export())
    for wrong in (
        {"energies": {**energies, "driven": -1.0}},
        {"energies": {**energies, "celsius": 1e9}},
        {"energies": {}},
        {"seen_ns": -1},
        {"seen_ns": 2**70},
        {"filter": {}},
        {"network": math.nan},
        {"payload": {**saved["payload"], "chance": {"count": -8.0, "squares": 0.0}}},
        {"loads": None},
        {"grade_suspicion": {"suspected": True, "sums": [1.0]}},
    ):
        with pytest.raises((KeyError, TypeError, ValueError)):
            fresh.restore({**saved, **wrong})
    assert json.dumps(fresh.export()["filter"]) == json.dumps(json.loads(before)["filter"])


def test_a_car_that_forecasts_is_the_car_that_was_learned(learner, vehicle):
    """Features of a moment times the coefficients give the power of the physics."""
    car = learner.linear_power(20.0)
    assert car.mass == pytest.approx(learner.parameters().parameters["mass"].value, rel=0.05)
    assert np.isfinite(car.mean).all() and np.isfinite(car.directions).all()
    frost = learner.linear_power(-10.0)
    assert frost.mean[6] > car.mean[6] + 1000.0, "heating, at 30 K of cold"
    assert LearnedCar(vehicle).is_finite()
