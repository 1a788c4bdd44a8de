"""Experts: forecasts rest on what is simple where it predicts whole drives better."""

from dataclasses import replace

import numpy as np
import pytest

from evpinn_ros.core.energy.forecast import forecast_plan
from evpinn_ros.core.energy.plan import legs_of_trip, plan_from_speed_profile
from evpinn_ros.core.energy.power_model import PowerModel, Weather, vehicle_model
from evpinn_ros.core.estimation.experts import (
    LEAST_DRIVES,
    PER_KM_SHARE,
    Expert,
    Experts,
    WholeDrive,
    log_score,
)
from evpinn_ros.core.estimation.pinn import PinnLearner
from evpinn_ros.core.estimation.posterior import passed
from evpinn_ros.core.estimation.size import Similarity, model_of_file
from evpinn_ros.core.estimation.states import SIZE, State
from evpinn_ros.core.estimation.terms import equation_of
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.replays.simulation.drive import DriveKind

CAR = load_vehicle("bmw_i3")
KM, J = 1e4, 5.4e6  # of each drive
BEYOND = np.zeros(SIZE)
BEYOND[[State.ROLLING, State.DRAG]] = 1.6e6, -0.1e6


def driven(drives, learned, file=1.0, drawn=lambda _: 1.0):
    """Experts after drives that the learned car and the file predicted as so many times 5.4 MJ."""
    experts = Experts.none()
    for number in range(drives):
        by_car = None if number == 0 else (learned * J, 0.05 * J)
        measured = drawn(number) * J
        drive = WholeDrive(KM, measured, by_car, (file * J, 0.2 * J), BEYOND)
        experts = experts.after(drive)
    return experts


def test_forecasts_go_over_after_three_drives_on_which_the_learned_car_was_wrong():
    """The first drive has no learned car; energy per km varies more than the file errs."""
    varied = [1.0, 1.2, 0.8, 1.1, 0.9, 1.2, 0.8]

    def best(drives, learned):
        experts = Experts.none()
        for number, energy in enumerate(varied[:drives]):
            by_car = None if number == 0 else (learned * energy * J, 0.05 * energy * J)
            file = energy * J, 0.2 * J
            experts = experts.after(WholeDrive(KM, energy * J, by_car, file, BEYOND))
        return experts.best

    assert [best(drives, 1.3) for drives in (LEAST_DRIVES, LEAST_DRIVES + 1)] == [
        Expert.LEARNED,
        Expert.FILE,
    ]
    assert best(len(varied), 1.02) is Expert.LEARNED


def test_energy_per_km_is_taken_where_the_file_is_wrong_too():
    assert driven(8, learned=1.4, file=2.0).best is Expert.PER_KM


def test_one_odd_drive_takes_nothing_over_and_a_better_car_takes_it_back():
    odd = driven(20, learned=1.0, drawn=lambda number: 30.0 if number == 10 else 1.0)
    assert odd.best is Expert.LEARNED
    wrong = driven(8, learned=1.4)
    assert wrong.best is not Expert.LEARNED
    for _ in range(60):
        right = (J, 0.02 * J), (1.3 * J, 0.2 * J)
        wrong = wrong.after(WholeDrive(KM, J, *right, BEYOND))
    assert wrong.best is Expert.LEARNED and wrong.sentence is None


def test_nobody_gains_by_being_more_sure_of_what_was_wrong():
    scores = [log_score(1e6, sigma) for sigma in (2.5e5, 1e4, 100.0, 0.0)]
    assert scores == sorted(scores, reverse=True)


def test_the_sentence_names_what_was_wrong():
    text = driven(8, learned=1.3, file=1.02, drawn=lambda n: 1.0 + 0.2 * (n % 2)).sentence
    assert text.startswith("The vehicle file alone predicts this car better: over 7 drives")
    assert "the learned car erred by" in text and "learned of tyres" in text
    net = replace(driven(8, learned=1.3), measured=-1.0).sentence
    assert "% of the" not in net, "the energy of roads that fall is no measure"


TIME = np.arange(300.0)
PLANS = (
    legs_of_trip([9000.0, 4000.0], [600.0, 200.0], np.array([300.0, -100.0])),
    plan_from_speed_profile(TIME, None, 10.0 + 8.0 * np.sin(TIME / 9.0)),
)


@pytest.mark.parametrize("plan", PLANS)
def test_energy_per_km_is_that_of_any_plan(plan):
    experts = driven(8, learned=1.4, file=2.0)
    model = PowerModel.of(replace(model_of_file(CAR), experts=experts, celsius=-5.0))
    result = forecast_plan(plan, model, Weather(1.2))
    way = result.end.distance
    assert result.energy[-1] == pytest.approx(J / KM * way, rel=1e-9)
    share = PER_KM_SHARE * experts.spread(Expert.PER_KM).scale ** 0.5
    assert result.sigma[-1] == pytest.approx(share * result.energy[-1], rel=1e-6)
    assert model.car.celsius == -5.0
    heavier = forecast_plan(plan, model.with_payload(200.0), Weather(1.2))
    assert np.isfinite(heavier.energy).all()


@pytest.mark.parametrize("plan", PLANS)
def test_the_file_alone_forecasts_as_before_any_drive(plan):
    learned = model_of_file(CAR)
    experts = driven(8, learned=1.3, drawn=lambda n: 1.0 + 0.2 * (n % 2))
    learned = replace(learned, mean=1.3 * learned.mean, experts=experts)
    by_file, by_net = (
        forecast_plan(plan, model, Weather(1.2))
        for model in (vehicle_model(CAR), PowerModel.of(learned))
    )
    assert by_net.energy.tolist() == by_file.energy.tolist()
    assert (by_net.sigma[1:] != by_file.sigma[1:]).any(), "its spread is that of its own errors"


def test_energies_are_those_of_the_vehicle_and_not_of_the_car_it_is_learned_as():
    robot = load_vehicle("generic").of_size(0.04)
    similarity = Similarity(robot)
    learned = replace(model_of_file(similarity.car), experts=driven(8, learned=1.4, file=2.0))
    experts = similarity.model(learned).experts
    assert experts.cost == pytest.approx(0.04 * J / KM)
    assert experts.sentence == learned.experts.sentence


def test_a_car_that_is_restored_before_each_drive_is_judged_as_one_that_goes_on(intervals):
    """Of each drive an eighth of the energy was lost on the way to the battery's sensor."""
    town = list(intervals((DriveKind.URBAN, 200.0, 0), begin_ns=0))
    equation = equation_of(CAR)
    goes_on, stored = (PinnLearner(CAR) for _ in range(2))
    for number in range(4):
        if number:
            goes_on.end_drive()
            again = PinnLearner(CAR)
            again.restore(stored.export())
            again.end_drive()
            stored = again
        for learner in (goes_on, stored):
            for interval in town:
                row = passed(equation, interval, 0.0).journey.row
                energy = 0.875 * float(row @ equation.mean)
                measured = replace(interval, energy=energy, sampling_variance=0.0)
                assert learner.add_interval(measured)
            update = learner.prepare_update()
            assert learner.consider(update()) is None
    running, restored = (learner._car.judged() for learner in (goes_on, stored))
    assert running.experts.drives == restored.experts.drives == 3.0
    assert restored.experts.odds == pytest.approx(running.experts.odds, rel=1e-6)
    assert restored.bands.drive == pytest.approx(running.bands.drive, rel=1e-6)
